// A union of spheres: how far points lie outside it, and its skin.
#pragma once

#include <cstdint>
#include <vector>

#include "algebra.h"

namespace palmar {

struct Ball {
  Vec3 center;
  double radius;
};

struct SkinSample {
  std::int32_t owner;  // the sphere on which it lies
  Vec3 direction;      // unit, from the sphere's centre
  double solid_angle;
};

class SphereUnion {
 public:
  explicit SphereUnion(std::vector<Ball> balls);

  // Distance from each point to the union, exact where positive; 0 or below is inside.
  std::vector<double> gaps(const std::vector<Vec3>& points) const;
  // Samples of the skin, every sphere grown by `offset`: about one for each spacing^2. A patch of a sphere inside a
  // neighbour is dropped whole, the others are split.
  std::vector<SkinSample> skin(double offset, double spacing, std::uint64_t seed) const;

 private:
  struct Node {
    Eigen::Array3d low, high;  // of the spheres without an offset
    std::int32_t first, count;
  };
  void split(std::int32_t node);
  bool covers(const Vec3& point, double offset, std::int32_t but) const;
  std::vector<std::int32_t> hiders(std::int32_t ball, double offset) const;

  std::vector<Ball> balls_;
  std::vector<Node> nodes_;
  std::vector<std::int32_t> order_;
  double largest_ = 0;
};

}  // namespace palmar
