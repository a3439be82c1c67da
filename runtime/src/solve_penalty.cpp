// A hand on spring-dampers, pushed out of the object by springs, integrated over time.
//
// C. W. Borst, A. P. Indugula, "Realistic virtual grasping", IEEE Virtual Reality 2005, and "A spring model for
// whole-hand virtual grasping", Presence 15(1), 2006: linear and torsional spring-dampers couple the graphic hand,
// which has inertia, to the tracked one; overlaps push back in proportion to their depth.
//     M v' = G (Q_h - Q_g) + D (v_h - v) + sum_i g_i max(0, k p_i - c g_i . v)
// with p_i the depth of pair i and g_i the gradient of its gap. The coupling is G itself, so that forces compare; M is
// G / w^2 and D is 2 G / w: every coordinate critically damped at one frequency w. Ten sub-steps a step, each implicit
// in springs and dampers of coupling and contact (a 26 x 26 Cholesky factor): explicit ones chatter at these
// stiffnesses.
//
// w, k and c were chosen on a grid of 3 x 3 x 3 (docs/solvers.md).
//
// Expected to fail: it sinks in by force over stiffness; spheres that toggle shake it; fast motion goes through; and it
// trails the tracked hand's acceleration a by a / w^2.
#include <algorithm>

#include "baseline.h"

namespace palmar {

namespace {

constexpr int kSubSteps = 10;
constexpr double kFrequency = 300;         // rad / s
constexpr double kContactStiffness = 1e6;  // N / m, of one pair
constexpr double kContactDamping = 10;     // N s / m
constexpr double kMargin = 1e-3;           // metres, of the search

using Matrix = Eigen::Matrix<double, kVariables, kVariables>;
using Vector = Eigen::Matrix<double, kVariables, 1>;

// Adds one pair's spring and damper to the implicit system. `row` of group `finger`.
void add_contact(const QpRows& rows, int row, int finger, double h, const Vector& velocity, Matrix& a, Vector& rhs) {
  std::array<int, kPalmVariables + kFingerVariables> index;
  const int size = finger < 0 ? kPalmVariables : kPalmVariables + kFingerVariables;
  double rate = 0;  // of the gap
  for (int k = 0; k < size; ++k) {
    index[k] = k < kPalmVariables ? k : k + kFingerVariables * finger;
    rate += rows.g[k][row] * velocity[index[k]];
  }
  // Only approach is damped: a damper does not hold back what leaves.
  const double stiff = h * h * kContactStiffness + (rate < 0 ? h * kContactDamping : 0.0);
  const double push = h * kContactStiffness * rows.b[row];
  for (int i = 0; i < size; ++i) {
    rhs[index[i]] += push * rows.g[i][row];
    for (int k = 0; k < size; ++k) a(index[i], index[k]) += stiff * rows.g[i][row] * rows.g[k][row];
  }
}

}  // namespace

std::uint32_t solve_penalty(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  const HandModel& hand = scene.hand;
  const double dt = 1.0 / scene.settings.rate_hz, h = dt / kSubSteps;
  const Configuration before = state.haptic;
  const Change way = difference(haptic, before);
  const Change stiffness = stiffness_diagonal(hand);
  state.haptic = haptic;
  work.active_count = 0;

  Configuration q = state.graphic;
  HandPlacement at = state.placement;
  Vector velocity = Eigen::Map<const Vector>(state.velocity.data());
  work.candidates.forget();  // of the last step, elsewhere
  PerLink touching;
  touching.fill(0.0);
  for (int k = 1; k <= kSubSteps; ++k) {
    // Only overlaps at this very pose push: the list is whole as long as no link has left its margin.
    bool complete = true;
    for (int link = 0; link < kLinks; ++link) complete &= room_of(hand, work.candidates, at, link) >= 0;
    if (!complete) {
      if (!gather_near(scene, at, kMargin, 0, kLinks, work)) return kKeptPrevious;
    } else {
      evaluate_gaps(hand, work.candidates, at, work.gap.data());
      work.operations += work.candidates.total();
    }
    linearise(work.candidates, at, work.gap.data(), touching, nullptr, 0.0, true, work.rows, work.row_candidate.data());
    work.operations += work.rows.count;

    const Change pull = difference(k == kSubSteps ? haptic : advance(before, way, double(k) / kSubSteps), q);
    Matrix a = Matrix::Zero();
    Vector rhs;
    for (int v = 0; v < kVariables; ++v) {
      const double mass = stiffness[v] / (kFrequency * kFrequency), damping = 2 * stiffness[v] / kFrequency;
      a(v, v) = mass + h * damping + h * h * stiffness[v];
      rhs[v] = mass * velocity[v] + h * stiffness[v] * pull[v] + h * damping * way[v] / dt;
    }
    for (int group = 0; group <= kFingers; ++group)
      for (int row = work.rows.group_start[group]; row < work.rows.group_start[group + 1]; ++row)
        add_contact(work.rows, row, group - 1, h, velocity, a, rhs);
    velocity = work.rows.count == 0 ? Vector(rhs.cwiseQuotient(a.diagonal())) : Vector(a.llt().solve(rhs));
    Change motion;
    for (int v = 0; v < kVariables; ++v) motion[v] = h * velocity[v];
    q = advance(q, motion, 1.0);
    clip_to_limits(hand, q);
    at = place_hand(hand, q);
  }
  Eigen::Map<Vector>(state.velocity.data()) = velocity;
  return publish_unverified(scene, q, state, work);
}

}  // namespace palmar
