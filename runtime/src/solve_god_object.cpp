// A proxy that moves under constraints from contact to contact.
//
// J. Jacobs, M. Stengel, B. Froehlich, "A generalized god-object method for plausible finger-based interactions in
// virtual environments", IEEE 3DUI 2012, after M. Ortega, S. Redon, S. Coquillart, "A six degree-of-freedom god-object
// method for haptic display of rigid bodies with surface properties", IEEE TVCG 13(3), 2007: the proxy's motion is the
// one nearest to the tracked hand's way that current contacts allow, Gauss' principle of least constraint without
// accelerations,
//     minimise  (x - d)' G (x - d) / 2   subject to   g_i . x >= 0 for every pair in contact,
// over all 26 variables, G in the place of the masses; it is followed until the first new contact, found by
// conservative advancement; then again, kMoves times at most in a step.
//
// Expected to fail: it stops at each new sphere, so over many small spheres its moves are used up and it trails the
// hand; turns drift into contacts that the constraints hold only to first order, and the next step pushes out again.
#include <algorithm>
#include <limits>

#include "baseline.h"

namespace palmar {

namespace {

constexpr int kMoves = 10;
constexpr int kAdvances = 20;      // of the search for the next contact, in one move
constexpr double kContact = 2e-5;  // metres: a pair this near constrains
constexpr double kDrift = 1e-5;    // metres that a turn may sink into a contact of the move
constexpr double kSettled = 1e-7;  // metres; a move shorter than this is the end

// Rows of pairs in contact; with no answer, at least nothing in contact may come nearer.
QpResult constrained_motion(const Scene& scene, const QpProblem& problem, const HandPlacement& at, Workspace& work) {
  const int limit = scene.settings.qp_iterations;
  PerLink contact;
  contact.fill(kContact);
  linearise(work.candidates, at, work.gap.data(), contact, nullptr, 0.0, true, work.rows, work.row_candidate.data());
  for (int i = 0; i < work.rows.count; ++i) work.rows.b[i] = std::max(0.0, work.rows.b[i]);
  QpResult result = solve_qp(problem, work.rows, 1e-9, limit, work.violation.data());
  if (result.status == QpStatus::infeasible) {
    std::fill_n(work.rows.b.begin(), work.rows.count, 0.0);
    result = solve_qp(problem, work.rows, 1e-9, limit, work.violation.data());
  }
  work.operations += work.rows.count + result.iterations;
  return result;
}

double least_room(const HandModel& hand, const Candidates& candidates, const HandPlacement& at) {
  double least = room_of(hand, candidates, at, 0);
  for (int link = 1; link < kLinks; ++link) least = std::min(least, room_of(hand, candidates, at, link));
  return least;
}

// How far along the way the hand may go, 0 to 1: conservative advancement. No point of link l covers more than its
// speed in all, so a share of (clearance / speed) is free. Pairs of the move's contacts may sink in by kDrift.
double free_share(const Scene& scene, const Configuration& q, const HandPlacement& at, const Change& way,
                  Workspace& work) {
  const HandModel& hand = scene.hand;
  const Candidates& candidates = work.candidates;
  const HandPlacement end = place_hand(hand, advance(q, way, 1.0));
  std::array<double, kLinks> speed;
  double most = 0;
  for (int link = 0; link < kLinks; ++link) {
    // A turn's arc is longer than its chord: 5 % covers one radian.
    speed[link] = 1.05 * link_motion(hand, at, end, link) + 1e-12;
    most = std::max(most, speed[link]);
  }
  // Beyond the margin nothing is known.
  const double known = std::min(1.0, least_room(hand, candidates, at) / most);
  double share = 0;
  for (int k = 0; k < kAdvances && share < known; ++k) {
    double step = known - share;
    const double* gap = share == 0 ? work.gap.data() : work.trial_gap.data();
    for (int link = 0; link < kLinks; ++link) {
      for (int i = candidates.begin(link); i < candidates.end(link); ++i) {
        const bool held = work.gap[i] <= kContact;
        const double room = held ? gap[i] - std::min(0.0, work.gap[i]) + kDrift : gap[i];
        step = std::min(step, std::max(0.0, room) / speed[link]);
      }
    }
    share += step;
    if (step * most < kSettled) break;
    if (share < known) evaluate_gaps(hand, candidates, place_hand(hand, advance(q, way, share)), work.trial_gap.data());
    work.operations += candidates.total();
  }
  return share;
}

}  // namespace

std::uint32_t solve_god_object(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  const HandModel& hand = scene.hand;
  const Settings& s = scene.settings;
  const Change stiffness = stiffness_diagonal(hand);
  state.haptic = haptic;
  work.active_count = 0;
  Configuration q = state.graphic;
  HandPlacement at = state.placement;
  double& reach = state.reach[0];  // of every link
  double moved = 0;
  bool arrived = false;
  work.candidates.forget();  // of the last step, elsewhere
  for (int k = 0; k < kMoves && !arrived; ++k) {
    const double left = largest_motion(hand, at, place_hand(hand, haptic));
    if (left == 0) break;
    const bool used_up = least_room(hand, work.candidates, at) < 0.5 * reach;
    if (used_up) {
      if (!gather_near(scene, at, std::min(1.1 * left + kContact, reach), 0, kLinks, work)) break;
    } else {
      evaluate_gaps(hand, work.candidates, at, work.gap.data());
    }
    QpProblem problem = towards(hand, q, haptic);
    problem.target = difference(haptic, q);
    for (int v = 0; v < kVariables; ++v) problem.metric.set_diagonal(v, 1.0 / stiffness[v]);
    const QpResult result = constrained_motion(scene, problem, at, work);
    work.active_count = 0;
    remember_active(scene, result, work);

    const double share = free_share(scene, q, at, result.x, work);
    const Configuration next = share == 1.0 && result.active == 0 ? haptic : advance(q, result.x, share);
    const HandPlacement next_at = place_hand(hand, next);
    const double motion = largest_motion(hand, at, next_at);
    q = next;
    at = next_at;
    moved += motion;
    arrived = share == 1.0 || motion < kSettled;
    // Where the margin, not a contact, ended the move, the next look is wider.
    if (!arrived && least_room(hand, work.candidates, at) < 0.1 * reach)
      reach = std::min(4 * reach, work.candidates.total() > 0 ? s.reach_most_m : s.free_reach_m);
  }
  reach = std::clamp(2.5 * moved, s.reach_least_m, work.candidates.total() > 0 ? s.reach_most_m : s.free_reach_m);
  return (arrived ? kOk : kIterationLimit) | publish_unverified(scene, q, state, work);
}

}  // namespace palmar
