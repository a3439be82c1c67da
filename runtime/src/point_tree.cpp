#include "point_tree.h"

#include <algorithm>
#include <numeric>

namespace palmar {

PointTree::PointTree(const std::vector<Vec3>& points) : order_(points.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  if (points.empty()) return;
  nodes_.reserve(points.size() / 4 + 1);
  nodes_.push_back({});
  split(0, 0, std::int32_t(points.size()), points);
  for (std::vector<float>* axis : {&x_, &y_, &z_}) axis->assign(points.size() + kLeaf, 0.0f);
  for (std::size_t at = 0; at < points.size(); ++at) {
    const Vec3& p = points[order_[at]];
    x_[at] = float(p.x());
    y_[at] = float(p.y());
    z_[at] = float(p.z());
  }
}

void PointTree::split(std::int32_t index, std::int32_t first, std::int32_t count, const std::vector<Vec3>& points) {
  Eigen::Array3d low = points[order_[first]], high = low;
  for (std::int32_t at = first; at < first + count; ++at) {
    low = low.min(points[order_[at]].array());
    high = high.max(points[order_[at]].array());
  }
  Node& node = nodes_[index];
  for (int axis = 0; axis < 3; ++axis) {
    // Rounded as the points are.
    node.low[axis] = float(low[axis]);
    node.high[axis] = float(high[axis]);
  }
  if (count <= kLeaf) {
    node.first = first;
    node.count = count;
    return;
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const std::int32_t half = (count / 2 + kLeaf - 1) / kLeaf * kLeaf;
  std::nth_element(
      order_.begin() + first, order_.begin() + first + half, order_.begin() + first + count,
      [&](std::int32_t i, std::int32_t j) { return std::pair(points[i][axis], i) < std::pair(points[j][axis], j); });
  const std::int32_t child = std::int32_t(nodes_.size());
  node.first = child;
  node.count = 0;
  nodes_.push_back({});
  nodes_.push_back({});
  split(child, first, half, points);
  split(child + 1, first + half, count - half, points);
}

}  // namespace palmar
