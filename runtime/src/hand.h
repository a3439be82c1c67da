// The hybrid hand: palm spheres and fifteen tapered capsules, and where they are for a configuration.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "algebra.h"
#include "records.h"

namespace palmar {

constexpr int kFingers = 5;
constexpr int kPhalanges = 3;
constexpr int kLinks = 16;      // palm, then 1 + 3 finger + phalanx
constexpr int kVariables = 26;  // palm translation 3, palm rotation 3, then abduction and three flexions of each finger
constexpr int kPalmVariables = 6;
constexpr int kFingerVariables = 4;

struct PalmSphere {
  Vec3 center;
  double radius;
};

// Convex hull of a ball of radius r1 about c1 and one of radius r2 about c2.
struct Capsule {
  Vec3 c1, c2;
  double r1, r2;
};

struct Finger {
  std::array<Vec3, 3> joint;         // palm frame, zero pose
  std::array<Vec3, 3> flexion_axis;  // unit
  Vec3 abduction_axis;               // unit, through joint[0]
  std::array<Capsule, 3> phalanx;
  std::array<std::array<double, 2>, 3> flexion_limit;
  std::array<double, 2> abduction_limit;
  std::array<double, 3> stiffness;       // N m / rad
  double lever[kPhalanges][kPhalanges];  // [j][k]: no point of phalanx k's axis is farther from joint j, in any pose
};

struct HandModel {
  std::vector<PalmSphere> palm;
  std::array<Finger, kFingers> finger;
  double palm_stiffness = 1000;         // N / m
  double palm_rotation_stiffness = 10;  // N m / rad
  Vec3 palm_low, palm_high;             // box around the palm spheres' centres
  double reach = 0;                     // no point of the hand is farther from the palm's origin, in any pose
  std::uint32_t left_out = 0;           // bit l: link l touches nothing

  // Fills the box, the levers and the reach from the rest.
  void finish();
};

// Links of parts named palm, thumb, index, middle, ring, little with + between them, as bits; none for "none". Throws
// Error E-CONF-VALUE.
std::uint32_t links_of(const std::string& parts);

// The frustum's tapered capsule: spheres tangent to its side along the two rims (docs/formats.md).
Capsule capsule_of_frustum(const Vec3& d, const Vec3& e, double r1, double r2);

// A pose in the numbers that the solver changes.
struct Configuration {
  Vec3 position{0, 0, 0};
  Quat rotation{1, 0, 0, 0};
  std::array<double, kFingers> abduction{};
  std::array<std::array<double, 3>, kFingers> flexion{};
};

using Change = std::array<double, kVariables>;

Configuration to_configuration(const HandPose& pose);
HandPose to_pose(const Configuration& q);

// q moved by `fraction` of a change; the rotation part of a change is a rotation vector in the outer frame.
Configuration advance(const Configuration& q, const Change& change, double fraction);

// The change that leads from q to target.
Change difference(const Configuration& target, const Configuration& q);

// Where everything is, in the frame that q is given in.
struct HandPlacement {
  Vec3 position;
  Mat3 rotation;
  std::array<Capsule, 15> phalanx;
  std::array<Vec3, kFingers> abduction_axis;
  std::array<std::array<Vec3, 3>, kFingers> joint, flexion_axis;
};

HandPlacement place_hand(const HandModel& hand, const Configuration& q);

// No point of link `l` moved farther than this between two placements: end spheres for a phalanx (points of its axis
// move by interpolation between them), the corners of the palm's box for the palm (displacement is convex in the
// point).
double link_motion(const HandModel& hand, const HandPlacement& a, const HandPlacement& b, int link);
double largest_motion(const HandModel& hand, const HandPlacement& a, const HandPlacement& b);

}  // namespace palmar
