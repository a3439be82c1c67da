// A hand and objects made in the test: nothing is read.
#pragma once

#include <random>

#include "gap.h"
#include "hand.h"
#include "sphere_tree.h"

namespace palmar::made {

// Palm of 5 x 6 balls, tapered phalanges, an oblique thumb.
inline HandModel hand() {
  HandModel h;
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 6; ++j) h.palm.push_back({Vec3(-0.032 + 0.016 * i, 0.005 + 0.016 * j, 0.0), 0.011});
  const double base[5][3] = {{28, 22, -6}, {28, 88, 0}, {9.5, 92, 0}, {-9.5, 87, 0}, {-28, 78, 0}};
  const double length[5][3] = {{44, 34, 27}, {42, 25, 22}, {46, 29, 23}, {42, 27, 23}, {33, 20, 20}};
  const double radius[5][4] = {{12, 11, 9, 8}, {10, 9, 8, 6}, {10, 9, 8, 6}, {10, 9, 8, 6}, {9, 8, 7, 5}};
  for (int f = 0; f < kFingers; ++f) {
    Finger& finger = h.finger[f];
    const Vec3 along = f == 0 ? Vec3(0.70, 0.62, -0.35).normalized() : Vec3(0, 1, 0);
    const Vec3 axis = f == 0 ? along.cross(Vec3(-0.75, 0.15, -0.65)).normalized() : Vec3(-1, 0, 0);
    Vec3 joint = 1e-3 * Vec3(base[f][0], base[f][1], base[f][2]);
    finger.abduction_axis = along.cross(axis).normalized();
    finger.abduction_limit = {-0.5, 0.5};
    for (int j = 0; j < kPhalanges; ++j) {
      const Vec3 end = joint + 1e-3 * length[f][j] * along;
      finger.joint[j] = joint;
      finger.flexion_axis[j] = axis;
      finger.phalanx[j] = capsule_of_frustum(joint, end, 1e-3 * radius[f][j], 1e-3 * radius[f][j + 1]);
      finger.flexion_limit[j] = {-0.4, 1.9};
      finger.stiffness[j] = 0.5;
      joint = end;
    }
  }
  h.finish();
  return h;
}

// The hand of the reference scenario (docs/formats.md names its axes): a palm of 99 balls, phalanges of one radius
// each.
inline HandModel reference_hand() {
  HandModel h;
  for (int i = 0; i < 9; ++i)
    for (int j = 0; j < 11; ++j) h.palm.push_back({Vec3(-0.036 + 0.009 * i, 0.004 + 0.008 * j, 0), 0.011});
  const double base[5][3] = {{28, 22, -6}, {28, 88, 0}, {9.5, 92, 0}, {-9.5, 87, 0}, {-28, 78, 0}};
  const double length[5][3] = {{44, 34, 27}, {42, 25, 22}, {46, 29, 23}, {42, 27, 23}, {33, 20, 20}};
  const double radius[5][3] = {{11, 10, 8.5}, {9, 8, 7}, {9, 8, 7}, {9, 8, 7}, {8, 7, 6}};
  for (int f = 0; f < kFingers; ++f) {
    Finger& finger = h.finger[f];
    const Vec3 along = f == 0 ? Vec3(0.70, 0.62, -0.35).normalized() : Vec3(0, 1, 0);
    const Vec3 axis = f == 0 ? along.cross(Vec3(-0.75, 0.15, -0.65)).normalized() : Vec3(-1, 0, 0);
    Vec3 joint = 1e-3 * Vec3(base[f][0], base[f][1], base[f][2]);
    finger.abduction_axis = along.cross(axis).normalized();
    finger.abduction_limit = {-1, 1};
    for (int j = 0; j < kPhalanges; ++j) {
      const Vec3 end = joint + 1e-3 * length[f][j] * along;
      finger.joint[j] = joint;
      finger.flexion_axis[j] = axis;
      finger.phalanx[j] = capsule_of_frustum(joint, end, 1e-3 * radius[f][j], 1e-3 * radius[f][j]);
      finger.flexion_limit[j] = {-3, 3};
      finger.stiffness[j] = 0.5;
      joint = end;
    }
  }
  h.finish();
  return h;
}

// Leaves on the skin of a ball, spaced evenly (golden spiral).
inline std::vector<Sphere> ball(int count, double radius, double leaf) {
  std::vector<Sphere> spheres;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 2 * (i + 0.5) / count, r = std::sqrt(1 - z * z);
    const SineCosine turned = sine_cosine(2.399963229728653 * i);
    spheres.push_back({(radius - leaf) * Vec3(r * turned.cosine, r * turned.sine, z), leaf});
  }
  return spheres;
}

// One layer of balls in the plane z = 0.
inline std::vector<Sphere> plate(int across, double pitch, double leaf) {
  std::vector<Sphere> spheres;
  for (int i = 0; i < across; ++i)
    for (int j = 0; j < across; ++j)
      spheres.push_back({pitch * Vec3(i - 0.5 * (across - 1), j - 0.5 * (across - 1), 0), leaf});
  return spheres;
}

// Two horns on a body: a finger between them is pressed from both sides.
inline std::vector<Sphere> ears() {
  std::vector<Sphere> spheres = ball(600, 0.03, 0.005);
  for (int side = -1; side <= 1; side += 2)
    for (int i = 0; i < 40; ++i) spheres.push_back({Vec3(side * (0.012 + 0.0002 * i), 0, 0.028 + 0.001 * i), 0.005});
  return spheres;
}

inline Configuration random_configuration(std::mt19937& rng, double spread) {
  std::uniform_real_distribution<double> u(-1, 1), flex(-0.2, 1.6);
  Configuration q;
  // One number after the other: the order of a call's arguments is each compiler's own.
  const auto vector = [&] {
    Vec3 v;
    for (int k = 2; k >= 0; --k) v[k] = u(rng);
    return v;
  };
  q.position = spread * vector();
  q.rotation = rotation_exp(1.5 * vector());
  for (int f = 0; f < kFingers; ++f) {
    q.abduction[f] = 0.3 * u(rng);
    for (int j = 0; j < kPhalanges; ++j) q.flexion[f][j] = flex(rng);
  }
  return q;
}

// The least gap of the whole hand to every sphere, one by one.
inline double brute_gap(const HandModel& hand, const std::vector<Sphere>& spheres, const HandPose& pose) {
  const HandPlacement at = place_hand(hand, to_configuration(pose));
  double least = 1e9;
  for (const Sphere& s : spheres) {
    for (const PalmSphere& p : hand.palm)
      least = std::min(least, (at.rotation * p.center + at.position - s.center).norm() - p.radius - s.radius);
    for (const Capsule& c : at.phalanx) least = std::min(least, capsule_sphere_gap(c, s.center, s.radius).gap);
  }
  return least;
}

}  // namespace palmar::made
