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
  explicit PointTree(const std::vector<Vec3>& points, int threads = 1);

  // The points' numbers, neighbours side by side: the tree calls order()[k] point k.
  const std::vector<std::int32_t>& order() const { return order_; }

  // Nodes, at least `count` of them where there are so many points, that hold every point once.
  std::vector<std::int32_t> parts(std::size_t count) const;

  // visit(k, distance) for every point within `reach` of the centre, in the order of k; of one part alone if one is
  // named.
  template <class Visit>
  void within(const Vec3& center, double reach, Visit visit, std::int32_t part = 0) const {
    const float x = float(center.x()), y = float(center.y()), z = float(center.z());
    const float squared = float(reach * reach);
    std::int32_t stack[64];
    int open = 0;
    if (!nodes_.empty()) stack[open++] = part;
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
      // Without branches: which points of a leaf lie within is as good as random.
      std::int32_t inside[kLeaf];
      int count = 0;
      for (int k = 0; k < node.count; ++k) {
        inside[count] = k;
        count += found[k] <= squared;
      }
      for (int k = 0; k < count; ++k) visit(node.first + inside[k], std::sqrt(found[inside[k]]));
    }
  }

 private:
  static constexpr int kLeaf = 16;
  struct Node {
    float low[3], high[3];
    std::int32_t first, count;  // count 0: children first and first + 1
  };
  // A point as the tree is made: rounded to float once, beside its number, so that a cut reads memory in order.
  struct Item {
    float at[3];
    std::int32_t number;
  };
  // A node to be made of `count` items from `first` on; its descendants stand from `below` on.
  struct Task {
    std::int32_t node, first, count, below;
  };
  static std::int32_t half(std::int32_t count) { return (count / 2 + kLeaf - 1) / kLeaf * kLeaf; }
  static std::int32_t descendants(std::int32_t count);
  // Makes a node; returns whether it has children, the tasks of which it gives.
  bool make(const Task& task, std::vector<Item>& items, Task children[2]);
  void make_all(const Task& task, std::vector<Item>& items);

  std::vector<Node> nodes_;
  std::vector<float> x_, y_, z_;  // in the order of the leaves, with kLeaf more at the end
  std::vector<std::int32_t> order_;
};

}  // namespace palmar
