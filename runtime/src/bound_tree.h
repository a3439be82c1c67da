// A tree of balls over given spheres in which every ball contains what stands below it, few of which a small ball
// meets.
#pragma once

#include <cstdint>
#include <vector>

#include "sphere_tree.h"

namespace palmar {

struct BoundTree {
  std::vector<Sphere> bounds;               // root first, siblings side by side, rounded to float and outwards
  std::vector<std::int32_t> bound_parent;   // of each bound; -1 of the root
  std::vector<std::int32_t> order;          // the spheres, siblings side by side
  std::vector<std::int32_t> sphere_parent;  // the bound of each sphere in that order
};

// At most kBranches children a bound. `reach`: radius of the ball that the tree will mostly be asked about.
constexpr int kBranches = 8;
BoundTree bound_tree(const std::vector<Sphere>& spheres, double reach);

}  // namespace palmar
