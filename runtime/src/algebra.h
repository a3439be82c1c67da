// Vectors, rotations, and nothing else. Double precision, metres and radians.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cmath>

#include "trig.h"

namespace palmar {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Quat = Eigen::Quaterniond;

inline Vec3 to_vec3(const std::array<double, 3>& a) { return {a[0], a[1], a[2]}; }
inline std::array<double, 3> to_array(const Vec3& v) { return {v.x(), v.y(), v.z()}; }
inline Quat to_quat(const std::array<double, 4>& wxyz) { return {wxyz[0], wxyz[1], wxyz[2], wxyz[3]}; }
inline std::array<double, 4> to_array(const Quat& q) { return {q.w(), q.x(), q.y(), q.z()}; }

// Rotation by `angle` about a unit axis (Rodrigues).
inline Mat3 rotation_about(const Vec3& axis, double angle) {
  const auto [s, c] = sine_cosine(angle);
  const double t = 1.0 - c;
  const double x = axis.x(), y = axis.y(), z = axis.z();
  Mat3 m;
  m << t * x * x + c, t * x * y - s * z, t * x * z + s * y,  //
      t * x * y + s * z, t * y * y + c, t * y * z - s * x,   //
      t * x * z - s * y, t * y * z + s * x, t * z * z + c;
  return m;
}

// The rotation by the vector's length about its direction.
inline Quat rotation_exp(const Vec3& v) {
  const double half = 0.5 * v.norm();
  const auto [sine, cosine] = sine_cosine(half);
  // sin(h)/h to fourth order near 0, where the quotient loses its digits.
  const double k = half < 1e-4 ? 0.5 * (1.0 - half * half / 6.0) : 0.5 * sine / half;
  return {cosine, k * v.x(), k * v.y(), k * v.z()};
}

// The shortest rotation vector of a unit quaternion, length in [0, pi].
inline Vec3 rotation_log(const Quat& q) {
  const double sign = q.w() < 0 ? -1.0 : 1.0;
  const Vec3 v = sign * q.vec();
  const double s = v.norm(), w = sign * q.w();
  const double k = s < 1e-6 ? 2.0 / w : 2.0 * arc_tangent(s, w) / s;
  return k * v;
}

}  // namespace palmar
