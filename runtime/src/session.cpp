#include "session.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include "error.h"

namespace palmar {

namespace {

constexpr int kContactCapacity = 512;
constexpr double kLongestStep = 0.1;  // seconds; a clock that leaps farther says no more than that time has passed
constexpr int kStartSteps = 50;
constexpr double kQuickestFade = 0.2;  // of fade_s, where a hand was held so long that less is left
constexpr double kLed = 1e-4;  // metres a step that the palm shown comes nearer to the haptic one: not yet arrived
constexpr int kRows = 1024;    // of one programme
constexpr double kContactGap = 1e-5;  // metres; a pair this near counts as a contact: ten times what a row aims at

bool finite(const double* v, int n) {
  for (int i = 0; i < n; ++i)
    if (!std::isfinite(v[i])) return false;
  return true;
}

bool finite_unit(const std::array<double, 4>& q) {
  if (!finite(q.data(), 4)) return false;
  const double n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  return std::abs(n - 1.0) < 1e-2;
}

// Finite, and within a kilometre: from farther off rounding alone could hold the hand for good.
bool usable_place(const std::array<double, 3>& p) {
  return std::abs(p[0]) <= 1e3 && std::abs(p[1]) <= 1e3 && std::abs(p[2]) <= 1e3;
}

bool nearly_same(const Configuration& a, const Configuration& b) {
  constexpr double kRounding = 1e-12;  // metres, rad: a thousand times what a frame some metres away adds
  double most = std::max((a.position - b.position).cwiseAbs().maxCoeff(),
                         (a.rotation.coeffs() - b.rotation.coeffs()).cwiseAbs().maxCoeff());
  for (int f = 0; f < kFingers; ++f) {
    most = std::max(most, std::abs(a.abduction[f] - b.abduction[f]));
    for (int j = 0; j < kPhalanges; ++j) most = std::max(most, std::abs(a.flexion[f][j] - b.flexion[f][j]));
  }
  return most <= kRounding;
}

// FNV-1a over raw bytes.
void mix(std::uint64_t& hash, const void* bytes, std::size_t size) {
  const unsigned char* b = static_cast<const unsigned char*>(bytes);
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ b[i]) * 1099511628211ull;
}

SolveFunction find_solver(const std::string& name) {
  std::string known;
  for (const SolverRow& row : SOLVERS) {
    if (name == row.name) return row.solve;
    known += std::string(known.empty() ? "" : ", ") + row.name;
  }
  throw Error("E-CONF-VALUE", "solver", "no solver is called '" + name + "'; there are: " + known);
}

}  // namespace

Workspace::Workspace(const Settings& s)
    : candidates(s.candidates),
      gap(candidates.size()),
      trial_gap(candidates.size()),
      rows(kRows),
      violation(kRows),
      row_candidate(kRows),
      wanted(candidates.size()),
      wanted_pair(candidates.size()) {}

Session::Session(HandModel hand, std::vector<Sphere> object, Settings settings)
    : hand_(std::move(hand)),
      palm_(hand_),
      object_(std::move(object)),
      settings_(std::move(settings)),
      solve_(find_solver(settings_.solver)),
      work_(settings_),
      time_s_(std::numeric_limits<double>::quiet_NaN()),
      contacts_(kContactCapacity) {
  hand_.left_out = links_of(settings_.leave_out);
  state_.placement = haptic_before_at_ = place_hand(hand_, state_.graphic);
}

bool Session::usable(const Sample& s) const {
  return s.tracked && std::isfinite(s.time_s) && usable_place(s.pose.palm.position_m) &&
         finite_unit(s.pose.palm.rotation_wxyz) && finite(s.pose.flexion_rad.data(), 15) &&
         finite(s.pose.abduction_rad.data(), 5) && usable_place(s.object.position_m) &&
         finite_unit(s.object.rotation_wxyz);
}

Configuration Session::inside_limits(Configuration q, bool& clipped) const {
  clipped = false;
  const auto clip = [&](double& angle, const std::array<double, 2>& limit) {
    const double inside = std::clamp(angle, limit[0], limit[1]);
    clipped |= inside != angle;
    angle = inside;
  };
  for (int f = 0; f < kFingers; ++f) {
    clip(q.abduction[f], hand_.finger[f].abduction_limit);
    for (int j = 0; j < kPhalanges; ++j) clip(q.flexion[f][j], hand_.finger[f].flexion_limit[j]);
  }
  return q;
}

