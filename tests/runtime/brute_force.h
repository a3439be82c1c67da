// How deep a hand is in an object, by its own kinematics and its own distance, against every sphere one by one. Shares
// nothing with the solver but the hand's numbers: it judges what the solver publishes.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <limits>
#include <vector>

#include "hand.h"
#include "sphere_tree.h"
#include "wide.h"

namespace palmar::made {

// Union of balls along a segment, radius linear from r1 to r2; a palm sphere is one of no length.
struct Round {
  Vec3 from, to;
  double r1, r2;
  int link;
};

// Every palm sphere and phalanx in the frame that the pose is given in: rotations as chained rigid transforms.
inline std::vector<Round> rounds_of(const HandModel& hand, const HandPose& pose) {
  using Eigen::AngleAxisd, Eigen::Isometry3d, Eigen::Translation3d;
  const auto about = [](const Vec3& point, const Vec3& axis, double angle) -> Isometry3d {
    return Translation3d(point) * AngleAxisd(angle, axis) * Translation3d(-point);
  };
  const Isometry3d palm = Translation3d(to_vec3(pose.palm.position_m)) * to_quat(pose.palm.rotation_wxyz).normalized();
  std::vector<Round> rounds;
  for (const PalmSphere& s : hand.palm) rounds.push_back({palm * s.center, palm * s.center, s.radius, s.radius, 0});
  for (int f = 0; f < kFingers; ++f) {
    const Finger& finger = hand.finger[f];
    Isometry3d carry = palm * about(finger.joint[0], finger.abduction_axis, pose.abduction_rad[f]);
    for (int j = 0; j < kPhalanges; ++j) {
      carry = carry * about(finger.joint[j], finger.flexion_axis[j], pose.flexion_rad[3 * f + j]);
      const Capsule& c = finger.phalanx[j];
      rounds.push_back({carry * c.c1, carry * c.c2, c.r1, c.r2, 1 + 3 * f + j});
    }
  }
  return rounds;
}

// The pose seen from an object's frame.
inline HandPose seen_from(const Placement& object, const HandPose& pose) {
  const Eigen::Isometry3d world =
      Eigen::Translation3d(to_vec3(object.position_m)) * to_quat(object.rotation_wxyz).normalized();
  const Eigen::Isometry3d inside = world.inverse();
  HandPose seen = pose;
  seen.palm.position_m = to_array(Vec3(inside * to_vec3(pose.palm.position_m)));
  seen.palm.rotation_wxyz = to_array(Quat(inside.rotation() * to_quat(pose.palm.rotation_wxyz).normalized()));
  return seen;
}

// A ball's distance from a round, by reduction to the plane through the segment: the ball lies t along it and rho off
// it, and the least of three distances counts: from the two end balls, and from the straight side (valid where the foot
// of the side's normal, which leans by k = (r1 - r2) / L, falls on the segment).
template <class Real>
inline Real round_distance(Real t, Real rho, Real length, Real k, Real cosine, Real r1, Real r2) {
  const Real a = std::sqrt(t * t + rho * rho) - r1;
  const Real b = std::sqrt((t - length) * (t - length) + rho * rho) - r2;
  const Real side = rho * cosine + t * k - r1;
  const Real foot = t * cosine - rho * k;  // times 1 / cosine
  const Real ends = a < b ? a : b;
  return foot >= Real(0) && foot <= length * cosine ? side : ends;
}

struct Deepest {
  double gap_m = std::numeric_limits<double>::infinity();  // negative inside
  int link = -1;
  std::uint32_t sphere = 0;
};

// All leaves of an object in rows of sixteen.
class BruteForce {
 public:
  explicit BruteForce(const std::vector<Sphere>& spheres) : spheres_(spheres), rows_((spheres.size() + 15) / 16) {
    for (std::size_t i = 0; i < 16 * rows_.size(); ++i) {
      Row& row = rows_[i / 16];
      const bool real = i < spheres.size();
      const Vec3 c = real ? spheres[i].center : Vec3(1e6, 1e6, 1e6);
      row.x[i % 16] = float(c.x()), row.y[i % 16] = float(c.y()), row.z[i % 16] = float(c.z());
      row.r[i % 16] = real ? float(spheres[i].radius) : 0.0f;
    }
  }

