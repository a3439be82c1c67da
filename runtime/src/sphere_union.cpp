#include "sphere_union.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>
#include <queue>

#include "point_tree.h"
#include "random.h"

namespace palmar {
namespace {

constexpr int kLeaf = 4;
constexpr std::size_t kAround = 256, kHiders = 32;
constexpr int kCoarse = 4;  // 6 x 4 x 4 patches of about 20 degrees
// Chord from the middle of a patch to its corners, times the cells a side: an equiangular cell is at most pi / 2 /
// cells wide and skewed by at most 30 degrees, sqrt(2) (pi / 4) sqrt(1.335).
constexpr double kExtent = 1.3;

struct Patch {
  int side, row, column, cells;
};

// Direction at (s, t) in [0, 1]^2 of a patch of the cubed sphere, equiangular, and the patch's solid angle by the map's
// Jacobian there.
SkinSample at_patch(const Patch& patch, double s, double t) {
  const double quarter = std::numbers::pi / 4;
  const double u = std::tan(quarter * (2 * (patch.row + s) / patch.cells - 1));
  const double v = std::tan(quarter * (2 * (patch.column + t) / patch.cells - 1));
  const double length = std::sqrt(1 + u * u + v * v);
  const int axis = patch.side % 3;
  SkinSample found{};
  found.direction[axis] = (patch.side < 3 ? 1 : -1) / length;
  found.direction[(axis + 1) % 3] = u / length;
  found.direction[(axis + 2) % 3] = v / length;
  const double width = 2 * quarter / patch.cells;
  found.solid_angle = (1 + u * u) * (1 + v * v) / (length * length * length) * width * width;
  return found;
}

}  // namespace

SphereUnion::SphereUnion(std::vector<Ball> balls) : balls_(std::move(balls)), order_(balls_.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  for (const Ball& ball : balls_) largest_ = std::max(largest_, ball.radius);
  if (balls_.empty()) return;
  nodes_.reserve(balls_.size() + 1);
  nodes_.push_back({Eigen::Array3d::Zero(), Eigen::Array3d::Zero(), 0, 0, std::int32_t(balls_.size())});
  split(0);
}

void SphereUnion::split(std::int32_t index) {
  const std::int32_t first = nodes_[index].first, count = nodes_[index].count;
  const auto begin = order_.begin() + first;
  Eigen::Array3d low = Eigen::Array3d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  double largest = 0;
  for (auto at = begin; at != begin + count; ++at) {
    const Ball& ball = balls_[*at];
    low = low.min(ball.center.array());
    high = high.max(ball.center.array());
    largest = std::max(largest, ball.radius);
  }
  nodes_[index].low = low;
  nodes_[index].high = high;
  nodes_[index].largest = largest;
  if (count <= kLeaf) return;
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const std::int32_t half = count / 2;
  std::nth_element(begin, begin + half, begin + count, [&](std::int32_t i, std::int32_t j) {
    return std::pair(balls_[i].center[axis], i) < std::pair(balls_[j].center[axis], j);
  });
  const std::int32_t child = std::int32_t(nodes_.size());
  nodes_.push_back({low, high, largest, first, half});
  nodes_.push_back({low, high, largest, first + half, count - half});
  nodes_[index].first = child;
  nodes_[index].count = 0;
  split(child);
  split(child + 1);
}

std::vector<NearBall> SphereUnion::nearest(const std::vector<Vec3>& points) const {
  std::vector<NearBall> found(points.size(), {std::numeric_limits<double>::infinity(), -1});
  std::vector<std::int32_t> left(points.size());
  std::iota(left.begin(), left.end(), 0);
  if (points.empty() || balls_.empty()) return found;
  Eigen::Array3d low = points[0], high = low;
  for (const Vec3& point : points) {
    low = low.min(point.array());
    high = high.max(point.array());
  }
  double size = std::max((high - low).maxCoeff(), largest_);
  for (const Ball& ball : balls_) size = std::max(size, (ball.center - points[0]).norm());
  const double rounding = 1e-5 * size;
  for (double reach = 0.01 * size; !left.empty(); reach *= 4) {
    std::vector<Vec3> some;
    for (const std::int32_t k : left) some.push_back(points[k]);
    const PointTree tree(some);
    for (std::int32_t index = 0; index < std::int32_t(balls_.size()); ++index) {
      const Ball& ball = balls_[index];
      const double center_reach = ball.radius + reach + rounding;
      tree.within(ball.center, center_reach, [&](std::int32_t at, float distance) {
        const std::int32_t k = left[tree.order()[at]];
        if (distance - ball.radius > found[k].distance + rounding) return;
        const double exact = (points[k] - ball.center).norm() - ball.radius;
        if (exact < found[k].distance) found[k] = {exact, index};
      });
    }
    // A sphere that was not seen is farther than the reach.
    std::erase_if(left, [&](std::int32_t k) { return found[k].distance <= reach; });
  }
  return found;
}

std::vector<NearBall> SphereUnion::exits(const std::vector<Vec3>& points, const std::vector<Vec3>& directions) const {
  std::vector<NearBall> found(points.size(), {0.0, -1});
  if (balls_.empty()) return found;
  // Balls that touch in a point count as joined.
  const double slack = 1e-9 * largest_;
  for (std::size_t k = 0; k < points.size(); ++k) {
    NearBall& last = found[k];
    for (bool farther = true; farther;) {
      farther = false;
      const Vec3 at = points[k] + last.distance * directions[k];
      const Eigen::Array3d p = at;
      std::int32_t stack[64];
      int open = 0;
      stack[open++] = 0;
      while (open) {
        const Node& node = nodes_[stack[--open]];
        if (node.distance(p) > slack) continue;
        if (node.count == 0) {
          stack[open++] = node.first;
          stack[open++] = node.first + 1;
          continue;
        }
        for (std::int32_t place = node.first; place < node.first + node.count; ++place) {
          const Ball& ball = balls_[order_[place]];
          const double reach = ball.radius + slack;
          if ((at - ball.center).squaredNorm() > reach * reach) continue;
          const Vec3 offset = points[k] - ball.center;
          const double along = -offset.dot(directions[k]);
          const double root = along * along - offset.squaredNorm() + ball.radius * ball.radius;
          if (root < 0) continue;
          const double leave = along + std::sqrt(root);
          if (leave <= last.distance + slack) continue;
          last = {leave, order_[place]};
          farther = true;
        }
      }
    }
  }
  return found;
}

bool SphereUnion::covers(const Vec3& point, double offset, std::int32_t but) const {
  const Eigen::Array3d p = point;
  // Equal spheres, or a point in the seam of two: rounding must not hide it behind both.
  const double slack = 1e-9 * (largest_ + offset);
  std::int32_t stack[64];
  int open = 0;
  stack[open++] = 0;
  while (open) {
    const Node& node = nodes_[stack[--open]];
    if (node.distance(p) > offset) continue;
    if (node.count == 0) {
      stack[open++] = node.first;
      stack[open++] = node.first + 1;
      continue;
    }
    for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
      const Ball& ball = balls_[order_[at]];
      const double reach = std::max(ball.radius + offset - slack, 0.0);
      if (order_[at] != but && (ball.center - point).squaredNorm() < reach * reach) return true;
    }
  }
  return false;
}

