#include "baseline.h"

#include <algorithm>
#include <limits>

namespace palmar {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kPublishMargin = 2e-5;  // metres: twice the gap that counts as a contact
constexpr double kSlackStiffness = 1e4;  // of a violation, in units of the palm's stiffness
// What a palm may do in one step beyond the haptic one's way. Rows that nearly contradict each other are met tens of
// metres away; such an answer is none.
constexpr double kPalmStep = 0.1;             // metres
constexpr double kPalmTurn = 1.0;             // rad
constexpr double kProgrammeTolerance = 1e-9;  // metres

}  // namespace

Change stiffness_diagonal(const HandModel& hand) {
  Change g;
  for (int k = 0; k < 3; ++k) {
    g[k] = hand.palm_stiffness;
    g[3 + k] = hand.palm_rotation_stiffness;
  }
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    g[v] = hand.finger[f].stiffness[0];
    for (int j = 0; j < kPhalanges; ++j) g[v + 1 + j] = hand.finger[f].stiffness[j];
  }
  return g;
}

void joint_room(const HandModel& hand, const Configuration& q, Change& lower, Change& upper) {
  lower.fill(-kInfinity);
  upper.fill(kInfinity);
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    const auto room = [&](int k, double angle, const std::array<double, 2>& limit) {
      lower[v + k] = std::min(0.0, limit[0] - angle);
      upper[v + k] = std::max(0.0, limit[1] - angle);
    };
    room(0, q.abduction[f], hand.finger[f].abduction_limit);
    for (int j = 0; j < kPhalanges; ++j) room(1 + j, q.flexion[f][j], hand.finger[f].flexion_limit[j]);
  }
}

QpProblem towards(const HandModel& hand, const Configuration& q, const Configuration& haptic) {
  QpProblem problem;
  const Change g = stiffness_diagonal(hand);
  problem.target = difference(haptic, q);
  for (int v = 0; v < kVariables; ++v) problem.metric.set_diagonal(v, 1.0 / g[v]);
  for (int f = 0; f < kFingers; ++f) {
    problem.metric.set_diagonal(kPalmVariables + kFingerVariables * f, 0);
    problem.target[kPalmVariables + kFingerVariables * f] = 0;
  }
  problem.bound.fill(kInfinity);
  for (int k = 0; k < 3; ++k) {
    problem.bound[k] = std::max(kPalmStep, std::abs(problem.target[k]));
    problem.bound[3 + k] = std::max(kPalmTurn, std::abs(problem.target[3 + k]));
  }
  joint_room(hand, q, problem.lower, problem.upper);
  return problem;
}

void clip_to_limits(const HandModel& hand, Configuration& q) {
  for (int f = 0; f < kFingers; ++f) {
    const Finger& finger = hand.finger[f];
    q.abduction[f] = std::clamp(q.abduction[f], finger.abduction_limit[0], finger.abduction_limit[1]);
    for (int j = 0; j < kPhalanges; ++j)
      q.flexion[f][j] = std::clamp(q.flexion[f][j], finger.flexion_limit[j][0], finger.flexion_limit[j][1]);
  }
}

bool gather_near(const Scene& scene, const HandPlacement& at, double margin, int first_link, int end_link,
                 Workspace& work) {
  const auto start = Clock::now();
  std::uint32_t visited = 0;
  bool found = true;
  for (int link = first_link; link < kLinks; ++link) {
    work.candidates.count[link] = 0;
    work.candidates.margin[link] = -1.0;
    if (link >= end_link) continue;
    gather_link(scene.hand, scene.palm, scene.object, at, link, margin, work.candidates, visited);
    found &= work.candidates.margin[link] >= 0;
  }
  if (!found) work.candidates.forget();
  evaluate_gaps(scene.hand, work.candidates, at, work.gap.data());
  work.operations += visited + work.candidates.total();
  work.search_us += microseconds_since(start);
  return found;
}

QpResult solve_least_violation(const Scene& scene, QpProblem problem, Workspace& work, bool& relaxed) {
  const auto start = Clock::now();
  const int limit = scene.settings.qp_iterations;
  QpRows& rows = work.rows;
  QpResult result = solve_qp(problem, rows, kProgrammeTolerance, limit, work.violation.data());
  work.operations += rows.count + result.iterations;
  relaxed = result.status == QpStatus::infeasible;
  if (relaxed) {
    for (int k = 0; k < kFingerVariables; ++k)
      std::fill_n(rows.g[kPalmVariables + k].begin(), k == 0 ? rows.count : rows.group_start[1], k == 0 ? 1.0 : 0.0);
    rows.group_start[1] = 0;
    for (int f = 0; f < kFingers; ++f) {
      const int v = kPalmVariables + kFingerVariables * f;
      problem.metric.set_diagonal(v, 1.0 / (kSlackStiffness * scene.hand.palm_stiffness));
      problem.lower[v] = -kInfinity;
      problem.upper[v] = kInfinity;
    }
    result = solve_qp(problem, rows, kProgrammeTolerance, limit, work.violation.data());
    work.operations += rows.count + result.iterations;
    for (int f = 0; f < kFingers; ++f) result.x[kPalmVariables + kFingerVariables * f] = 0;
  }
  work.solve_us += microseconds_since(start);
  return result;
}

void remember_active(const Scene& scene, const QpResult& result, Workspace& work) {
  for (int j = 0; j < result.active && work.active_count < kVariables; ++j) {
    if (result.active_row[j] < 0) continue;
    const int candidate = work.row_candidate[result.active_row[j]];
    // The session divides the palm's by the priority that `progressive` weighs it with.
    const double scale = work.candidates.link_of(candidate) == 0 ? scene.settings.palm_priority : 1.0;
    work.active[work.active_count++] = {candidate, scale * result.multiplier[j]};
  }
}

std::uint32_t publish_unverified(const Scene& scene, const Configuration& q, SolverState& state, Workspace& work) {
  struct Named {
    int link;
    std::uint32_t object_sphere, palm_sphere;
    double multiplier;
  };
  std::array<Named, kVariables> active;
  const int count = work.active_count;
  for (int k = 0; k < count; ++k) {
    const int pair = work.active[k].candidate;
    active[k] = {work.candidates.link_of(pair), work.candidates.object_sphere[pair], work.candidates.palm_sphere[pair],
                 work.active[k].multiplier};
  }

  state.graphic = q;
  state.placement = place_hand(scene.hand, q);
  work.active_count = 0;
  if (!gather_near(scene, state.placement, kPublishMargin, 0, kLinks, work)) return kIterationLimit;
  const Candidates& now = work.candidates;
  for (int k = 0; k < count; ++k) {
    for (int i = now.begin(active[k].link); i < now.end(active[k].link); ++i) {
      if (now.object_sphere[i] != active[k].object_sphere || now.palm_sphere[i] != active[k].palm_sphere) continue;
      work.active[work.active_count++] = {i, active[k].multiplier};
      break;
    }
  }
  return kOk;
}

}  // namespace palmar
