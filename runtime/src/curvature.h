// How the gap of a pair bends with the pose: the second-order part of a contact's constraint.
#pragma once

#include "hand.h"
#include "object.h"
#include "qp.h"

namespace palmar {

// A pair's gap as a function of a change of the pose, to second order: its first derivatives by the variables that
// move it, the palm's and, for a phalanx, its finger's.
struct GapShape {
  double gap;
  int finger;  // -1 for the palm
  int count;   // of the variables: 6 to 10
  double slope[kPalmVariables + kFingerVariables];
  double bend[kPalmVariables + kFingerVariables][kPalmVariables + kFingerVariables];  // upper part
};

// The pair is `sphere` of the object with a link of the hand at a placement; of the palm (link 0) with its sphere
// number `palm_sphere`.
GapShape gap_shape(const HandModel& hand, const HandPlacement& at, int link, std::uint32_t palm_sphere,
                   const Sphere& sphere);

// h += bend_factor * (second derivatives) + slope_factor * (first derivatives times themselves).
void add_shape(const GapShape& shape, double bend_factor, double slope_factor, ArrowMatrix& h);

}  // namespace palmar
