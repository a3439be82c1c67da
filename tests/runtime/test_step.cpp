#include "check.h"
#include "count_allocations.h"
#include "made_hand.h"
#include "session.h"

using namespace palmar;

namespace {

// Targets that a hand would not dare: new ones every 20 to 200 steps, a tenth of them at once, the rest in between.
std::vector<Sample> wild_motion(unsigned seed, int steps) {
  std::mt19937 rng(seed);
  std::uniform_int_distribution<int> length(20, 200);
  std::uniform_real_distribution<double> chance(0, 1);
  std::vector<Sample> samples;
  Configuration from;
  from.position = Vec3(0, -0.05, 0.25);
  while (int(samples.size()) < steps) {
    const Configuration to = made::random_configuration(rng, 0.08);
    const int n = length(rng);
    const bool jump = chance(rng) < 0.1;
    const Change way = difference(to, from);
    for (int i = 1; i <= n && int(samples.size()) < steps; ++i) {
      Sample s;
      s.time_s = 1e-3 * double(samples.size());
      s.pose = to_pose(advance(from, way, jump ? 1.0 : double(i) / n));
      samples.push_back(s);
    }
    from = to;
  }
  return samples;
}

}  // namespace

int main() {
  const HandModel hand = made::hand();
  const std::vector<std::vector<Sphere>> objects = {made::ball(500, 0.04, 0.006), made::plate(25, 0.004, 0.003),
                                                    made::ears()};

  // Non-penetration, whatever the hand does, by brute force after every step; nothing allocated; no limit broken.
  for (std::size_t o = 0; o < objects.size(); ++o) {
    Session session(hand, objects[o], Settings{});
    double deepest = 0;
    long in_step = 0, contacts = 0, kept = 0;
    for (const Sample& s : wild_motion(unsigned(10 + o), 4000)) {
      const long before = allocations;
      const StepResult& r = session.step(s);
      in_step += allocations - before;
      deepest = std::max(deepest, -made::brute_gap(hand, objects[o], r.graphic));
      contacts += r.contacts;
      kept += (r.status & kKeptPrevious) != 0;
      for (int f = 0; f < kFingers; ++f)
        for (int j = 0; j < kPhalanges; ++j)
          CHECK(r.graphic.flexion_rad[3 * f + j] <= hand.finger[f].flexion_limit[j][1] + 1e-7);
    }
    CHECK(deepest <= 1e-12);  // metres: rounding of the two ways to compute the same gap
    CHECK(in_step == 0);
    CHECK(contacts > 1000);
    CHECK(kept == 0);
  }

  // Two sessions, one trace: every pose, force and state the same to the bit.
  {
    Session a(hand, objects[2], Settings{}), b(hand, objects[2], Settings{});
    bool same = true;
    for (const Sample& s : wild_motion(77, 2000)) {
      const StepResult &ra = a.step(s), &rb = b.step(s);
      same &= ra.state_hash == rb.state_hash && ra.fingertip_force_n == rb.fingertip_force_n &&
              ra.graphic.flexion_rad == rb.graphic.flexion_rad && ra.operations == rb.operations;
    }
    CHECK(same);
  }

  // Held still and pressed in, the hand comes to rest to the bit.
  for (std::size_t o = 0; o < objects.size(); ++o) {
    Session session(hand, objects[o], Settings{});
    const std::vector<Sample> motion = wild_motion(unsigned(20 + o), 3000);
    for (std::size_t start = 500; start < 3000; start += 500) {
      for (std::size_t i = start - 500; i < start; ++i) session.step(motion[i]);
      std::uint64_t hash = 0;
      int still = 0;
      for (int i = 0; i < 3000; ++i) {
        const StepResult& r = session.step(motion[start - 1]);
        still = r.state_hash == hash ? still + 1 : 0;
        hash = r.state_hash;
      }
      CHECK(still > 1000);
    }
  }

  // In the open the graphic hand is the haptic hand.
  {
    Session session(hand, objects[0], Settings{});
    for (Sample s : wild_motion(5, 500)) {
      s.pose.palm.position_m[2] += 1.0;
      CHECK(session.step(s).graphic.flexion_rad == s.pose.flexion_rad);
      CHECK(session.step(s).graphic.palm.position_m == s.pose.palm.position_m);
    }
  }

  // A moving object: the same hand motion seen from the object gives the same gaps, and carrying both changes no force.
  {
    Session still(hand, objects[2], Settings{}), carried(hand, objects[2], Settings{});
    double force_difference = 0;
    const std::vector<Sample> motion = wild_motion(31, 1500);
    for (const Sample& s : motion) {
      Sample moved = s;
      const Vec3 shift(0.3 * std::sin(s.time_s), 0.2 * s.time_s, -0.1);
      moved.has_object_pose = true;
      moved.object.position_m = to_array(shift);
      moved.pose.palm.position_m = to_array(Vec3(to_vec3(s.pose.palm.position_m) + shift));
      const StepResult &a = still.step(s), &b = carried.step(moved);
      for (int k = 0; k < 15; ++k)
        force_difference = std::max(force_difference, std::abs(a.fingertip_force_n[k] - b.fingertip_force_n[k]));
    }
    // Newtons: shifting rounds each position by 1e-16 m, and the way there is repeated through a thousand contacts.
    CHECK(force_difference < 1e-3);
  }

  // With force_step_n what is felt never jumps, whatever the hand does.
  {
    Settings settings;
    settings.force_step_n = 0.05;
    Session session(hand, objects[2], settings);
    StepResult before;
    HandPlacement haptic_before;
    bool first = true;
    for (const Sample& s : wild_motion(51, 2000)) {
      const StepResult& r = session.step(s);
      const HandPlacement haptic = place_hand(hand, to_configuration(s.pose));
      for (int f = 0; f < kFingers && !first; ++f) {
        const Vec3 step = Vec3(&r.fingertip_force_n[3 * f]) - Vec3(&before.fingertip_force_n[3 * f]);
        const double tip = (haptic.phalanx[3 * f + 2].c2 - haptic_before.phalanx[3 * f + 2].c2).norm();
        CHECK(step.norm() <= hand.palm_stiffness * tip + 0.05 + 1e-9);
      }
      before = r;
      haptic_before = haptic;
      first = false;
    }
  }

  // Programmes that end too early leave nothing behind: neither numbers of an old list of candidates, nor a pose
  // inside.
  for (int limit : {2, 12}) {
    Settings settings;
    settings.qp_iterations = limit;
    settings.iterations = 8;
    for (unsigned seed = 8; seed < 12; ++seed) {
      Session session(hand, objects[2], settings);
      double deepest = 0;
      for (const Sample& s : wild_motion(seed, 1500))
        deepest = std::max(deepest, -made::brute_gap(hand, objects[2], session.step(s).graphic));
      CHECK(deepest <= 1e-12);
    }
  }

  // The flat of the palm onto a plate of many small spheres, slowly and fast: it stops there, and comes off again.
  {
    const std::vector<Sphere> dense = made::plate(400, 0.00025, 0.0003);
    Settings upright;  // a palm that does not tilt under the press stops where its radius says
    upright.palm_priority = 1000;
    upright.imposed_priority = 100;
    for (const double way : {0.001, 0.02, 0.05}) {
      Session session(hand, dense, upright);
      Sample s;
      s.pose.palm.rotation_wxyz = {0, 0, 1, 0};  // the thumb away from the plate
      const auto go = [&](double z) {
        s.pose.palm.position_m = {0, -0.05, z};
        return session.step(s).graphic.palm.position_m[2];
      };
      for (double z = 0.5; z > -0.4; z -= way) go(z);
      double stopped = 0, off = 0;
      for (int i = 0; i < 100; ++i) stopped = go(-0.4);
      CHECK_NEAR(stopped, 0.0113, 5e-5);  // metres: palm radius and plate radius, less where spheres part
      for (int i = 0; i < 100; ++i) off = go(0.002 * i);
      CHECK_NEAR(off, 0.198, 1e-3);
    }
  }

  // Before the first sample that can be used there is no pose and no force, and no number that is not one.
  {
    Session session(hand, objects[0], Settings{});
    Sample lost;
    lost.tracked = false;
    const StepResult& r = session.step(lost);
    CHECK(r.status == kBadSample && r.contacts == 0);
    for (double f : r.fingertip_force_n) CHECK(f == 0);
  }

  // Samples that cannot be used leave the hand where it is, and say so.
  {
    Session session(hand, objects[0], Settings{});
    const std::vector<Sample> motion = wild_motion(41, 300);
    for (const Sample& s : motion) session.step(s);
    const HandPose before = session.step(motion.back()).graphic;
    for (int fault = 0; fault < 6; ++fault) {
      Sample bad = motion[0];
      if (fault == 0) bad.pose.flexion_rad[3] = std::nan("");
      if (fault == 1) bad.pose.palm.position_m[0] = INFINITY;
      if (fault == 2) bad.tracked = false;
      if (fault == 3) bad.pose.palm.rotation_wxyz = {0, 0, 0, 0};
      if (fault == 5) bad.pose.palm.position_m[2] = 1e300;
      if (fault == 4) bad.object.position_m[1] = std::nan("");
      const StepResult& r = session.step(bad);
      CHECK(r.status & kBadSample);
      CHECK(r.graphic.flexion_rad == before.flexion_rad && r.graphic.palm.position_m == before.palm.position_m);
      for (double f : r.fingertip_force_n) CHECK(std::isfinite(f));
    }
  }
  return finish();
}