  // The pose is in the object's frame. Gaps above 0.1 mm are only good to float.
  Deepest deepest(const HandModel& hand, const HandPose& pose) const {
    Deepest deepest;
    for (const Round& round : rounds_of(hand, pose)) {
      const double least = least_in_float(round);
      if (least > 1e-4) {
        if (least < deepest.gap_m) deepest = {least, round.link, 0};
        continue;
      }
      // Float rounding of 0.3 m coordinates, and the root of a difference of squares near the axis: below 20 um.
      float gaps[16];
      for (std::size_t row = 0; row < rows_.size(); ++row) {
        row_gaps(&rows_[row], 1, query(round), gaps, nullptr);
        for (int lane = 0; lane < 16; ++lane) {
          if (gaps[lane] > least + 2e-5) continue;
          const std::uint32_t i = std::uint32_t(16 * row + lane);
          if (i >= spheres_.size()) continue;
          const double gap = exact(round, spheres_[i]);
          if (gap < deepest.gap_m) deepest = {gap, round.link, i};
        }
      }
    }
    return deepest;
  }

  static double exact(const Round& round, const Sphere& sphere) {
    const Vec3 along = round.to - round.from, off = sphere.center - round.from;
    const double length = along.norm();
    if (length == 0) return off.norm() - std::max(round.r1, round.r2) - sphere.radius;
    const Vec3 u = along / length;
    const double k = (round.r1 - round.r2) / length;
    return round_distance(off.dot(u), off.cross(u).norm(), length, k, std::sqrt(1 - k * k), round.r1, round.r2) -
           sphere.radius;
  }

 private:
  struct alignas(64) Row {
    float x[16], y[16], z[16], r[16];
  };
  struct Query {
    float x, y, z, ux, uy, uz, length, k, cosine, r1, r2;
  };

  static Query query(const Round& round) {
    const Vec3 along = round.to - round.from;
    const double length = along.norm();
    const Vec3 u = length > 0 ? Vec3(along / length) : Vec3(0, 0, 1);
    const double k = length > 0 ? (round.r1 - round.r2) / length : 0;
    return {float(round.from.x()),
            float(round.from.y()),
            float(round.from.z()),
            float(u.x()),
            float(u.y()),
            float(u.z()),
            float(length),
            float(k),
            float(std::sqrt(1 - k * k)),
            float(round.r1),
            float(round.r2)};
  }

  // Gaps of the last row into `gaps`, and the least of each lane into `least` if there is one.
  PALMAR_WIDE static void row_gaps(const Row* rows, std::size_t count, const Query q, float* __restrict gaps,
                                   float* __restrict least) {
    for (std::size_t row = 0; row < count; ++row) {
      const Row& s = rows[row];
      for (int i = 0; i < 16; ++i) {
        const float dx = s.x[i] - q.x, dy = s.y[i] - q.y, dz = s.z[i] - q.z;
        const float t = dx * q.ux + dy * q.uy + dz * q.uz;
        // |d x u|, not the root of |d|^2 - t^2: no digits lost for a ball near the axis.
        const float cx = dy * q.uz - dz * q.uy, cy = dz * q.ux - dx * q.uz, cz = dx * q.uy - dy * q.ux;
        const float rho2 = cx * cx + cy * cy + cz * cz, rho = __builtin_sqrtf(rho2);
        const float a = __builtin_sqrtf(t * t + rho2) - q.r1;
        const float b = __builtin_sqrtf((t - q.length) * (t - q.length) + rho2) - q.r2;
        const float side = rho * q.cosine + t * q.k - q.r1;
        const float foot = t * q.cosine - rho * q.k;
        const float ends = a < b ? a : b;
        // The side's line never lies above the end balls where it is valid, and its phantom beyond them is cut off.
        const float outside = foot < 0.0f ? 1.0f : (foot > q.length * q.cosine ? 1.0f : 0.0f);
        gaps[i] = outside * ends + (1.0f - outside) * side - s.r[i];
      }
      if (least != nullptr)
        for (int i = 0; i < 16; ++i) least[i] = gaps[i] < least[i] ? gaps[i] : least[i];
    }
  }

  double least_in_float(const Round& round) const {
    alignas(64) float least[16], gaps[16];
    std::fill_n(least, 16, std::numeric_limits<float>::max());
    row_gaps(rows_.data(), rows_.size(), query(round), gaps, least);
    return *std::min_element(least, least + 16);
  }

  std::vector<Sphere> spheres_;
  std::vector<Row> rows_;
};

}  // namespace palmar::made
