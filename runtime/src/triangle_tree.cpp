#include "triangle_tree.h"

#include <algorithm>
#include <numeric>

namespace palmar {
namespace {

constexpr int kLeaf = 4;
constexpr int kDepth = 64;

inline double squared_to_box(const Eigen::Array3d& low, const Eigen::Array3d& high, const Vec3& p) {
  const double dx = std::max(std::max(low[0] - p[0], p[0] - high[0]), 0.0);
  const double dy = std::max(std::max(low[1] - p[1], p[1] - high[1]), 0.0);
  const double dz = std::max(std::max(low[2] - p[2], p[2] - high[2]), 0.0);
  return dx * dx + dy * dy + dz * dz;
}

// Ericson 2004, Real-Time Collision Detection, 5.1.5, with a at the origin.
Vec3 closest_on(const Vec3& ab, const Vec3& ac, const Vec3& ap) {
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return Vec3::Zero();
  const double bb = ab.dot(ab), bc = ab.dot(ac), cc = ac.dot(ac);
  const double d3 = d1 - bb, d4 = d2 - bc;
  if (d3 >= 0 && d4 <= d3) return ab;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return ab * (d1 / (d1 - d3));
  const double d5 = d1 - bc, d6 = d2 - cc;
  if (d6 >= 0 && d5 <= d6) return ac;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return ac * (d2 / (d2 - d6));
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return ab + (ac - ab) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
  const double sum = va + vb + vc;
  if (!(sum > 0)) return Vec3::Zero();
  return ab * (vb / sum) + ac * (vc / sum);
}

}  // namespace

TriangleTree::TriangleTree(const std::vector<Vec3>& vertices, const std::vector<std::array<std::int32_t, 3>>& faces) {
  std::vector<Vec3> middles;
  for (const auto& [i, j, k] : faces) {
    const Vec3 &a = vertices[i], &b = vertices[j], &c = vertices[k];
    const Vec3 cross = (b - a).cross(c - a);
    const double length = cross.norm();
    triangles_.push_back({a, b - a, c - a, length > 0 ? Vec3(cross / length) : Vec3(Vec3::Zero())});
    middles.push_back((a + b + c) / 3);
  }
  face_.resize(faces.size());
  std::iota(face_.begin(), face_.end(), 0);
  nodes_.reserve(faces.size() + 1);
  nodes_.push_back({.first = 0, .count = std::int32_t(faces.size())});
  split(0, middles);
  place_.resize(face_.size());
  for (std::size_t at = 0; at < face_.size(); ++at) place_[face_[at]] = std::int32_t(at);
  std::vector<Triangle> sorted;
  sorted.reserve(face_.size());
  for (const std::int32_t face : face_) sorted.push_back(triangles_[face]);
  triangles_ = std::move(sorted);
  size_ = (nodes_[0].high - nodes_[0].low).maxCoeff();
}

void TriangleTree::bound(Node& node) const {
  node.low.setConstant(std::numeric_limits<double>::infinity());
  node.high = -node.low;
  for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
    const Triangle& t = triangles_[face_[at]];
    const Eigen::Array3d a = t.a, b = t.a + t.ab, c = t.a + t.ac;
    node.low = node.low.min(a).min(b).min(c);
    node.high = node.high.max(a).max(b).max(c);
  }
}

void TriangleTree::split(std::int32_t index, std::vector<Vec3>& middles) {
  bound(nodes_[index]);
  const std::int32_t first = nodes_[index].first, count = nodes_[index].count;
  if (count <= kLeaf) return;
  Eigen::Array3d low = middles[face_[first]], high = low;
  for (std::int32_t at = first; at < first + count; ++at) {
    low = low.min(middles[face_[at]].array());
    high = high.max(middles[face_[at]].array());
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const std::int32_t half = count / 2;
  std::nth_element(
      face_.begin() + first, face_.begin() + first + half, face_.begin() + first + count,
      [&](std::int32_t i, std::int32_t j) { return std::pair(middles[i][axis], i) < std::pair(middles[j][axis], j); });
  const std::int32_t child = std::int32_t(nodes_.size());
  nodes_.push_back({.first = first, .count = half});
  nodes_.push_back({.first = first + half, .count = count - half});
  nodes_[index].first = child;
  nodes_[index].count = 0;
  split(child, middles);
  split(child + 1, middles);
}

Closest TriangleTree::closest(const Vec3& point, std::int32_t hint) const {
  Closest best;
  const auto ask = [&](std::int32_t at) {
    const Triangle& t = triangles_[at];
    const Vec3 ap = point - t.a;
    const double above = t.normal.dot(ap);
    if (above * above >= best.squared) return;
    const Vec3 on = closest_on(t.ab, t.ac, ap);
    const double squared = (ap - on).squaredNorm();
    if (squared < best.squared) best = {squared, t.a + on, face_[at]};
  };
  if (hint >= 0) ask(place_[hint]);
  std::pair<double, std::int32_t> stack[kDepth];
  int open = 0;
  stack[open++] = {0.0, 0};
  while (open) {
    const auto [bound, index] = stack[--open];
    if (bound >= best.squared) continue;
    const Node* node = &nodes_[index];
    while (node->count == 0) {
      std::int32_t near = node->first, far = near + 1;
      double at_near = squared_to_box(nodes_[near].low, nodes_[near].high, point);
      double at_far = squared_to_box(nodes_[far].low, nodes_[far].high, point);
      if (at_far < at_near) {
        std::swap(near, far);
        std::swap(at_near, at_far);
      }
      if (at_far < best.squared) stack[open++] = {at_far, far};
      if (at_near >= best.squared) break;
      node = &nodes_[near];
    }
    for (std::int32_t at = node->first; at < node->first + node->count; ++at) ask(at);
  }
  return best;
}

bool TriangleTree::crosses(const Vec3& from, const Vec3& to) const {
  const Vec3 along = to - from;
  const Eigen::Array3d low = from.cwiseMin(to), high = from.cwiseMax(to);
  std::int32_t stack[kDepth];
  int open = 0;
  stack[open++] = 0;
  while (open) {
    const Node& node = nodes_[stack[--open]];
    if ((node.low > high).any() || (node.high < low).any()) continue;
    if (node.count == 0) {
      stack[open++] = node.first;
      stack[open++] = node.first + 1;
      continue;
    }
    for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
      // Moeller and Trumbore 1997.
      const Triangle& t = triangles_[at];
      const Vec3 p = along.cross(t.ac), offset = from - t.a, q = offset.cross(t.ab);
      const double scale = t.ab.dot(p);
      if (scale == 0) continue;
      const double u = offset.dot(p) / scale, v = along.dot(q) / scale, s = t.ac.dot(q) / scale;
      if (u >= 0 && v >= 0 && u + v <= 1 && s >= 0 && s <= 1) return true;
    }
  }
  return false;
}

}  // namespace palmar
