// A union of spheres: how far points lie outside it, and its skin.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "algebra.h"

namespace palmar {

struct Ball {
  Vec3 center;
  double radius;
};

struct NearBall {
  double distance;     // from the point to its surface, negative inside
  std::int32_t owner;  // -1: none
};

struct SkinSample {
  std::int32_t owner;  // the sphere on which it lies
  Vec3 direction;      // unit, from the sphere's centre
  double solid_angle;
};

class SphereUnion {
 public:
  explicit SphereUnion(std::vector<Ball> balls, int threads = 1);

  // The ball with the least distance to each point, the first of equals: outside the union, the distance to the union.
  std::vector<NearBall> nearest(const std::vector<Vec3>& points) const;
  // Where a ray along the unit direction from each point leaves the union first, and the ball that it leaves there; 0
  // and no ball for a point outside.
  std::vector<NearBall> exits(const std::vector<Vec3>& points, const std::vector<Vec3>& directions) const;
  // Samples of the skin, every sphere grown by `offset`: about one for each spacing^2, one to a patch at random. A
  // patch of a sphere inside a neighbour is dropped whole, the others are split.
  std::vector<SkinSample> skin(double offset, double spacing, std::uint64_t seed) const;

  // Radii that cover every point of the triangles: a triangle whose corners lie in one sphere is covered, any other is
  // cut in four, until the sphere that needs to grow least for it would be spared at most `finest` by smaller pieces.
  std::vector<double> radii_to_cover(const std::vector<Vec3>& vertices,
                                     const std::vector<std::array<std::int32_t, 3>>& faces, double finest) const;

 private:
  struct Node {
    Eigen::Array3d low, high;  // of the centres
    double largest;            // radius
    std::int32_t first, count;

    // How far the point is from the nearest place that a centre may have, less the largest radius: a bound from below
    // of its distance to the spheres, tight even where large spheres crowd around one place.
    double distance(const Eigen::Array3d& point) const {
      return std::sqrt((low - point).max(point - high).max(0.0).square().sum()) - largest;
    }
  };
  struct Cap;
  struct Patch;
  struct Skin;
  void split(std::int32_t node);
  NearBall nearest(const Vec3& point, std::int32_t guess) const;
  NearBall exit(const Vec3& point, const Vec3& direction) const;
  // A ball but one that holds the point when grown by `offset`; -1: none.
  std::int32_t covers(const Vec3& point, double offset, std::int32_t but) const;
  bool holds(std::int32_t ball, const Vec3& point, double offset) const;
  // What spheres nearby hide of a sphere's skin, all grown by `offset`, the largest first: of so many that the number
  // does not grow with that of all.
  std::vector<Cap> caps(std::int32_t ball, double offset) const;
  std::vector<SkinSample> skin_of(std::int32_t ball, double offset, double spacing, std::uint64_t seed) const;
  // Of a patch that these hide a part of, or more.
  void sample(Skin& skin, const Patch& patch, const std::vector<Cap>& caps) const;
  // The least that a sphere must grow by to hold the three corners, at most 0 where one does; and that sphere.
  std::pair<double, std::int32_t> least_growth(const std::array<Vec3, 3>& corners) const;

  std::vector<Ball> balls_;
  std::vector<Node> nodes_;
  std::vector<std::int32_t> order_;
  double largest_ = 0;
  int threads_;
};

}  // namespace palmar
