// What the hand may not enter: the leaf spheres of one object, in the object's frame, and the tree that finds them.
#pragma once

#include <vector>

#include "sphere_tree.h"

namespace palmar {

struct CollisionObject {
  // Spheres that lie within another one are left out: nothing can touch them.
  explicit CollisionObject(const std::vector<Sphere>& spheres);

  std::vector<Sphere> leaves;
  std::vector<std::uint32_t> number;  // of each leaf, among the spheres given
  WideTree tree;
  Vec3 center{0, 0, 0};  // of a ball around all leaves
  double radius = 0;
  double leaf_radius_max = 0;
};

}  // namespace palmar
