#include "inside_ball.h"

#include <algorithm>
#include <cmath>

namespace palmar {
namespace {

// Radius of the ball behind `point` that has `other` on its skin.
double tangent_radius(const Vec3& point, const Vec3& inward, const Vec3& other, double radius) {
  const Vec3 chord = other - point;
  const double depth = inward.dot(chord);
  return depth > 0 ? std::min(chord.squaredNorm() / (2 * depth), radius) : 0.5 * radius;
}

}  // namespace

std::optional<InsideBall> shoot(const TriangleTree& tree, const Vec3& point, const Vec3& inward, std::int32_t face,
                                double slack, double start) {
  const double rounding = kSurfaceRounding * tree.size();
  double radius = start;
  for (int round = 0; round < 24; ++round) {
    const Vec3 center = point + radius * inward;
    const Closest found = tree.closest(center, face);
    const double distance = std::sqrt(found.squared);
    face = found.face;
    if (distance >= radius - slack - rounding) {
      if (distance < kSmallestBall * tree.size()) return {};
      // The ball is free of surface; what lies between it and the point must be too.
      const double open = radius - distance;
      if (open > 0 && tree.crosses(point + rounding * inward, point + (open + rounding) * inward)) return {};
      return InsideBall{center, distance, found.face, distance};
    }
    radius = tangent_radius(point, inward, found.point, radius);
  }
  return {};
}

double held_inside(const std::vector<Zone>& zones, const Vec3& center, double inside, double excess) {
  double held = inside;
  for (const Zone& zone : zones) {
    const double less = (1 - zone.share) * excess;
    held = std::min(held, std::sqrt(zone.tree->closest(center).squared) - less);
  }
  return held;
}

}  // namespace palmar
