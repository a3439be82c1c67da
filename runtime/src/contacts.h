// Candidates: every (link, sphere) pair that the hand can reach in this step; their gaps; and rows for the QP.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "gap.h"
#include "hand.h"
#include "object.h"
#include "qp.h"

namespace palmar {

// Pairs within `margin` of where the hand was when they were gathered. Complete: as long as no link has moved farther
// than `margin` from there, a pair that is not in the list cannot touch.
struct Candidates {
  explicit Candidates(int capacity);

  struct Pair {
    Vec3 center;  // of the object's sphere, object frame
    double radius;
    std::uint32_t object_sphere;
    std::uint32_t palm_sphere;  // UINT32_MAX for a phalanx
  };
  std::vector<Pair> pairs;                   // sorted by link; the first `count` are valid
  std::array<int, kLinks + 1> link_start{};  // pairs of link l: link_start[l] .. link_start[l + 1]
  int count = 0;
  HandPlacement from;  // where the hand was
  double margin = 0;
  std::vector<std::uint32_t> found;  // scratch
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

// Fills `out` with the pairs within `margin` of the placement. False when they do not fit. Links before first_link keep
// the pairs that they have, links from end_link on get none.
bool gather_candidates(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object,
                       const HandPlacement& at, double margin, Candidates& out, std::uint32_t& visited,
                       int first_link = 0, int end_link = kLinks);

// Exact gaps of all candidates at a placement, into `gap` (count long). Returns the smallest (+infinity for none).
double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap);

// One row for each candidate with gap <= limit: the linearised gap may not fall below `aim`, or below what it is now if
// it is between 0 and `aim`; `push_out` asks for `aim` even where that means moving away. Row i is candidate
// row_candidate[i]. False when the rows do not fit.
bool linearise(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, const double* gap,
               double limit, double aim, bool push_out, QpRows& rows, std::int32_t* row_candidate);

}  // namespace palmar
