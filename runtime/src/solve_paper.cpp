// The method as published.
//
// Q. Tong et al., "Configuration-Based Optimization for Virtual Hand Haptic Simulation", IEEE Trans. Haptics, 2022.
// Palm: rotation copied, sphere pairs within the 0.5 mm band around the last graphic palm, linearised once, programme
// in three translations (Eqs. 3, 8). Then each finger on the new palm: abduction copied, pairs of frustum and sphere
// within the band, squared-distance rows (Eqs. 4-7, 10, 13) with the printed ranges of k, linearised once, programme in
// three angles with torsional stiffness (Eq. 9). Corrected: (r_H + r_O)^2 in (3); (10), not (11), inside (13); the
// knuckle's place in the chain of (11); fingers look for contacts where the palm has carried them. Said nowhere, chosen
// here: what has no answer gets the one of least violation; joint limits hold.
//
// Expected to fail: fingers that flexion cannot free (the palm, the wrist or abduction carried them in); motion beyond
// the band in one step; angle jumps where one linearisation leaves a row nearly without gradient; hovering by up to
// 0.41 of a leaf's radius at the ends of a frustum; balls between phalanges meet no row.
#include <algorithm>

#include "baseline.h"

namespace palmar {

namespace {

constexpr double kBand = 5e-4;  // metres, Delta r of Section IV-B

// Phalanx with axis points D and E, radii r1 and r2 there.
struct Frustum {
  Vec3 d, e;
  double r1, r2, cos_phi, sin_phi;
};

// The inverse of capsule_of_frustum: R = r / cos(phi), c = D - r1 tan(phi) u.
Frustum frustum_of_capsule(const Capsule& c) {
  const double length = (c.c2 - c.c1).norm();
  const Vec3 u = (c.c2 - c.c1) / length;
  const double sin_phi = (c.r1 - c.r2) / length, cos_phi = std::sqrt(1.0 - sin_phi * sin_phi);
  return {c.c1 + c.r1 * sin_phi * u, c.c2 + c.r2 * sin_phi * u, c.r1 * cos_phi, c.r2 * cos_phi, cos_phi, sin_phi};
}

// C >= 0 and its gradient in the sphere's centre, both in the frustum's frame; divided by twice the contact distance,
// so that a row is in metres.
struct Constraint {
  bool near;
  double value;
  Vec3 gradient;
};

Constraint frustum_sphere_constraint(const Frustum& f, const Vec3& o, double radius, bool distal) {
  const Vec3 ed = f.d - f.e, eo = o - f.e;
  const double length = ed.norm();
  const double k = eo.dot(ed) / ed.squaredNorm();  // Eq. 6: 0 at E, 1 at D
  const double grown = radius + kBand;
  // Eq. 13: beyond the seam the fingertip's hemisphere.
  if (distal && k < -radius * f.sin_phi / length) {
    const double touch = radius + f.r2;
    const double value = (eo.squaredNorm() - touch * touch) / (2 * touch);
    return {k >= -(grown + f.r2) / length && eo.norm() <= grown + f.r2, value, eo / touch};
  }
  const double touch = radius / f.cos_phi + k * (f.r1 - f.r2) + f.r2;  // Eq. 5
  const Vec3 foot = f.e + k * ed;
  const Vec3 off = o - foot;  // C to O
  const double slope = (f.r1 - f.r2) / length;
  const bool near =
      k >= -grown / length && k <= 1 + grown / length && off.norm() <= touch + kBand / f.cos_phi;  // Eq. 7
  return {near && touch > 0, (off.squaredNorm() - touch * touch) / (2 * touch), off / touch - slope * ed / length};
}

// Rows of finger f, in its three flexions, at a placement (Eqs. 10, 12, 13).
void finger_rows(const HandPlacement& at, int f, Workspace& work) {
  QpRows& rows = work.rows;
  rows.count = 0;
  for (int phalanx = 0; phalanx < kPhalanges; ++phalanx) {
    const int link = 1 + kPhalanges * f + phalanx;
    const Frustum frustum = frustum_of_capsule(at.phalanx[link - 1]);
    for (int i = work.candidates.begin(link); i < work.candidates.end(link) && rows.count < rows.capacity; ++i) {
      const Vec3 center = work.candidates.center(i);
      const Constraint c =
          frustum_sphere_constraint(frustum, center, work.candidates.radius[i], phalanx + 1 == kPhalanges);
      if (!c.near) continue;
      const int row = rows.count++;
      for (int k = 0; k <= kPalmVariables; ++k) rows.g[k][row] = 0;
      // A turn of the phalanx moves the sphere the other way in its frame.
      for (int j = 0; j < kPhalanges; ++j)
        rows.g[kPalmVariables + 1 + j][row] =
            j <= phalanx ? -c.gradient.dot(at.flexion_axis[f][j].cross(center - at.joint[f][j])) : 0.0;
      rows.b[row] = -c.value;
      work.row_candidate[row] = i;
    }
  }
  for (int group = 0; group <= kFingers + 1; ++group) rows.group_start[group] = group <= f + 1 ? 0 : rows.count;
}

// The programme of one part of the hand: everything but `count` variables from `first` on is held.
QpProblem part_of(QpProblem problem, int first, int count) {
  for (int v = 0; v < kVariables; ++v) {
    if (v >= first && v < first + count) continue;
    problem.metric.set_diagonal(v, 0);
    problem.target[v] = 0;
  }
  return problem;
}

}  // namespace

std::uint32_t solve_paper(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  const HandModel& hand = scene.hand;
  std::uint32_t status = kOk;
  state.haptic = haptic;
  work.active_count = 0;
  bool relaxed;

  // Palm.
  if (!gather_near(scene, state.placement, kBand, 0, 1, work)) return kKeptPrevious;
  Configuration q = state.graphic;
  q.rotation = haptic.rotation;
  q.abduction = haptic.abduction;
  HandPlacement at = place_hand(hand, q);
  evaluate_gaps(hand, work.candidates, at, work.gap.data());
  PerLink all;
  all.fill(1e9);  // metres: the band has chosen already
  linearise(work.candidates, at, work.gap.data(), all, nullptr, 0.0, true, work.rows, work.row_candidate.data());
  const QpResult palm = solve_least_violation(scene, part_of(towards(hand, q, haptic), 0, 3), work, relaxed);
  if (palm.status != QpStatus::solved) status |= kIterationLimit;
  if (!relaxed) remember_active(scene, palm, work);
  q.position = palm.active == 0 ? haptic.position : Vec3(q.position + Vec3(palm.x[0], palm.x[1], palm.x[2]));

  // Fingers. Outside a frustum's end a sphere of radius R may still be within the printed ranges when it is
  // (sqrt(2) - 1) R / cos(phi) away; half a radius covers every phalanx.
  at = place_hand(hand, q);
  if (!gather_near(scene, at, kBand + 0.5 * scene.object.leaf_radius_max, 1, kLinks, work))
    return status | publish_unverified(scene, q, state, work) | kIterationLimit;
  const QpProblem whole = towards(hand, q, haptic);
  Configuration next = q;
  for (int f = 0; f < kFingers; ++f) {
    finger_rows(at, f, work);
    const int v = kPalmVariables + kFingerVariables * f + 1;
    const QpResult finger = solve_least_violation(scene, part_of(whole, v, kPhalanges), work, relaxed);
    if (finger.status != QpStatus::solved) status |= kIterationLimit;
    if (!relaxed) remember_active(scene, finger, work);
    for (int j = 0; j < kPhalanges; ++j)
      next.flexion[f][j] = finger.active == 0 ? haptic.flexion[f][j] : q.flexion[f][j] + finger.x[v + j];
  }
  return status | publish_unverified(scene, next, state, work);
}

}  // namespace palmar