std::pair<double, std::int32_t> SphereUnion::least_growth(const std::array<Vec3, 3>& corners) const {
  std::pair<double, std::int32_t> best{std::numeric_limits<double>::infinity(), -1};
  const Eigen::Array3d p = corners[0];
  const auto bound = [&](std::int32_t index) { return std::max(nodes_[index].distance(p), 0.0); };
  std::vector<std::pair<double, std::int32_t>> stack{{bound(0), 0}};
  while (!stack.empty() && best.first > 0) {
    const auto [least, index] = stack.back();
    stack.pop_back();
    if (least >= best.first) continue;
    const Node& node = nodes_[index];
    if (node.count == 0) {
      std::pair<double, std::int32_t> near{bound(node.first), node.first}, far{bound(node.first + 1), node.first + 1};
      if (far < near) std::swap(near, far);
      stack.push_back(far);
      stack.push_back(near);
      continue;
    }
    for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
      const Ball& ball = balls_[order_[at]];
      double growth = -std::numeric_limits<double>::infinity();
      for (const Vec3& corner : corners) growth = std::max(growth, (corner - ball.center).norm() - ball.radius);
      if (growth < best.first) best = {growth, order_[at]};
    }
  }
  return best;
}

std::vector<double> SphereUnion::radii_to_cover(const std::vector<Vec3>& vertices,
                                                const std::vector<std::array<std::int32_t, 3>>& faces,
                                                double finest) const {
  std::vector<double> radii;
  for (const Ball& ball : balls_) radii.push_back(ball.radius);
  if (balls_.empty()) return radii;
  std::vector<std::array<Vec3, 3>> open;
  for (const auto& face : faces) {
    open.push_back({vertices[face[0]], vertices[face[1]], vertices[face[2]]});
    while (!open.empty()) {
      const std::array<Vec3, 3> corners = open.back();
      open.pop_back();
      const auto [growth, ball] = least_growth(corners);
      if (growth <= 0) continue;
      const Vec3 &a = corners[0], &b = corners[1], &c = corners[2];
      // Smaller pieces would spare this ball no more than that.
      const Vec3 middle = (a + b + c) / 3;
      if (balls_[ball].radius + growth - (middle - balls_[ball].center).norm() <= finest) {
        radii[ball] = std::max(radii[ball], balls_[ball].radius + growth);
        continue;
      }
      const Vec3 ab = (a + b) / 2, bc = (b + c) / 2, ca = (c + a) / 2;
      open.push_back({a, ab, ca});
      open.push_back({ab, b, bc});
      open.push_back({ca, bc, c});
      open.push_back({ab, bc, ca});
    }
  }
  return radii;
}

