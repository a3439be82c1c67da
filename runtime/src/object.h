// What the hand may not enter: the leaf spheres of one object, in the object's frame, and the tree that finds them.
#pragma once

#include <vector>

#include "sphere_tree.h"

namespace palmar {

struct CollisionObject {
  std::vector<Sphere> leaves;
  WideTree tree;
  Vec3 center{0, 0, 0};  // of a ball around all leaves
  double radius = 0;
  double leaf_radius_max = 0;

  explicit CollisionObject(std::vector<Sphere> spheres) : leaves(std::move(spheres)), tree(leaves) {
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
};

}  // namespace palmar
