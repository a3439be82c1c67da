#include "sphere_union.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>
#include <queue>

#include "parallel.h"
#include "random.h"

namespace palmar {
namespace {

constexpr int kLeaf = 4;
constexpr std::size_t kAround = 128;  // spheres looked at for what hides a sphere's skin
constexpr std::size_t kBlock = 256;   // points that a thread takes at a time
constexpr double kRounding = 1e-12;   // of a cosine

}  // namespace

// What another sphere hides of a sphere's skin: the directions at most an angle from its axis.
struct SphereUnion::Cap {
  Vec3 axis;
  double cosine, sine;
  std::int32_t ball;
};

// A part of a sphere's directions: a cell of the cubed sphere, equiangular.
struct SphereUnion::Patch {
  int side, row, column, cells;

  // Direction at (s, t) in [0, 1]^2, and the solid angle of the patch by the map's Jacobian there.
  SkinSample at(double s, double t) const {
    const double quarter = std::numbers::pi / 4;
    const double u = std::tan(quarter * (2 * (row + s) / cells - 1));
    const double v = std::tan(quarter * (2 * (column + t) / cells - 1));
    const double length = std::sqrt(1 + u * u + v * v);
    const int axis = side % 3;
    SkinSample found{};
    found.direction[axis] = (side < 3 ? 1 : -1) / length;
    found.direction[(axis + 1) % 3] = u / length;
    found.direction[(axis + 2) % 3] = v / length;
    const double width = 2 * quarter / cells;
    found.solid_angle = (1 + u * u) * (1 + v * v) / (length * length * length) * width * width;
    return found;
  }
  // The same for every tree of spheres, however it drops patches.
  Random random(std::uint64_t seed, std::int32_t ball) const {
    const std::uint64_t place =
        ((std::uint64_t(side) * cells + row) * cells + column) * 64 + std::bit_width(unsigned(cells));
    Random found{seed * 0x9e3779b97f4a7c15ull + std::uint64_t(ball)};
    return {found.next() + place * 0xd1342543de82ef95ull};
  }
};

// The skin of one ball in the making.
struct SphereUnion::Skin {
  std::int32_t ball;
  Vec3 center;
  double radius, offset, spacing;
  std::uint64_t seed;
  std::int32_t hider;  // of the last hidden sample
  std::vector<SkinSample> samples;
};

SphereUnion::SphereUnion(std::vector<Ball> balls, int threads)
    : balls_(std::move(balls)), order_(balls_.size()), threads_(threads) {
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
  double least = std::numeric_limits<double>::infinity(), largest = 0;
  for (auto at = begin; at != begin + count; ++at) {
    const Ball& ball = balls_[*at];
    low = low.min(ball.center.array());
    high = high.max(ball.center.array());
    least = std::min(least, ball.radius);
    largest = std::max(largest, ball.radius);
  }
  nodes_[index] = {low, high, largest, first, count};
  if (count <= kLeaf) return;
  // The radius is a fourth axis: a small sphere among large ones would make their bound loose.
  int axis = 0;
  if ((high - low).maxCoeff(&axis) < largest - least) axis = 3;
  const auto place = [&](std::int32_t k) { return axis == 3 ? balls_[k].radius : balls_[k].center[axis]; };
  const std::int32_t half = count / 2;
  std::nth_element(begin, begin + half, begin + count,
                   [&](std::int32_t i, std::int32_t j) { return std::pair(place(i), i) < std::pair(place(j), j); });
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
  if (balls_.empty()) return found;
  in_parallel(threads_, (points.size() + kBlock - 1) / kBlock, [&](std::size_t block) {
    std::int32_t guess = 0;
    for (std::size_t k = block * kBlock; k < std::min(points.size(), (block + 1) * kBlock); ++k) {
      found[k] = nearest(points[k], guess);
      guess = found[k].owner;
    }
  });
  return found;
}

NearBall SphereUnion::nearest(const Vec3& point, std::int32_t guess) const {
  NearBall best{(point - balls_[guess].center).norm() - balls_[guess].radius, guess};
  const Eigen::Array3d p = point;
  std::pair<double, std::int32_t> stack[64];
  int open = 0;
  stack[open++] = {nodes_[0].distance(p), 0};
  while (open) {
    const auto [bound, index] = stack[--open];
    if (bound > best.distance) continue;
    const Node& node = nodes_[index];
    if (node.count == 0) {
      std::pair<double, std::int32_t> near{nodes_[node.first].distance(p), node.first};
      std::pair<double, std::int32_t> far{nodes_[node.first + 1].distance(p), node.first + 1};
      if (far < near) std::swap(near, far);
      stack[open++] = far;
      stack[open++] = near;
      continue;
    }
    for (std::int32_t at = node.first; at < node.first + node.count; ++at) {
      const Ball& ball = balls_[order_[at]];
      const double distance = (point - ball.center).norm() - ball.radius;
      if (std::pair(distance, order_[at]) < std::pair(best.distance, best.owner)) best = {distance, order_[at]};
    }
  }
  return best;
}

std::vector<NearBall> SphereUnion::exits(const std::vector<Vec3>& points, const std::vector<Vec3>& directions) const {
  std::vector<NearBall> found(points.size(), {0.0, -1});
  if (balls_.empty()) return found;
  in_parallel(threads_, (points.size() + kBlock - 1) / kBlock, [&](std::size_t block) {
    for (std::size_t k = block * kBlock; k < std::min(points.size(), (block + 1) * kBlock); ++k)
      found[k] = exit(points[k], directions[k]);
  });
  return found;
}

NearBall SphereUnion::exit(const Vec3& point, const Vec3& direction) const {
  // Balls that touch in a point count as joined.
  const double slack = 1e-9 * largest_;
  NearBall last{0.0, -1};
  for (bool farther = true; farther;) {
    farther = false;
    const Vec3 at = point + last.distance * direction;
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
        const Vec3 offset = point - ball.center;
        const double along = -offset.dot(direction);
        const double root = along * along - offset.squaredNorm() + ball.radius * ball.radius;
        if (root < 0) continue;
        const double leave = along + std::sqrt(root);
        if (leave <= last.distance + slack) continue;
        last = {leave, order_[place]};
        farther = true;
      }
    }
  }
  return last;
}

