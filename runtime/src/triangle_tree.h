// Exact distances to a triangle mesh.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "algebra.h"

namespace palmar {

struct Closest {
  double squared = std::numeric_limits<double>::infinity();  // distance
  Vec3 point = Vec3::Zero();
  std::int32_t face = -1;
};

// Boxes over triangles, cut at the median. A face near the answer, given as a hint, spares most of the search.
class TriangleTree {
 public:
  TriangleTree(const std::vector<Vec3>& vertices, const std::vector<std::array<std::int32_t, 3>>& faces);

  Closest closest(const Vec3& point, std::int32_t hint = -1) const;
  // Whether the segment meets a triangle.
  bool crosses(const Vec3& from, const Vec3& to) const;
  // Longest side of the bounding box.
  double size() const { return size_; }

 private:
  struct Node {
    Eigen::Array3d low = Eigen::Array3d::Zero(), high = Eigen::Array3d::Zero();
    std::int32_t first, count;  // count 0: children first and first + 1; else triangles of order_
  };
  struct Triangle {
    Vec3 a, ab, ac, normal;
  };
  void split(std::int32_t node, std::vector<Vec3>& middles);
  void bound(Node& node) const;

  std::vector<Node> nodes_;
  std::vector<Triangle> triangles_;  // in the order of the leaves
  std::vector<std::int32_t> face_;   // of each triangle
  std::vector<std::int32_t> place_;  // of each face
  double size_ = 0;
};

}  // namespace palmar