// Does nothing enter the hand at q?
bool Session::free(const Configuration& q, HandPlacement& at) {
  at = place_hand(hand_, q);
  return is_free(hand_, palm_, object_, at, work_.operations);
}

// Puts the graphic hand at q where that is free, else at the nearest free place of the same posture found by moving it
// out along 26 directions, growing steps, nearest first; what is felt then begins anew. True if it had to be moved.
bool Session::put_at(const Configuration& q) {
  state_.started = true;
  state_.reach.fill(settings_.reach_least_m);
  state_.graphic = q;
  state_.pressing_count = 0;
  state_.at_limit = 0;
  state_.resting = false;
  work_.candidates.forget();
  work_.active_count = 0;
  if (free(q, state_.placement)) return false;
  gain_ = 0;
  // Beyond this the hand's ball and the object's ball are apart: the search always ends at a free place.
  const double far = (q.position - object_.center).norm() + hand_.reach + object_.radius;
  for (double out = 5e-4; out < 2 * far + 1e-2; out *= 1.3) {
    for (int d = 0; d < 27; ++d) {
      const Vec3 direction(d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1);
      if (direction.isZero()) continue;
      state_.graphic.position = q.position + out * direction.normalized();
      if (free(state_.graphic, state_.placement)) return true;
    }
  }
  return true;
}

// A hand that was put outside is not yet as near as can be: what is shown shall not drift from there.
void Session::come_near(double joint_step_rad) {
  Settings settings = settings_;
  settings.joint_step_rad = joint_step_rad;
  for (int k = 0; k < kStartSteps; ++k) {
    work_.operations = 0;
    solve_({hand_, palm_, object_, settings}, haptic_, state_, work_);
  }
}

// An object that an application puts elsewhere leaves the hand where it is in the world: the poses of the last step, as
// the object sees them from its new place. One that only moves, however fast, pushes the hand: the solver sweeps it.
// One that moves along with the haptic hand is carried by it. True if it was put elsewhere.
bool Session::follow_object(const Placement& before) {
  const Quat from = to_quat(before.rotation_wxyz).normalized(), to = to_quat(placed_.rotation_wxyz).normalized();
  const Quat turn = to.conjugate() * from;
  const Vec3 shift = to.conjugate() * (to_vec3(before.position_m) - to_vec3(placed_.position_m));
  const Vec3 center = turn * object_.center + shift - object_.center;
  const double object_moved = center.norm() + rotation_log(turn).norm() * object_.radius;
  const double hand_moved = (haptic_.position - haptic_before_.position).norm();  // seen from the object
  if (std::min(object_moved, hand_moved) <= settings_.object_jump_m) return false;
  const auto seen = [&](Configuration q) {
    q.position = turn * q.position + shift;
    q.rotation = (turn * q.rotation).normalized();
    return q;
  };
  state_.haptic = seen(state_.haptic);
  haptic_before_ = seen(haptic_before_);
  haptic_before_at_ = place_hand(hand_, haptic_before_);
  felt_ = turned(felt_, turn);
  release_ = {};
  if (put_at(seen(state_.graphic))) come_near(settings_.joint_step_rad / kStartSteps);
  return true;
}

// Between this sample and the last; a step of the settings' rate where the clock stands or goes back.
double Session::seconds_since_last(double time_s) {
  const double passed = time_s - time_s_;
  if (std::isfinite(time_s)) time_s_ = time_s;
  return passed > 0 ? std::min(passed, kLongestStep) : 1.0 / settings_.rate_hz;
}

