// What the user feels, from where the two hands are. All in the frame that the placements are given in.
#pragma once

#include "contacts.h"
#include "hand.h"

namespace palmar {

struct Forces {
  Vec3 palm_force{0, 0, 0};
  Vec3 palm_torque{0, 0, 0};
  std::array<double, 15> joint_torque{};
  std::array<Vec3, kFingers> fingertip;

  Forces() { fingertip.fill(Vec3::Zero()); }
};

// How far each force may go in one step: what the haptic hand's own motion explains, and `step` newtons more (`step` x
// 50 mm for torques). When a contact is lost the spring's force falls at once; what the user feels must not.
struct ForceSteps {
  double palm_force = 0, palm_torque = 0;
  std::array<double, 15> joint_torque{};
  std::array<double, kFingers> fingertip{};
};
ForceSteps force_steps(const HandModel& hand, const Configuration& haptic, const HandPlacement& haptic_at,
                       const Configuration& before, const HandPlacement& before_at, double step);

// `felt` moved towards `spring` by at most `steps`; equal to it, bit for bit, where that suffices.
Forces follow(const Forces& felt, const Forces& spring, const ForceSteps& steps);

// The same in another frame.
Forces turned(const Forces& forces, const Quat& turn);

// `gain` times each of them.
Forces faded(const Forces& forces, double gain);

// F = G (q_g - q_h), Eqs. 1 and 2, and the paper's fingertip normal force F_N: palm_stiffness times the part of the way
// from haptic to graphic fingertip that is across the graphic distal phalanx (the vector EB2 of Fig. 9b).
Forces spring_forces(const HandModel& hand, const Configuration& graphic, const HandPlacement& graphic_at,
                     const Configuration& haptic, const HandPlacement& haptic_at);

// The paper's Eq. 14 for one contact: stiffness |p_g - p_h| along the normal, p_h the same material point on the haptic
// hand.
Vec3 equation14_force(const HandModel& hand, int link, const Vec3& point, const Vec3& normal,
                      const HandPlacement& graphic_at, const HandPlacement& haptic_at);

}  // namespace palmar
