// Six objects made of leaf spheres, 80 to 100 mm large, at any count: the same surface, covered more or less finely.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "sphere_tree.h"

namespace palmar::made {

constexpr double kGoldenTurn = 2.399963229728653;    // pi (3 - sqrt 5)
constexpr double kGoldenShare = 0.6180339887498949;  // (sqrt 5 - 1) / 2

// A piece of a surface by its area and a map of the unit square onto it that keeps area.
struct Patch {
  double area;
  enum Kind { rectangle, disc, side, cap, ball } kind;
  Vec3 center;
  Vec3 u, v;      // half sides of a rectangle; across and along (half length) for a side; radius along u for a disc
  double inset;   // how far under the surface the leaves' centres lie
  Vec3 normal;    // of a rectangle, disc and cap: outwards
  double radius;  // of a side, cap, ball

  // Point i of n, evenly spread: a Fibonacci lattice over the square.
  Vec3 point(int i, int n) const {
    const double a = (i + 0.5) / n, b = i * kGoldenShare - std::floor(i * kGoldenShare);
    const SineCosine turned = sine_cosine(kGoldenTurn * i);
    switch (kind) {
      case rectangle:
        return center + (2 * a - 1) * u + (2 * b - 1) * v - inset * normal;
      case disc:
        return center + std::sqrt(a) * (turned.cosine * u + turned.sine * v) - inset * normal;
      case side: {
        const Vec3 w = v.normalized().cross(u.normalized());
        return center + (2 * a - 1) * v + (radius - inset) * (turned.cosine * u.normalized() + turned.sine * w);
      }
      default: {
        const double z = kind == cap ? a : 1 - 2 * a, r = std::sqrt(1 - z * z);
        const Vec3 x = normal.unitOrthogonal(), y = normal.cross(x);
        return center + (radius - inset) * (z * normal + r * turned.cosine * x + r * turned.sine * y);
      }
    }
  }
};

// Exactly `count` leaves of one radius, shared among the patches by area.
inline std::vector<Sphere> cover(const std::vector<Patch>& patches, int count, double leaf) {
  double total = 0, before = 0;
  for (const Patch& p : patches) total += p.area;
  std::vector<Sphere> spheres;
  for (const Patch& p : patches) {
    const int begin = int(std::lround(count * before / total));
    const int n = int(std::lround(count * (before + p.area) / total)) - begin;
    for (int i = 0; i < n; ++i) spheres.push_back({p.point(i, n), leaf});
    before += p.area;
  }
  return spheres;
}

// Leaves a tenth larger than their spacing, so that none stands alone; not larger than a thin part can hold.
inline double leaf_radius(double area, int count, double most) {
  return std::min(most, std::max(1e-3, 1.1 * std::sqrt(area / count)));
}

inline void add_block(std::vector<Patch>& patches, const Vec3& center, const Vec3& half, double leaf) {
  for (int axis = 0; axis < 3; ++axis)
    for (int way = -1; way <= 1; way += 2) {
      const int b = (axis + 1) % 3, c = (axis + 2) % 3;
      Patch p{4 * half[b] * half[c], Patch::rectangle, center, Vec3::Zero(), Vec3::Zero(), leaf, Vec3::Zero(), 0};
      p.normal[axis] = way;
      p.center[axis] += way * half[axis];
      p.u[b] = half[b] - leaf;
      p.v[c] = half[c] - leaf;
      patches.push_back(p);
    }
}

inline void add_cylinder(std::vector<Patch>& patches, const Vec3& center, const Vec3& half, double radius,
                         double leaf) {
  const Vec3 along = half.normalized(), across = along.unitOrthogonal();
  patches.push_back(
      {4 * M_PI * radius * half.norm(), Patch::side, center, across, half - leaf * along, leaf, along, radius});
}

inline void add_disc(std::vector<Patch>& patches, const Vec3& center, const Vec3& normal, double radius, double leaf) {
  const Vec3 u = normal.unitOrthogonal(), v = normal.cross(u);
  patches.push_back(
      {M_PI * radius * radius, Patch::disc, center, (radius - leaf) * u, (radius - leaf) * v, leaf, normal, radius});
}

inline const std::vector<std::string>& object_names() {
  static const std::vector<std::string> names = {"ball", "cube", "slot", "bar", "cup", "ears"};
  return names;
}

// `gap_m` is the slot's width, and that between the ears.
inline std::vector<Sphere> object(const std::string& name, int count, double gap_m = 0.014) {
  const Vec3 x(1, 0, 0), z(0, 0, 1), none(0, 0, 0);
  std::vector<Patch> patches;
  double leaf = 0;
  if (name == "ball") {
    leaf = leaf_radius(4 * M_PI * 0.045 * 0.045, count, 0.006);
    patches.push_back({1, Patch::ball, none, none, none, leaf, z, 0.045});
  } else if (name == "cube") {
    leaf = leaf_radius(6 * 0.08 * 0.08, count, 0.006);
    add_block(patches, none, Vec3(0.04, 0.04, 0.04), leaf);
  } else if (name == "slot") {
    const Vec3 half(0.02, 0.04, 0.04);
    leaf = leaf_radius(2 * 8 * (0.02 * 0.04 * 2 + 0.04 * 0.04), count, 0.006);
    for (int side = -1; side <= 1; side += 2) add_block(patches, side * (0.5 * gap_m + 0.02) * x, half, leaf);
  } else if (name == "bar") {
    leaf = leaf_radius(2 * M_PI * 0.008 * 0.1, count, 0.004);
    add_cylinder(patches, none, 0.05 * x, 0.008, leaf);
    for (int way = -1; way <= 1; way += 2) add_disc(patches, 0.05 * way * x, way * x, 0.008, leaf);
  } else if (name == "cup") {
    leaf = 0.0015;  // one layer of balls on the middle of a 3 mm wall
    patches.push_back({2 * M_PI * 0.042 * 0.08, Patch::side, none, x, 0.04 * z, 0, z, 0.042});
    patches.push_back({M_PI * 0.042 * 0.042, Patch::disc, -0.04 * z, 0.042 * x, 0.042 * z.cross(x), 0, z, 0});
  } else if (name == "ears") {
    const double body = 0.035, ear = 0.008;
    leaf = leaf_radius(4 * M_PI * body * body + 2 * 2 * M_PI * ear * (0.037 + ear), count, 0.004);
    patches.push_back({4 * M_PI * body * body, Patch::ball, none, none, none, leaf, z, body});
    for (int way = -1; way <= 1; way += 2) {
      const Vec3 root = way * (0.5 * gap_m + ear) * x + 0.02 * z;
      add_cylinder(patches, root + 0.0185 * z, (0.0185 + leaf) * z, ear, leaf);
      patches.push_back({2 * M_PI * ear * ear, Patch::cap, root + 0.037 * z, none, none, leaf, z, ear});
    }
  }
  return cover(patches, count, leaf);
}

}  // namespace palmar::made