const StepResult& Session::step(const Sample& sample) {
  work_.operations = 0;
  work_.operations_most = std::uint32_t(settings_.operations);
  work_.search_us = work_.solve_us = work_.verify_us = 0;
  const double dt_s = seconds_since_last(sample.time_s);
  std::uint32_t status = kOk;
  bool fading = true;
  // A hand that was lost for so long that nothing is felt is led to where it is now before anything is.
  bool arriving = gain_ == 0 && (result_.status & kBadSample);
  double fade_s = settings_.fade_s;
  if (usable(sample)) {
    const Placement placed_before = placed_;
    placed_ = sample.object;
    haptic_pose_ = sample.pose;
    Configuration q = to_configuration(sample.pose);
    if (settings_.filter == "one_euro")
      q = filter_pose({settings_.filter_cutoff_hz, settings_.filter_beta}, filter_, q, dt_s);
    // The solver works in the object's frame, where a moving object stands still and the hand carries its motion.
    const Quat object_rotation = to_quat(placed_.rotation_wxyz).normalized();
    q.position = object_rotation.conjugate() * (q.position - to_vec3(placed_.position_m));
    q.rotation = (object_rotation.conjugate() * q.rotation).normalized();
    bool clipped;
    q = inside_limits(q, clipped);
    if (clipped) status |= kLimit;
    // Where hand and object are carried along together, only the rounding of their frames changes.
    if (!state_.started || !nearly_same(q, haptic_)) haptic_ = q;
    if (!state_.started) {
      state_.haptic = haptic_;
      if (put_at(haptic_)) come_near(settings_.joint_step_rad);
      work_.operations = 0;  // a budget is a step's; the search for a place to start has bounds of its own
      haptic_before_ = haptic_;
      haptic_before_at_ = place_hand(hand_, haptic_);
    } else if (follow_object(placed_before)) {
      work_.operations = 0;
    }
    const bool apart = (haptic_.position - state_.graphic.position).norm() > settings_.release_beyond_m;
    HandPlacement haptic_at;
    const bool left_behind = (apart || release_.active()) && free(haptic_, haptic_at);
    const Configuration aim = release_.aim({settings_.release_after_s, settings_.release_beyond_m}, hand_, object_,
                                           haptic_, state_.graphic, left_behind, dt_s);
    const Vec3 shown = state_.graphic.position;
    status |= solve_({hand_, palm_, object_, settings_}, aim, state_, work_);
    const double led = (state_.graphic.position - shown).norm() - (haptic_.position - haptic_before_.position).norm();
    arriving |= gain_ == 0 && led > kLed;
    fading = release_.active();
    if (fading) status |= kReleasing;
  } else {
    status |= kBadSample;
    filter_.started = false;
    fade_s = std::max(fade_s - sample.held_s, kQuickestFade * fade_s);
  }
  const double pace = fading ? -1 : arriving ? 0 : 1;
  // Rounding must not leave a last trace of a force.
  gain_ = std::clamp(gain_ + pace * dt_s / fade_s, 0.0, 1.0);
  if (gain_ < 1e-9) gain_ = 0;
  if (gain_ < 1 && !fading) status |= kRecovering;
  result_.time_s = sample.time_s;
  result_.status = status;
  report(haptic_, (status & kBadSample) == 0);
  return result_;
}