bool SphereUnion::holds(std::int32_t index, const Vec3& point, double offset) const {
  // Equal spheres, or a point in the seam of two: rounding must not hide it behind both.
  const double slack = 1e-9 * (largest_ + offset);
  const double reach = std::max(balls_[index].radius + offset - slack, 0.0);
  return (balls_[index].center - point).squaredNorm() < reach * reach;
}

std::int32_t SphereUnion::covers(const Vec3& point, double offset, std::int32_t but) const {
  const Eigen::Array3d p = point;
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
      if (order_[at] != but && holds(order_[at], point, offset)) return order_[at];
    }
  }
  return -1;
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
  radii.reserve(balls_.size());
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

std::vector<SphereUnion::Cap> SphereUnion::caps(std::int32_t index, double offset) const {
  const Ball& own = balls_[index];
  const Eigen::Array3d p = own.center;
  std::vector<Cap> found;
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
      const Vec3 way = balls_[other].center - own.center;
      const double apart = way.norm();
      if (other == index || apart >= own.radius + balls_[other].radius + 2 * offset) continue;
      const double a = own.radius + offset, b = balls_[other].radius + offset;
      if (apart + a < b) return {{Vec3::UnitX(), -1, 0, other}};
      if (apart + b <= a) continue;
      const double cosine = std::clamp((a * a + apart * apart - b * b) / (2 * a * apart), -1.0, 1.0);
      found.push_back({way / apart, cosine, std::sqrt(1 - cosine * cosine), other});
    }
  }
  std::sort(found.begin(), found.end(),
            [](const Cap& i, const Cap& j) { return std::pair(i.cosine, i.ball) < std::pair(j.cosine, j.ball); });
  return found;
}

std::vector<SkinSample> SphereUnion::skin(double offset, double spacing, std::uint64_t seed) const {
  std::vector<std::vector<SkinSample>> parts(balls_.size());
  in_parallel(threads_, balls_.size(),
              [&](std::size_t k) { parts[k] = skin_of(std::int32_t(k), offset, spacing, seed); });
  std::vector<SkinSample> samples;
  for (const auto& part : parts) samples.insert(samples.end(), part.begin(), part.end());
  return samples;
}

std::vector<SkinSample> SphereUnion::skin_of(std::int32_t index, double offset, double spacing,
                                             std::uint64_t seed) const {
  Skin skin{index, balls_[index].center, balls_[index].radius + offset, offset, spacing, seed, index, {}};
  const std::vector<Cap> near = caps(index, offset);
  for (int side = 0; side < 6; ++side) sample(skin, {side, 0, 0, 1}, near);
  return std::move(skin.samples);
}

void SphereUnion::sample(Skin& skin, const Patch& patch, const std::vector<Cap>& caps) const {
  const Vec3 middle = patch.at(0.5, 0.5).direction;
  // To the farthest corner: a cell is a rectangle on its side of the cube, a cone of directions a convex figure there.
  double cosine = 1;
  for (int corner = 0; corner < 4; ++corner)
    cosine = std::min(cosine, middle.dot(patch.at(corner / 2, corner % 2).direction));
  const double sine = std::sqrt(1 - cosine * cosine);
  std::vector<Cap> partly;
  for (const Cap& cap : caps) {
    const double along = cap.axis.dot(middle), straight = cap.cosine * cosine, across = cap.sine * sine;
    if (cap.cosine <= cosine && along > straight + across + kRounding) return;
    const bool all_around = cap.sine * cosine + cap.cosine * sine <= 0;
    if (all_around || along > straight - across) partly.push_back(cap);
  }
  const double area = skin.radius * skin.radius * 4 * std::numbers::pi / (6.0 * patch.cells * patch.cells);
  if (area > 2 * skin.spacing * skin.spacing) {
    for (int k = 0; k < 4; ++k)
      sample(skin, {patch.side, 2 * patch.row + k / 2, 2 * patch.column + k % 2, 2 * patch.cells}, partly);
    return;
  }
  Random random = patch.random(skin.seed, skin.ball);
  const double s = random.uniform(), t = random.uniform();
  SkinSample found = patch.at(s, t);
  found.owner = skin.ball;
  const Vec3 point = skin.center + skin.radius * found.direction;
  const auto hides = [&](const Cap& cap) { return holds(cap.ball, point, skin.offset); };
  if (std::any_of(partly.begin(), partly.end(), hides)) return;
  // The one that hid the last patch mostly hides its neighbour.
  if (skin.hider != skin.ball && holds(skin.hider, point, skin.offset)) return;
  const std::int32_t hider = covers(point, skin.offset, skin.ball);
  if (hider < 0) {
    skin.samples.push_back(found);
  } else {
    skin.hider = hider;
  }
}

}  // namespace palmar
