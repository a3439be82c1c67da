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

// Between which two planes each child of a node lies: a ball around a flat patch bulges far out of it, its slab does
// not. A point c is at least n . (c - ball's centre) - up away from what is in it, and n . (ball's centre - c) - down.
// The centres of the spheres in it, none larger than `radius`, are at most `across` from the line along n.
struct alignas(64) WideSlabs {
  float nx[kWide], ny[kWide], nz[kWide], up[kWide], down[kWide], across[kWide], radius[kWide];
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

// Gaps between the query and each of a node's spheres, less the query's margin.
void node_gaps(const WideNode& node, const SphereQuery& query, float* gap);
void node_gaps(const WideNode& node, const BoxQuery& query, float* gap);

// Raises the gaps of a node's children to what their slabs allow.
void slab_gaps(const WideNode& node, const WideSlabs& slabs, const SphereQuery& query, float* gap);
void slab_gaps(const WideNode& node, const WideSlabs& slabs, const BoxQuery& query, float* gap);

// A ball, and what its slab says of the spheres in it: their centres are in a cylinder about n, from -down to up.
struct SlabBall {
  float x, y, z, radius, nx, ny, nz, up, down, across, sphere_radius;
};

// Gaps between that and each of a node's spheres. Unused slots must lie far away.
void ball_gaps(const WideNode& node, const SlabBall& ball, float* gap);

// Where a frame of sixteen others is, seen from the tree's: its rows and its origin; and what rounding may hide there.
struct WideFrame {
  float m[9], px, py, pz, rounding;
};

// Gaps between each sphere of a node and the first `count` of sixteen others in that frame: gap[16 k + i] of other k
// and sphere i, and the least of each sphere i.
void pair_gaps(const WideNode& node, const WideFrame& frame, const WideNode& others, int count, float* gap,
               float* least);

class WideTree {
 public:
  WideTree() = default;
  explicit WideTree(const std::vector<Sphere>& spheres);

  // Writes indices of every sphere that may be within the query's margin (all that are, and a few that are not: float
  // slack). Returns how many; `capacity + 1` when they did not fit. Adds the nodes visited to `visited`.
  int find(const SphereQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;
  int find(const BoxQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;

  // For searches of their own: where they begin, and what a node holds.
  std::int32_t root() const { return root_; }
  const WideNode& node(std::int32_t index) const { return nodes_[std::size_t(index)]; }
  // Null where a node holds spheres only.
  const WideSlabs* slabs(std::int32_t index) const {
    const std::int32_t at = slabs_at_[std::size_t(index)];
    return at < 0 ? nullptr : &slabs_[std::size_t(at)];
  }

  // Float slack: how far a stored sphere's surface may lie from the true one, metres.
  double slack() const { return slack_; }
  int depth() const { return depth_; }

 private:
  std::int32_t build(std::vector<std::uint32_t>& order, std::size_t begin, std::size_t end,
                     const std::vector<Sphere>& spheres, Sphere& bound, int depth);
  template <class Query>
  int find_any(const Query& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const;

  std::vector<WideNode> nodes_;
  std::vector<WideSlabs> slabs_;
  std::vector<std::int32_t> slabs_at_;  // of each node; -1 for none
  std::int32_t root_ = 0;
  double slack_ = 0;
  int depth_ = 0;
};

}  // namespace palmar
