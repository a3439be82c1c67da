// A pack's hand and one object, settings, and the last answer: the thing you step.
#pragma once

#include <memory>
#include <span>

#include "filter.h"
#include "pack_file.h"
#include "release.h"
#include "solver.h"

namespace palmar {

class Session {
 public:
  // Throws Error (E-CONF-...) if the settings ask for what is not there. Allocates all that a step needs.
  Session(HandModel hand, std::vector<Sphere> object, Settings settings);

  // One step towards a sample of the haptic hand. Never throws, allocates, locks, or calls the system. A sample that is
  // not tracked, not finite or over 1 km away leaves the hand where it is, and the status says so. The reference is
  // valid until the next step.
  const StepResult& step(const Sample& sample);

  std::span<const Contact> contacts() const { return {contacts_.data(), std::size_t(result_.contacts)}; }
  // search_us, solve_us and verify_us of the last step; who steps measures the whole.
  Timing timing() const;
  const HandModel& hand() const { return hand_; }
  const Settings& settings() const { return settings_; }

 private:
  bool usable(const Sample& sample) const;
  Configuration inside_limits(Configuration q, bool& clipped) const;
  bool free(const Configuration& q, HandPlacement& at);
  bool put_at(const Configuration& q);
  void come_near(double joint_step_rad);
  bool follow_object(const Placement& before);
  double seconds_since_last(double time_s);
  void report(const Configuration& haptic, bool touching);
  std::uint64_t hash_state() const;

  HandModel hand_;
  PalmGroups palm_;
  CollisionObject object_;
  Settings settings_;
  SolveFunction solve_;
  Workspace work_;
  SolverState state_;
  Configuration haptic_;         // last usable one, object frame
  Configuration haptic_before_;  // the one that felt_ was given for
  HandPlacement haptic_before_at_;
  Forces felt_;      // object frame, before fading
  double gain_ = 1;  // share of the forces that is given
  double time_s_;    // of the sample before; not finite before the first
  FilterState filter_;
  Release release_;
  Placement placed_;      // world from object, of the last usable sample
  HandPose haptic_pose_;  // as it came, world
  StepResult result_;
  std::vector<Contact> contacts_;
};

}  // namespace palmar
