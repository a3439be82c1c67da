// Balls inside a solid that touch its surface.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "algebra.h"
#include "triangle_tree.h"

namespace palmar {

constexpr double kSmallestBall = 1e-5;     // of the solid's size: the radius below which nothing is a ball
constexpr double kSurfaceRounding = 1e-6;  // of the solid's size

// A centre inside the solid, its exact distance to the surface, and where it touches. `held`: the distance it counts
// with, less than `inside` near a zone of the surface that allows less.
struct InsideBall {
  Vec3 center;
  double inside;
  std::int32_t face;
  double held;
};

// A part of the surface where only a share of the error is allowed.
struct Zone {
  const TriangleTree* tree;
  double share;
};

// What a ball at a centre may count with, so that grown by `excess` it sticks out of no zone by more than the zone's
// share of it.
double held_inside(const std::vector<Zone>& zones, const Vec3& center, double inside, double excess);

// The largest ball tangent at a surface point that the surface enters by at most `slack` (Ma, Bae, Choi 2012), shrunk
// from the radius `start`; nothing where it would lie outside.
std::optional<InsideBall> shoot(const TriangleTree& tree, const Vec3& point, const Vec3& inward, std::int32_t face,
                                double slack, double start);

}  // namespace palmar
