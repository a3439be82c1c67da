#include "force.h"

namespace palmar {

namespace {

// Axes of a link's own frame: along the phalanx, along its flexion axis as far as that is across, and the third.
Mat3 link_frame(const HandPlacement& at, int link) {
  if (link == 0) return at.rotation;
  const Capsule& c = at.phalanx[link - 1];
  const int f = (link - 1) / kPhalanges, j = (link - 1) % kPhalanges;
  const Vec3 u = (c.c2 - c.c1).normalized();
  const Vec3 v = (at.flexion_axis[f][j] - at.flexion_axis[f][j].dot(u) * u).normalized();
  Mat3 m;
  m.col(0) = u;
  m.col(1) = v;
  m.col(2) = u.cross(v);
  return m;
}

Vec3 link_origin(const HandPlacement& at, int link) { return link == 0 ? at.position : at.phalanx[link - 1].c1; }

Vec3 towards(const Vec3& from, const Vec3& to, double step) {
  const Vec3 way = to - from;
  const double length = way.norm();
  return length <= step ? to : Vec3(from + step / length * way);
}

}  // namespace

Forces spring_forces(const HandModel& hand, const Configuration& graphic, const HandPlacement& graphic_at,
                     const Configuration& haptic, const HandPlacement& haptic_at) {
  Forces forces;
  const Change d = difference(graphic, haptic);
  forces.palm_force = hand.palm_stiffness * Vec3(d[0], d[1], d[2]);
  forces.palm_torque = hand.palm_rotation_stiffness * Vec3(d[3], d[4], d[5]);
  for (int f = 0; f < kFingers; ++f) {
    for (int j = 0; j < kPhalanges; ++j)
      forces.joint_torque[3 * f + j] = hand.finger[f].stiffness[j] * d[kPalmVariables + kFingerVariables * f + 1 + j];
    const Capsule& tip = graphic_at.phalanx[3 * f + 2];
    const Vec3 u = (tip.c2 - tip.c1).normalized();
    const Vec3 way = tip.c2 - haptic_at.phalanx[3 * f + 2].c2;
    forces.fingertip[f] = hand.palm_stiffness * (way - way.dot(u) * u);
  }
  return forces;
}

ForceSteps force_steps(const HandModel& hand, const Configuration& haptic, const HandPlacement& haptic_at,
                       const Configuration& before, const HandPlacement& before_at, double step) {
  constexpr double kLever = 0.05;  // metres, of a finger: what turns a force step into a torque step
  const Change d = difference(haptic, before);
  ForceSteps steps;
  steps.palm_force = hand.palm_stiffness * Vec3(d[0], d[1], d[2]).norm() + step;
  steps.palm_torque = hand.palm_rotation_stiffness * Vec3(d[3], d[4], d[5]).norm() + step * hand.reach;
  for (int f = 0; f < kFingers; ++f) {
    for (int j = 0; j < kPhalanges; ++j)
      steps.joint_torque[3 * f + j] =
          hand.finger[f].stiffness[j] * std::abs(d[kPalmVariables + kFingerVariables * f + 1 + j]) + step * kLever;
    const double tip = (haptic_at.phalanx[3 * f + 2].c2 - before_at.phalanx[3 * f + 2].c2).norm();
    steps.fingertip[f] = hand.palm_stiffness * tip + step;
  }
  return steps;
}

Forces follow(const Forces& felt, const Forces& spring, const ForceSteps& steps) {
  Forces out;
  out.palm_force = towards(felt.palm_force, spring.palm_force, steps.palm_force);
  out.palm_torque = towards(felt.palm_torque, spring.palm_torque, steps.palm_torque);
  for (int i = 0; i < 15; ++i) {
    const double way = spring.joint_torque[i] - felt.joint_torque[i];
    out.joint_torque[i] = std::abs(way) <= steps.joint_torque[i]
                              ? spring.joint_torque[i]
                              : felt.joint_torque[i] + std::copysign(steps.joint_torque[i], way);
  }
  for (int f = 0; f < kFingers; ++f)
    out.fingertip[f] = towards(felt.fingertip[f], spring.fingertip[f], steps.fingertip[f]);
  return out;
}

Forces turned(const Forces& forces, const Quat& turn) {
  Forces out = forces;
  out.palm_force = turn * forces.palm_force;
  out.palm_torque = turn * forces.palm_torque;
  for (int f = 0; f < kFingers; ++f) out.fingertip[f] = turn * forces.fingertip[f];
  return out;
}

Forces faded(const Forces& forces, double gain) {
  Forces out;
  out.palm_force = gain * forces.palm_force;
  out.palm_torque = gain * forces.palm_torque;
  for (int i = 0; i < 15; ++i) out.joint_torque[i] = gain * forces.joint_torque[i];
  for (int f = 0; f < kFingers; ++f) out.fingertip[f] = gain * forces.fingertip[f];
  return out;
}

Vec3 equation14_force(const HandModel& hand, int link, const Vec3& point, const Vec3& normal,
                      const HandPlacement& graphic_at, const HandPlacement& haptic_at) {
  const Vec3 local = link_frame(graphic_at, link).transpose() * (point - link_origin(graphic_at, link));
  const Vec3 haptic_point = link_frame(haptic_at, link) * local + link_origin(haptic_at, link);
  return hand.palm_stiffness * (point - haptic_point).norm() * normal;
}

}  // namespace palmar
