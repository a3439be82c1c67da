// What a session does around the solver: the input filter, an object that is put elsewhere or carried along, and the
// way on which a hand left behind is led.
#include <limits>
#include <numbers>

#include "check.h"
#include "made_hand.h"
#include "session.h"

using namespace palmar;

namespace {

const std::vector<Sphere> kBall = made::ball(500, 0.04, 0.006);

Configuration curled(double angle, const Vec3& position) {
  Configuration q;
  q.position = position;
  for (int f = 0; f < kFingers; ++f) q.flexion[f].fill(f == 0 ? 0.3 : angle);
  return q;
}

Sample sample_at(int step, const Configuration& q, const Placement& object = {}) {
  Sample s;
  s.time_s = 1e-3 * step;
  s.pose = to_pose(q);
  s.has_object_pose = true;
  s.object = object;
  return s;
}

double deepest(const HandModel& hand, const StepResult& r) {
  const Quat turn = to_quat(r.object.rotation_wxyz).normalized().conjugate();
  Configuration q = to_configuration(r.graphic);
  q.position = turn * (q.position - to_vec3(r.object.position_m));
  q.rotation = turn * q.rotation;
  return -made::brute_gap(hand, kBall, to_pose(q));
}

// A session that filters answers what one that gets filtered poses does, bit for bit; a hand that was lost begins anew.
void filters_before_it_solves() {
  const HandModel hand = made::hand();
  Settings filtering;
  filtering.filter = "one_euro", filtering.filter_cutoff_hz = 2, filtering.filter_beta = 1;
  Session filtered(hand, kBall, filtering), plain(hand, kBall, {});
  FilterState state;
  double time_s = std::numeric_limits<double>::quiet_NaN(), apart = 0;
  for (int k = 0; k < 400; ++k) {
    const double shake = 1e-3 * std::sin(1.9 * k);
    Sample sample = sample_at(k, curled(0.4 + shake, {shake, -0.05, 0.11 - 1e-4 * k}));
    sample.tracked = k % 100 != 99;
    const double passed = sample.time_s - time_s, dt_s = passed > 0 ? passed : 1e-3;
    time_s = sample.time_s;
    const StepResult& r = filtered.step(sample);
    if (sample.tracked) {
      const Configuration smooth =
          filter_pose({filtering.filter_cutoff_hz, filtering.filter_beta}, state, to_configuration(sample.pose), dt_s);
      apart = std::max(apart, (smooth.position - to_configuration(sample.pose).position).norm());
      sample.pose = to_pose(smooth);
    } else {
      state.started = false;
    }
    const StepResult& wanted = plain.step(sample);
    CHECK(r.state_hash == wanted.state_hash && r.graphic.palm.position_m == wanted.graphic.palm.position_m);
    CHECK(r.palm_force_n == wanted.palm_force_n && r.status == wanted.status && r.contacts == wanted.contacts);
  }
  CHECK(apart > 5e-4);  // metres: half of the shaking is gone, so it did filter
}

// Palm down on the ball, 20 mm deeper than it lets through.
struct Pressing {
  explicit Pressing(const Settings& settings) : session(hand, kBall, settings) {
    for (; step < 600; ++step) session.step(sample_at(step, down(0.13 - 2e-4 * std::min(step, 450))));
  }
  static Configuration down(double z) { return curled(0.4, {0, -0.05, z}); }
  const StepResult& next(const Placement& object = {}) {
    const StepResult& r = session.step(sample_at(step++, down(0.04), object));
    CHECK(deepest(hand, r) <= 1e-12);  // metres: rounding of two ways to the same gap
    return r;
  }
  HandModel hand = made::hand();
  Session session;
  int step = 0;
};

Placement turned_away(const Vec3& to) {
  const double half = std::numbers::pi / 4;
  return {to_array(to), {std::cos(half), 0, 0, std::sin(half)}};
}

// An object that is taken away leaves the hand where it was in the world, and the force as it was felt there.
void an_object_put_elsewhere_does_not_take_the_hand_along() {
  Settings settings;
  settings.force_step_n = 0.05;
  Pressing at(settings);
  StepResult before = at.next();
  CHECK(before.contacts > 0 && to_vec3(before.palm_force_n).norm() > 1);
  const Placement away = turned_away({0.4, 0.1, 0});
  double moved = 0;
  for (int k = 0; k < 300; ++k) {
    const StepResult r = at.next(away);
    if (k == 0) CHECK(r.contacts == 0 && (r.status & (kRecovering | kBadSample)) == 0);
    moved = std::max(moved, (to_vec3(r.graphic.palm.position_m) - Vec3(0, -0.05, 0.04)).norm());
    // The hand stands still in the world, so the force changes by no more than it may in a step.
    CHECK((to_vec3(r.palm_force_n) - to_vec3(before.palm_force_n)).norm() <= settings.force_step_n * (1 + 1e-9));
    before = r;
  }
  CHECK(moved < 0.05);
  CHECK((to_vec3(before.graphic.palm.position_m) - Vec3(0, -0.05, 0.04)).norm() < 1e-6);
}

// One that is put where the hand is puts it outside, and what is felt grows anew from nothing.
void an_object_put_over_the_hand_begins_anew() {
  Pressing at({});
  const Placement away = turned_away({0.4, 0.1, 0}), over = turned_away({0.01, -0.03, 0.03});
  for (int k = 0; k < 300; ++k) at.next(away);
  const StepResult& first = at.next(over);
  CHECK(first.status & kRecovering);
  // A step of 1 ms of the 0.1 s in which forces grow.
  const double earlier = to_vec3(first.palm_force_n).norm();
  CHECK((to_vec3(first.graphic.palm.position_m) - Vec3(0, -0.05, 0.04)).norm() > 1e-3);
  double last = 0;
  for (int k = 0; k < 200; ++k) {
    const StepResult& r = at.next(over);
    last = to_vec3(r.palm_force_n).norm();
    if (k == 199) CHECK((r.status & kRecovering) == 0 && r.contacts > 0);
  }
  CHECK(last > 1 && earlier < 0.05 * last);
}

// One that goes along with the hand is carried by it, however far in a step: nothing changes between them.
void an_object_carried_along_stays_in_the_hand() {
  Pressing at({});
  for (int k = 0; k < 200; ++k) at.next();
  const StepResult still = at.next();
  for (int k = 1; k < 20; ++k) {
    const Vec3 carried(0.25 * k, 0, 0);  // exact in binary, as its sums with the pose need not be
    Configuration q = Pressing::down(0.04);
    q.position += carried;
    const StepResult& r = at.session.step(sample_at(at.step++, q, {to_array(carried), {1, 0, 0, 0}}));
    CHECK(deepest(at.hand, r) <= 1e-12);
    const Vec3 palm = to_vec3(r.graphic.palm.position_m) - carried;
    CHECK((palm - to_vec3(still.graphic.palm.position_m)).norm() < 1e-9);
    CHECK((to_vec3(r.palm_force_n) - to_vec3(still.palm_force_n)).norm() < 1e-5);
    CHECK(r.contacts == still.contacts && (r.status & kRecovering) == 0);
  }
}

// A hand that cannot follow is tried wrist first, by its back, palm first, and from the object's centre again.
void ways_off_are_tried_in_turn() {
  const HandModel hand = made::hand();
  const CollisionObject object(kBall);
  Configuration graphic = curled(0.4, object.center + Vec3(0.02, 0, 0)), haptic = graphic;
  graphic.rotation = Quat(std::numbers::sqrt2 / 2, std::numbers::sqrt2 / 2, 0, 0);  // about x: y to z, z to -y
  haptic.position = {0, 0, -1};
  const ReleaseRule rule{0.01, 0.1};
  Release release;
  const double dt_s = 1e-3, step = 1.5 * dt_s;
  std::vector<Vec3> ways;
  int same = 0;
  for (int k = 0; k < 600; ++k) {
    const Configuration aim = release.aim(rule, hand, object, haptic, graphic, true, dt_s);
    if (k < 9) CHECK(!release.active() && aim.position == haptic.position);
    if (!release.active()) continue;
    const Vec3 way = (aim.position - graphic.position) / step;
    CHECK(aim.flexion[2][0] == 0 && aim.rotation.coeffs() == graphic.rotation.coeffs());
    ++same;
    if (!ways.empty() && (way - ways.back()).norm() < 1e-9) continue;
    if (!ways.empty()) CHECK(same >= 99 && same <= 102);  // 0.1 s without following
    ways.push_back(way);
    same = 0;
  }
  const std::vector<Vec3> wanted = {{1, 0, 0}, {0, 0, -1}, {0, -1, 0}, {0, 1, 0}, {1, 0, 0}};
  CHECK(ways.size() > wanted.size());
  for (std::size_t k = 0; k < wanted.size() && k < ways.size(); ++k) CHECK((ways[k] - wanted[k]).norm() < 1e-9);
}

// Who cannot come near on the far side either is left alone, and not led a second time until the hands have met.
void a_way_that_ends_at_the_object_is_given_up() {
  const HandModel hand = made::hand();
  const CollisionObject object(kBall);
  const double around = object.radius + hand.reach;
  Configuration graphic = curled(0.4, object.center + Vec3(0, 0, 1.01 * around)), haptic = graphic;
  haptic.position = object.center + Vec3(0, 0, 0.05);
  const ReleaseRule rule{0, 0.1};
  Release release;
  // It follows to the side on which the haptic hand is, which is where it stands, and then no farther.
  CHECK((release.aim(rule, hand, object, haptic, graphic, true, 1e-3).position - graphic.position).norm() < 1e-9);
  int led = 0;
  while (release.active() && led < 1000) {
    const Configuration aim = release.aim(rule, hand, object, haptic, graphic, true, 1e-3);
    if (release.active()) CHECK_NEAR((aim.position - graphic.position).norm(), 1.5e-3, 1e-12);
    ++led;
  }
  CHECK(led >= 100 && led <= 103);  // 0.1 s
  for (int k = 0; k < 500; ++k) {
    CHECK(release.aim(rule, hand, object, haptic, graphic, true, 1e-3).position == haptic.position);
    CHECK(!release.active());
  }
  release.aim(rule, hand, object, haptic, haptic, true, 1e-3);  // they have met
  release.aim(rule, hand, object, haptic, graphic, true, 1e-3);
  CHECK(release.active());
}

}  // namespace

int main() {
  filters_before_it_solves();
  an_object_put_elsewhere_does_not_take_the_hand_along();
  an_object_put_over_the_hand_begins_anew();
  an_object_carried_along_stays_in_the_hand();
  ways_off_are_tried_in_turn();
  a_way_that_ends_at_the_object_is_given_up();
  return finish();
}
