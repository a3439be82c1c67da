// Which pairs a link can reach: the nearest ones, found by branch and bound over the object's tree.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "contacts.h"

namespace palmar {

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

// How much one search may do and find.
struct SearchLimits {
  double least_margin = 0;                // more than `enough` pairs only within this, metres
  int enough = 1 << 29;                   // pairs
  std::uint32_t operations = UINT32_MAX;  // when they are used up the search ends
};

// Makes the list of one link anew: every pair nearer than `margin` at the placement. Nodes are looked into in the order
// of what they may hold, the nearest first; where pairs find no room, or the limits end the search, the margin becomes
// the least that anything left out may be away: always complete for moves shorter than `out.margin`. Adds what it did
// to `operations`. A list of the same object that reaches farther from there stays as it is. A search that had to end
// before it knew of any margin goes on where it ended if it is the next one, for the same link at the same place. The
// list of a link that the hand leaves out is empty and reaches everywhere.
void gather_link(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
                 int link, double margin, Candidates& out, std::uint32_t& operations, const SearchLimits& limits = {});

// True if no sphere of the object enters any part of the hand there; false also where so many touch that looking at
// each would take long. Ends at the first that enters.
bool is_free(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
             std::uint32_t& visited);

}  // namespace palmar
