#include "object.h"

#include <algorithm>

namespace palmar {

namespace {

// Indices of the spheres that no other one contains; of equal ones the first.
std::vector<std::uint32_t> outermost(const std::vector<Sphere>& spheres) {
  constexpr int kCapacity =
      8192;  // more than this about one centre are looked at in part: a few may stay that need not
  const WideTree tree(spheres);
  std::vector<std::uint32_t> found(kCapacity), kept;
  for (std::uint32_t i = 0; i < spheres.size(); ++i) {
    std::uint32_t visited = 0;
    const Sphere& s = spheres[i];
    const int count = std::min(tree.find(ball_query(s.center, 0.0, 0.0), found.data(), kCapacity, visited), kCapacity);
    const bool inside = std::any_of(found.begin(), found.begin() + count, [&](std::uint32_t j) {
      const Sphere& other = spheres[j];
      const bool within = (other.center - s.center).norm() + s.radius <= other.radius;
      const bool equal = other.center == s.center && other.radius == s.radius;
      return within && (equal ? j < i : j != i);
    });
    if (!inside) kept.push_back(i);
  }
  return kept;
}

// No surface is farther from the origin.
double farthest(const std::vector<Sphere>& spheres) {
  double most = 0;
  for (const Sphere& s : spheres) most = std::max(most, s.center.norm() + s.radius);
  return most;
}

}  // namespace

CollisionObject::CollisionObject(const std::vector<Sphere>& spheres) : number(outermost(spheres)) {
  leaves.reserve(number.size());
  for (const std::uint32_t i : number) leaves.push_back(spheres[i]);
  // In the order of the tree's leaves, so that neighbours lie together in memory.
  std::vector<std::uint32_t> order(leaves.size());
  std::uint32_t visited = 0;
  const double all = 10 * farthest(leaves);
  WideTree(leaves).find(ball_query(Vec3::Zero(), all, 0.0), order.data(), int(order.size()), visited);
  const std::vector<Sphere> before = leaves;
  const std::vector<std::uint32_t> number_before = number;
  for (std::size_t i = 0; i < order.size(); ++i) {
    leaves[i] = before[order[i]];
    number[i] = number_before[order[i]];
  }
  tree = WideTree(leaves);
  Vec3 low = leaves.front().center, high = low;
  for (const Sphere& s : leaves) {
    low = low.cwiseMin(s.center);
    high = high.cwiseMax(s.center);
  }
  center = 0.5 * (low + high);
  for (const Sphere& s : leaves) {
    radius = std::max(radius, (s.center - center).norm() + s.radius);
    leaf_radius_max = std::max(leaf_radius_max, s.radius);
  }
}

}  // namespace palmar
