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

// Pairs within margin[l] of link l where it was when its list was made, in `from`. Complete: as long as link l has not
// moved farther than margin[l] from there, a pair of it that is not in the list cannot touch. A list stays good for as
// many steps as that holds.
struct Candidates {
  explicit Candidates(int per_link_);

  int per_link;                     // room of each link
  std::array<int, kLinks> count{};  // pairs of link l: begin(l) .. end(l)
  PerLink margin;                   // below zero: no list
  HandPlacement from;

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

  // Scratch of a search.
  std::vector<std::uint32_t> found;
  struct Near {
    double gap;
    std::uint32_t object_sphere, palm_sphere;
  };
  std::vector<Near> near;
};

// The palm's own spheres in groups of up to sixteen neighbours, each with the box around their centres (palm frame), so
// that palm against object costs contacts, not spheres times spheres.
struct PalmGroups {
  explicit PalmGroups(const HandModel& hand);
  struct Group {
    WideNode node;
    std::array<std::uint32_t, kWide> sphere;
    int count;
    Vec3 low, high;
    double radius;  // the largest
  };
  std::vector<Group> groups;
};

// Makes the list of one link anew: the pairs within `margin` of the placement. Where they are more than the list has
// room for, the nearest ones, and the margin becomes the gap of the first left out: exact for shorter moves.
void gather_link(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
                 int link, double margin, Candidates& out, std::uint32_t& visited);

// True if no sphere of the object enters any part of the hand there; false also where so many touch that looking at
// each would take long. Ends at the first that enters.
bool is_free(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
             std::uint32_t& visited);

// How far link l may go from `at` before its list is no longer complete; below zero without a list.
double room_of(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link);

// Exact gaps of one link's or all pairs at a placement, into `gap` (by pair number). Returns the smallest (+infinity
// for none).
double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link,
                     double* gap);
double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap);

// The smallest of `count` gaps; +infinity of none.
double smallest(const double* gap, int count);

// One row for each pair with gap <= limit of its link, or named in `also` (may be null; by pair number): the linearised
// gap may not fall below `aim`, or below what it is now if it is between 0 and `aim`; `push_out` asks for `aim` even
// where that means moving away. Row i is pair row_candidate[i]. False when the rows do not fit; those that do are
// there.
bool linearise(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, const double* gap,
               const PerLink& limit, const std::uint8_t* also, double aim, bool push_out, QpRows& rows,
               std::int32_t* row_candidate);

}  // namespace palmar
