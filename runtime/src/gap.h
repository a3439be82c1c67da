// Signed gap between a sphere and a tapered capsule (the paper's Eqs. 5-7 without their k cases), and its gradient.
#pragma once

#include <algorithm>

#include "hand.h"

namespace palmar {

struct CapsuleGap {
  double gap;     // metres, negative inside
  Vec3 axis;      // the point of the capsule's axis whose ball decides
  double radius;  // of that ball
  Vec3 normal;    // unit, from the sphere's centre to the axis point
};

// Gap of the sphere (o, r). The capsule is the union of balls about its axis, so the gap is
//   min over s in [0, L] of |o - c(s)| - (r1 - s sin(phi)) - r,
// taken at s = t - rho tan(phi), clamped (t along the axis, rho off it): continuous, with a continuous gradient.
inline CapsuleGap capsule_sphere_gap(const Capsule& c, const Vec3& o, double r) {
  const Vec3 along = c.c2 - c.c1;
  const double length = along.norm();
  const Vec3 u = length > 0 ? Vec3(along / length) : Vec3(1, 0, 0);
  const double sin_phi = length > 0 ? (c.r1 - c.r2) / length : 0.0;
  const double tan_phi = sin_phi / std::sqrt(std::max(1e-12, 1.0 - sin_phi * sin_phi));
  const Vec3 to = o - c.c1;
  const double t = to.dot(u);
  const double rho = std::sqrt(std::max(0.0, to.squaredNorm() - t * t));
  const double s = std::clamp(t - rho * tan_phi, 0.0, length);

  CapsuleGap result;
  result.axis = c.c1 + s * u;
  result.radius = c.r1 - s * sin_phi;
  const Vec3 away = result.axis - o;
  const double distance = away.norm();
  // A centre exactly on the axis has no direction: any across the axis is as good, the same one each time.
  result.normal = distance > 0 ? Vec3(away / distance) : u.unitOrthogonal().eval();
  result.gap = distance - result.radius - r;
  return result;
}

}  // namespace palmar
