// Many points, and which of them lie in a ball.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "algebra.h"

namespace palmar {

// Boxes over runs of sixteen points, float.
class PointTree {
 public:
  explicit PointTree(const std::vector<Vec3>& points);

  // The points' numbers, neighbours side by side: the tree calls order()[k] point k.
  const std::vector<std::int32_t>& order() const { return order_; }

  // visit(k, distance) for every point within `reach` of the centre.
  template <class Visit>
  void within(const Vec3& center, double reach, Visit visit) const {
    const float x = float(center.x()), y = float(center.y()), z = float(center.z());
    const float squared = float(reach * reach);
    std::int32_t stack[64];
    int open = 0;
    if (!nodes_.empty()) stack[open++] = 0;
    while (open) {
      const Node& node = nodes_[stack[--open]];
      const float dx = std::max({node.low[0] - x, x - node.high[0], 0.0f});
      const float dy = std::max({node.low[1] - y, y - node.high[1], 0.0f});
      const float dz = std::max({node.low[2] - z, z - node.high[2], 0.0f});
      if (dx * dx + dy * dy + dz * dz > squared) continue;
      if (node.count == 0) {
        stack[open++] = node.first + 1;
        stack[open++] = node.first;
        continue;
      }
      float found[kLeaf];
      for (int k = 0; k < kLeaf; ++k) {
        const float ax = x_[node.first + k] - x, ay = y_[node.first + k] - y, az = z_[node.first + k] - z;
        found[k] = ax * ax + ay * ay + az * az;
      }
      for (int k = 0; k < node.count; ++k) {
        if (found[k] <= squared) visit(node.first + k, std::sqrt(found[k]));
      }
    }
  }

 private:
  static constexpr int kLeaf = 16;
  struct Node {
    float low[3], high[3];
    std::int32_t first, count;  // count 0: children first and first + 1
  };
  void split(std::int32_t node, std::int32_t first, std::int32_t count, const std::vector<Vec3>& points);

  std::vector<Node> nodes_;
  std::vector<float> x_, y_, z_;  // in the order of the leaves, with kLeaf more at the end
  std::vector<std::int32_t> order_;
};

}  // namespace palmar
