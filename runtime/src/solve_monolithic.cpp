// The configuration-based optimisation that the paper started from, for a whole hand.
//
// D. Wang, X. Zhang, Y. Zhang, J. Xiao, "Configuration-based optimization for six degree-of-freedom haptic rendering
// for fine manipulation", IEEE Trans. Haptics 6(2), 2013, as Tong et al. (2022) apply it to a hand: one programme over
// all 21 variables (palm translation, palm rotation, fifteen flexions; abduction is copied),
//     minimise  (Q_g - Q_h)' G (Q_g - Q_h) / 2   (Eq. 2)
// with one row for each pair of spheres or phalanx and sphere within 0.5 mm of the last graphic hand, linearised once
// there (Eq. 8), and no priority between palm and fingers.
//
// Expected to fail: motion beyond the band meets no row (tunnelling); one linearisation of long rotations leaves a
// second-order error; the copied abduction can carry a finger in; soft palm and fingers share one load, so the palm
// gives way where a finger could.
#include "baseline.h"

namespace palmar {

std::uint32_t solve_monolithic(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  constexpr double kBand = 5e-4;  // metres, the published value
  state.haptic = haptic;
  work.active_count = 0;
  Configuration q = state.graphic;
  q.abduction = haptic.abduction;
  const HandPlacement at = place_hand(scene.hand, q);
  if (!gather_near(scene, at, kBand, 0, kLinks, work)) return kKeptPrevious;
  PerLink band;
  band.fill(kBand);
  if (!linearise(work.candidates, at, work.gap.data(), band, nullptr, 0.0, true, work.rows, work.row_candidate.data()))
    return kKeptPrevious;
  bool relaxed;
  const QpResult result = solve_least_violation(scene, towards(scene.hand, q, haptic), work, relaxed);
  std::uint32_t status = result.status == QpStatus::solved ? kOk : kIterationLimit;
  if (!relaxed) remember_active(scene, result, work);
  // With nothing in the way it is the haptic pose itself, to the bit.
  q = result.active == 0 ? haptic : advance(q, result.x, 1.0);
  return status | publish_unverified(scene, q, state, work);
}

}  // namespace palmar