std::vector<std::int32_t> SphereUnion::hiders(std::int32_t index, double offset) const {
  const Ball& own = balls_[index];
  const Eigen::Array3d p = own.center;
  std::vector<std::pair<double, std::int32_t>> found;
  // Nodes, the nearest first.
  std::priority_queue<std::pair<double, std::int32_t>, std::vector<std::pair<double, std::int32_t>>, std::greater<>>
      open;
  const auto push = [&](std::int32_t node) {
    const double distance = nodes_[node].distance(p);
    if (distance < own.radius + 2 * offset) open.push({distance + nodes_[node].largest, node});
  };
  push(0);
  while (!open.empty() && found.size() < kAround) {
    const Node& node = nodes_[open.top().second];
    open.pop();
    if (node.count == 0) {
      push(node.first);
      push(node.first + 1);
      continue;
    }
    for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
      const std::int32_t other = order_[at];
      const double apart = (balls_[other].center - own.center).norm();
      if (other == index || apart >= own.radius + balls_[other].radius + 2 * offset) continue;
      // Cosine of the cap that it hides: all of the sphere at -1.
      const double a = own.radius + offset, b = balls_[other].radius + offset;
      const double cap = apart > 0 ? (a * a + apart * apart - b * b) / (2 * a * apart) : (b > a ? -1.0 : 2.0);
      found.push_back({cap, other});
    }
  }
  const std::size_t kept = std::min(found.size(), kHiders);
  std::partial_sort(found.begin(), found.begin() + std::ptrdiff_t(kept), found.end());
  std::vector<std::int32_t> list;
  for (std::size_t k = 0; k < kept; ++k) list.push_back(found[k].second);
  return list;
}

std::vector<SkinSample> SphereUnion::skin(double offset, double spacing, std::uint64_t seed) const {
  std::vector<SkinSample> samples;
  std::vector<Patch> open;
  for (std::int32_t index = 0; index < std::int32_t(balls_.size()); ++index) {
    Random random{seed * 0x9e3779b97f4a7c15ull + std::uint64_t(index)};
    const Ball& own = balls_[index];
    const double radius = own.radius + offset;
    const std::vector<std::int32_t> near = hiders(index, offset);
    for (int side = 0; side < 6; ++side) {
      for (int cell = 0; cell < kCoarse * kCoarse; ++cell)
        open.push_back({side, cell / kCoarse, cell % kCoarse, kCoarse});
    }
    while (!open.empty()) {
      const Patch patch = open.back();
      open.pop_back();
      const Vec3 middle = own.center + radius * at_patch(patch, 0.5, 0.5).direction;
      const double extent = radius * kExtent / patch.cells;
      const bool hidden = std::any_of(near.begin(), near.end(), [&](std::int32_t other) {
        const double room = balls_[other].radius + offset - extent;
        return room > 0 && (middle - balls_[other].center).squaredNorm() < room * room;
      });
      if (hidden) continue;
      const double area = radius * radius * 4 * std::numbers::pi / (6.0 * patch.cells * patch.cells);
      if (area <= 2 * spacing * spacing) {
        const double s = random.uniform(), t = random.uniform();
        SkinSample sample = at_patch(patch, s, t);
        sample.owner = index;
        if (!covers(own.center + radius * sample.direction, offset, index)) samples.push_back(sample);
        continue;
      }
      for (int k = 0; k < 4; ++k)
        open.push_back({patch.side, 2 * patch.row + k / 2, 2 * patch.column + k % 2, 2 * patch.cells});
    }
  }
  return samples;
}

}  // namespace palmar
