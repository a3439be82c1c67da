// Spheres in nodes of sixteen, searched sixteen at a time. Single precision with a stated slack; callers decide in
// double.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "algebra.h"

namespace palmar {

struct Sphere {
  Vec3 center;
  double radius;
};

constexpr int kWide = 16;

struct alignas(64) WideNode {
  float x[kWide], y[kWide], z[kWide], r[kWide];
  std::int32_t child[kWide];  // node index, or ~sphere index; unused slots have r = -infinity
};

// What is searched for: the union of balls of radius r1 .. r2 along the axis from c1 to c2, grown by `margin`.
struct SphereQuery {
  float x, y, z;     // c1
  float ux, uy, uz;  // unit axis
  float length, r1, sin_phi, tan_phi, margin;
};

// A box with rounded edges, in its own frame: `rotation` rows are its axes in the tree's frame.
struct BoxQuery {
  float cx, cy, cz;  // centre
  float m[9];        // rows: the box's axes
  float hx, hy, hz;  // half sizes
  float radius;      // rounding plus margin
};

SphereQuery capsule_query(const Vec3& c1, const Vec3& c2, double r1, double r2, double margin);
SphereQuery ball_query(const Vec3& center, double radius, double margin);

// What float rounding may hide from a query of this size about this point: a tree's own slack knows only the tree's
// size, and the hand is larger than a small object. Already in the margin of capsule_query and ball_query.
double query_rounding(const Vec3& center, double size);

// excess[i] <= 0 where a ball of radius `reach` about (x, y, z) meets sphere i of the node: squared centre distance
// less the square of the radii's sum. Unused slots must lie far away.
void ball_excess(const WideNode& node, float x, float y, float z, float reach, float* excess);

class WideTree {
 public:
  WideTree() = default;
  explicit WideTree(const std::vector<Sphere>& spheres);

  // Writes indices of every sphere that may be within the query's margin (all that are, and a few that are not: float
  // slack). Returns how many; `capacity + 1` when they did not fit. Adds the nodes visited to `visited`.
  int find(const SphereQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;
  int find(const BoxQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;

  // Float slack: how far a stored sphere's surface may lie from the true one, metres.
  double slack() const { return slack_; }
  int depth() const { return depth_; }

 private:
  std::int32_t build(std::vector<std::uint32_t>& order, std::size_t begin, std::size_t end,
                     const std::vector<Sphere>& spheres, Sphere& bound, int depth);
  template <class Query>
  int find_any(const Query& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;

  std::vector<WideNode> nodes_;
  std::int32_t root_ = 0;
  double slack_ = 0;
  int depth_ = 0;
};

}  // namespace palmar
