// Candidates: every (link, sphere) pair that a link can reach; their gaps; and rows for the QP.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "gap.h"
#include "hand.h"
#include "object.h"
#include "qp.h"

namespace palmar {

using PerLink = std::array<double, kLinks>;

// Work is counted in operations of about fifteen nanoseconds, whatever it is spent on.
constexpr std::uint32_t kNodeOperations = 3;  // sixteen spheres against a link, or sixteen of the palm against one

// A step looks this far around a link for what its rows and contacts need, metres; beyond, a bound of the gap is
// enough.
constexpr double kLook = 3e-5;

// Pairs within margin[l] of link l where it was when its list was made, in `from`. Complete: as long as link l has not
// moved farther than margin[l] from there, a pair of it that is not in the list cannot touch. A list stays good for as
// many steps as that holds.
struct Candidates {
  explicit Candidates(int per_link_);

  int per_link;                     // room of each link
  std::array<int, kLinks> count{};  // pairs of link l: begin(l) .. end(l)
  PerLink margin;                   // below zero: no list
  HandPlacement from;

  // A list lies in shells of equal width, nearest first: the pairs of shell k were (k / kShells) margin away in `from`
  // or farther. While the link has moved less than that, nothing need be known of them.
  static constexpr int kShells = 16;
  std::array<std::array<int, kShells>, kLinks> shell_end{};  // pairs of the link in shells 0 .. k

  // One entry a pair. x, y, z, radius: the object's sphere, in its frame; palm_x .. palm_radius, for link 0 only: the
  // palm's, in the palm's.
  std::vector<double> x, y, z, radius, palm_x, palm_y, palm_z, palm_radius;
  std::vector<std::uint32_t> object_sphere, palm_sphere;

  int begin(int link) const { return link * per_link; }
  int end(int link) const { return begin(link) + count[link]; }
  int link_of(int pair) const { return pair / per_link; }
  int total() const;
  int size() const { return kLinks * per_link; }
  Vec3 center(int pair) const { return {x[pair], y[pair], z[pair]}; }
  void forget();  // every list

  // Scratch of a search: pairs found and nodes to look into, each with a lower bound of its gap.
  struct Near {
    float gap;
    std::uint32_t object_sphere, palm_sphere;
  };
  struct Node {
    float gap;
    std::uint32_t node, group;
  };
  std::vector<Near> near;
  std::vector<Node> nodes;

  // A search whose operations ended before it knew anything: what it had in the scratch, to go on from there as long as
  // the link stays where it is and nothing else is searched for.
  struct Unfinished {
    int link = -1;
    HandPlacement at;
    double margin;  // that it was asked for
    float limit;
    int pairs, nodes;
  } unfinished;

  // The list of a link at a placement: the first `pairs` in `near`.
  void put(const HandModel& hand, const CollisionObject& object, const HandPlacement& at, int link, int pairs,
           double margin_m);
};

// How far link l may go from `at` before its list is no longer complete; below zero without a list.
double room_of(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link);

// Gaps of one link's or all pairs at a placement, into `gap` (by pair number): exact where they may be less than
// `look`, else a lower bound. Returns the smallest (+infinity for none). Adds what it did to `operations`.
double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link,
                     double* gap, double look, std::uint32_t& operations);
double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap);

// The smallest of `count` gaps; +infinity of none.
double smallest(const double* gap, int count);

// One row for each pair with gap <= limit of its link, or named in `also` (may be null; by pair number): the linearised
// gap may not fall below `aim`, or below what it is now if it is between 0 and `aim`; `push_out` asks for `aim` even
// where that means moving away. Row i is pair row_candidate[i]. False when the rows do not fit; those that do are
// there.
bool linearise(const Candidates& candidates, const HandPlacement& at, const double* gap, const PerLink& limit,
               const std::uint8_t* also, double aim, bool push_out, QpRows& rows, std::int32_t* row_candidate);

}  // namespace palmar