// Poses, forces and contacts of the state, turned from the object's frame into the world's.
void Session::report(const Configuration& haptic, bool touching) {
  const Quat turn = to_quat(placed_.rotation_wxyz).normalized();
  const Vec3 shift = to_vec3(placed_.position_m);
  const bool identity = placed_.rotation_wxyz == std::array<double, 4>{1, 0, 0, 0};
  const auto direction = [&](const Vec3& v) { return identity ? v : Vec3(turn * v); };
  const auto point = [&](const Vec3& p) { return Vec3(direction(p) + shift); };

  Configuration world = state_.graphic;
  world.position = point(world.position);
  if (!identity) world.rotation = turn * world.rotation;
  result_.graphic = to_pose(world);
  result_.haptic = haptic_pose_;
  result_.object = placed_;
  result_.operations = work_.operations;

  const HandPlacement haptic_at = place_hand(hand_, haptic);
  const Forces spring = spring_forces(hand_, state_.graphic, state_.placement, haptic, haptic_at);
  const double step = settings_.force_step_n;
  felt_ = step == 0
              ? spring
              : follow(felt_, spring, force_steps(hand_, haptic, haptic_at, haptic_before_, haptic_before_at_, step));
  const Forces forces = faded(felt_, gain_);
  haptic_before_ = haptic;
  haptic_before_at_ = haptic_at;
  result_.palm_force_n = to_array(direction(forces.palm_force));
  result_.palm_torque_n_m = to_array(direction(forces.palm_torque));
  result_.joint_torque_n_m = forces.joint_torque;
  for (int f = 0; f < kFingers; ++f) {
    const Vec3 tip = direction(forces.fingertip[f]);
    std::copy_n(tip.data(), 3, &result_.fingertip_force_n[3 * f]);
  }

  std::array<Vec3, kFingers> eq14;
  eq14.fill(Vec3::Zero());
  std::uint32_t count = 0;
  const Candidates& candidates = work_.candidates;
  for (int link = 0; link < kLinks && touching; ++link) {
    for (int i = candidates.begin(link); i < candidates.end(link); ++i) {
      if (work_.gap[i] > kContactGap) continue;
      if (count == kContactCapacity) {
        result_.status |= kContactsCut;
        break;
      }
      const Vec3 sphere = candidates.center(i);
      Contact& contact = contacts_[count++];
      contact.link = std::uint8_t(link);
      contact.object_sphere = object_.number[candidates.object_sphere[i]];
      contact.palm_sphere = candidates.palm_sphere[i];
      contact.gap_m = work_.gap[i];
      contact.force_n = 0;
      for (int k = 0; k < work_.active_count; ++k)
        if (work_.active[k].candidate == i)
          contact.force_n = gain_ * work_.active[k].multiplier / (link == 0 ? settings_.palm_priority : 1.0);
      Vec3 center, normal;
      double radius;
      if (link == 0) {
        const PalmSphere& mine = hand_.palm[candidates.palm_sphere[i]];
        center = state_.placement.rotation * mine.center + state_.placement.position;
        radius = mine.radius;
        normal = (center - sphere).normalized();
      } else {
        const CapsuleGap c = capsule_sphere_gap(state_.placement.phalanx[link - 1], sphere, candidates.radius[i]);
        center = c.axis, radius = c.radius, normal = c.normal;
      }
      const Vec3 on_hand = center - radius * normal;
      contact.point_m = to_array(point(on_hand));
      contact.normal = to_array(direction(normal));
      if (link > 0)
        eq14[(link - 1) / kPhalanges] += equation14_force(hand_, link, on_hand, normal, state_.placement, haptic_at);
    }
  }
  result_.contacts = count;
  for (int f = 0; f < kFingers; ++f) {
    const Vec3 sum = gain_ * direction(eq14[f]);
    std::copy_n(sum.data(), 3, &result_.equation14_force_n[3 * f]);
  }
  result_.state_hash = hash_state();
}

std::uint64_t Session::hash_state() const {
  std::uint64_t hash = 14695981039346656037ull;
  mix(hash, state_.graphic.position.data(), 24);
  mix(hash, state_.graphic.rotation.coeffs().data(), 32);
  mix(hash, state_.graphic.abduction.data(), sizeof state_.graphic.abduction);
  mix(hash, state_.graphic.flexion.data(), sizeof state_.graphic.flexion);
  mix(hash, haptic_before_.position.data(), 24);
  mix(hash, haptic_before_.rotation.coeffs().data(), 32);
  mix(hash, felt_.palm_force.data(), 24);
  mix(hash, felt_.palm_torque.data(), 24);
  mix(hash, felt_.joint_torque.data(), sizeof felt_.joint_torque);
  for (const Vec3& tip : felt_.fingertip) mix(hash, tip.data(), 24);
  mix(hash, &gain_, sizeof gain_);
  mix(hash, state_.reach.data(), sizeof state_.reach);
  mix(hash, state_.velocity.data(), sizeof state_.velocity);
  for (int k = 0; k < state_.pressing_count; ++k) {
    const Pressing& p = state_.pressing[k];
    mix(hash, &p.link, sizeof p.link);
    mix(hash, &p.object_sphere, sizeof p.object_sphere);
    mix(hash, &p.palm_sphere, sizeof p.palm_sphere);
    mix(hash, &p.multiplier, sizeof p.multiplier);
  }
  mix(hash, &state_.at_limit, sizeof state_.at_limit);
  mix(hash, state_.haptic.abduction.data(), sizeof state_.haptic.abduction);
  mix(hash, state_.haptic.flexion.data(), sizeof state_.haptic.flexion);
  return hash;
}

Timing Session::timing() const {
  Timing t;
  t.search_us = work_.search_us;
  t.solve_us = work_.solve_us;
  t.verify_us = work_.verify_us;
  return t;
}

}  // namespace palmar
