// What each solver that is there for comparison does, as facts with a margin: a baseline that gets worse is a broken
// comparison, and one that stops failing where its source says it fails is news.
#include <cstring>
#include <string>

#include "check.h"
#include "count_allocations.h"
#include "made_hand.h"
#include "session.h"

using namespace palmar;

namespace {

const HandModel hand = made::hand();
const std::vector<Sphere> ball = made::ball(500, 0.04, 0.006);
const std::vector<Sphere> ears = made::ears();

// Millimetres, by brute force over every sphere; 0 where nothing overlaps.
double depth_mm(const std::vector<Sphere>& spheres, const HandPose& pose) {
  const HandPlacement at = place_hand(hand, to_configuration(pose));
  double least = 0;
  for (const Sphere& s : spheres) {
    for (const PalmSphere& p : hand.palm)
      least = std::min(least, (at.rotation * p.center + at.position - s.center).norm() - p.radius - s.radius);
    for (const Capsule& c : at.phalanx) least = std::min(least, capsule_sphere_gap(c, s.center, s.radius).gap);
  }
  return -1e3 * least;
}

Configuration pose_at(double x, double y, double z, double curl) {
  Configuration q;
  q.position = Vec3(x, y, z);
  for (auto& finger : q.flexion) finger = {curl, curl, curl};
  return q;
}

using Motion = std::vector<Sample>;

void go(Motion& motion, const Configuration& from, const Configuration& to, int steps) {
  const Change way = difference(to, from);
  for (int i = 1; i <= steps; ++i) {
    Sample s;
    s.time_s = 1e-3 * double(motion.size());
    s.pose = to_pose(advance(from, way, double(i) / steps));
    motion.push_back(s);
  }
}

Motion straight(const Configuration& from, const Configuration& to, int steps, int hold) {
  Motion motion;
  go(motion, from, to, steps);
  go(motion, to, to, hold);
  return motion;
}

Motion random_walk(unsigned seed) {
  std::mt19937 rng(seed);
  Motion motion;
  Configuration from = pose_at(0, -0.05, 0.25, 0);
  for (int i = 0; i < 10; ++i) {
    const Configuration to = made::random_configuration(rng, 0.08);
    go(motion, from, to, 100);
    from = to;
  }
  return motion;
}

Settings settings_of(const char* solver) {
  Settings settings;
  settings.solver = solver;
  return settings;
}

double deepest_mm(const char* solver, const std::vector<Sphere>& object, const Motion& motion) {
  Session session(hand, object, settings_of(solver));
  double deepest = 0;
  for (const Sample& s : motion) deepest = std::max(deepest, depth_mm(object, session.step(s).graphic));
  return deepest;
}

bool finite(const StepResult& r) {
  double sum = 0;
  for (double v : r.graphic.flexion_rad) sum += v;
  for (double v : r.graphic.palm.position_m) sum += v;
  for (double v : r.graphic.palm.rotation_wxyz) sum += v;
  for (double v : r.fingertip_force_n) sum += v;
  for (double v : r.equation14_force_n) sum += v;
  return std::isfinite(sum);
}

}  // namespace

int main() {
  // Nothing allocated, every number finite, joint limits kept, and two sessions the same to the bit, in wild motion.
  for (const SolverRow& row : SOLVERS) {
    Session a(hand, ears, settings_of(row.name)), b(hand, ears, settings_of(row.name));
    long in_step = 0, contacts = 0;
    bool all_finite = true, same = true, inside = true;
    for (const Sample& s : random_walk(3)) {
      const long before = allocations;
      const StepResult& r = a.step(s);
      in_step += allocations - before;
      same &= r.state_hash == b.step(s).state_hash;
      all_finite &= finite(r);
      contacts += r.contacts;
      for (int f = 0; f < kFingers; ++f)
        for (int j = 0; j < kPhalanges; ++j) {
          inside &= r.graphic.flexion_rad[3 * f + j] <= hand.finger[f].flexion_limit[j][1] + 1e-7;
          inside &= r.graphic.flexion_rad[3 * f + j] >= hand.finger[f].flexion_limit[j][0] - 1e-7;
        }
    }
    CHECK(in_step == 0);
    CHECK(all_finite);
    CHECK(same);
    CHECK(inside);
    CHECK(contacts > 0);
  }

  // In the open the graphic hand is the haptic hand to the bit; on springs it trails by acceleration / w^2, and is back
  // within a micrometre half a second after the hand has stopped.
  for (const SolverRow& row : SOLVERS) {
    const bool springs = std::strcmp(row.name, "penalty") == 0;
    Session session(hand, ball, settings_of(row.name));
    double off = 0;
    const Motion motion = straight(pose_at(0, 0, 0.5, 0.2), pose_at(0.1, 0.1, 0.4, 0.8), 300, 500);
    for (const Sample& s : motion) {
      const StepResult& r = session.step(s);
      off = largest_motion(hand, place_hand(hand, to_configuration(r.graphic)),
                           place_hand(hand, to_configuration(s.pose)));
      if (!springs) CHECK(off == 0);
    }
    CHECK(off < 1e-6);
  }

  // A palm pressed slowly, 30 mm/s, onto a ball; fingers curled slowly round it. Rows hold; an average of rows and
  // springs give.
  const Motion press = straight(pose_at(0, -0.05, 0.06, 0), pose_at(0, -0.05, 0.045, 0), 500, 100);
  const Motion curl = straight(pose_at(0, -0.10, 0.053, 0), pose_at(0, -0.10, 0.053, 0.4), 800, 100);
  for (const Motion& motion : {press, curl}) {
    CHECK(deepest_mm("progressive", ball, motion) < 1e-9);
    CHECK(deepest_mm("paper", ball, motion) < 0.1);  // the paper's own figure
    CHECK(deepest_mm("monolithic", ball, motion) < 0.1);
    CHECK(deepest_mm("god_object", ball, motion) < 0.011);  // its kDrift and rounding
    const double aggregate = deepest_mm("aggregate", ball, motion), penalty = deepest_mm("penalty", ball, motion);
    CHECK(aggregate > 0.01 && aggregate < 0.5);
    CHECK(penalty > 1e-4 && penalty < 0.05);  // force / stiffness: newtons over 1e6 N/m a pair
  }

  // A hand swept through a ball at 2 m/s: four bands a step. One linearisation within a band goes in.
  const Motion swipe = straight(pose_at(-0.2, -0.05, 0.02, 0.4), pose_at(0.2, -0.05, 0.02, 0.4), 200, 0);
  CHECK(deepest_mm("progressive", ball, swipe) < 1e-9);
  for (const char* solver : {"paper", "monolithic", "aggregate"}) CHECK(deepest_mm(solver, ball, swipe) > 1.0);
  CHECK(deepest_mm("penalty", ball, swipe) > 0.1);
  CHECK(deepest_mm("god_object", ball, swipe) < 0.1);  // it advances to the next contact at any speed

  // The palm carries curled fingers down between two horns, where flexion alone frees none.
  Motion wedge = straight(pose_at(-0.02, -0.1, 0.1, 0.5), pose_at(0.02, -0.1, 0.02, 0.5), 500, 0);
  CHECK(deepest_mm("progressive", ears, wedge) < 1e-9);
  CHECK(deepest_mm("paper", ears, wedge) > 1.0);
  CHECK(deepest_mm("god_object", ears, wedge) < 0.1);
  return finish();
}
