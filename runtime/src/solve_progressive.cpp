// The product's solver: feasible sequential quadratic programming with priorities.
//
// Every step starts from the last published pose, which touches nothing (all gaps >= 0), and looks for one that costs
// less. One programme holds the palm (translation, rotation) and the fingers (abduction, three flexions). The palm's
// position weighs `palm_priority` times its stiffness, so a finger gives way before the palm does: the paper's order,
// palm before fingers (Eqs. 8, 9), as a limit of weights. What the paper copies from the haptic hand, rotation and
// abduction, weighs `imposed_priority` times more again and gives way last. Standing still satisfies every row, so the
// programme always has an answer, blocked fingers and imposed rotations included: no mode to switch, no retry.
//
// A pose is published only if (1) no link moved farther than the margin that the candidates were gathered with, so no
// sphere outside the list can have been touched or skipped; (2) every candidate's exact gap there is >= 0; (3) it costs
// less than the pose before. By (3) a constant input has no limit cycle.
#include <algorithm>
#include <chrono>
#include <limits>

#include "solver.h"

namespace palmar {

namespace {

using Clock = std::chrono::steady_clock;

constexpr int kAttempts = 3;  // trial poses along one direction: all of it, a quarter, a sixteenth

double microseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::micro>(Clock::now() - start).count();
}

Change programme_weights(const HandModel& hand, const Settings& settings) {
  const double priority = settings.palm_priority, imposed = priority * settings.imposed_priority;
  Change w;
  for (int k = 0; k < 3; ++k) {
    w[k] = priority * hand.palm_stiffness;
    w[3 + k] = imposed * hand.palm_rotation_stiffness;
  }
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    w[v] = imposed * hand.finger[f].stiffness[0];
    for (int j = 0; j < kPhalanges; ++j) w[v + 1 + j] = hand.finger[f].stiffness[j];
  }
  return w;
}

double cost(const Change& weight, const Change& d) {
  double sum = 0;
  for (int v = 0; v < kVariables; ++v) sum += weight[v] * d[v] * d[v];
  return 0.5 * sum;
}

// No variable alone may carry a link farther than `motion`.
Change variable_bounds(const HandModel& hand, double motion) {
  Change bound;
  for (int k = 0; k < 3; ++k) {
    bound[k] = motion;
    bound[3 + k] = motion / hand.reach;
  }
  for (int f = 0; f < kFingers; ++f) {
    double lever[kPhalanges], beyond = 0;
    for (int j = kPhalanges; j-- > 0;) {
      const Capsule& c = hand.finger[f].phalanx[j];
      beyond = std::max((c.c1 - hand.finger[f].joint[j]).norm(), (c.c2 - hand.finger[f].joint[j]).norm() + beyond);
      lever[j] = beyond;
    }
    const int v = kPalmVariables + kFingerVariables * f;
    bound[v] = motion / lever[0];
    for (int j = 0; j < kPhalanges; ++j) bound[v + 1 + j] = motion / lever[j];
  }
  return bound;
}

// How far each angle may be from where the step began: its own rate, or the haptic hand's if that is faster. A finger
// that comes free swings back to the haptic one instead of jumping. Abduction first, then flexions, finger by finger.
std::array<double, kVariables - kPalmVariables> angle_rates(const Configuration& haptic, const Configuration& before,
                                                            double least) {
  std::array<double, kVariables - kPalmVariables> rate;
  for (int f = 0; f < kFingers; ++f) {
    rate[kFingerVariables * f] = std::max(least, std::abs(haptic.abduction[f] - before.abduction[f]));
    for (int j = 0; j < kPhalanges; ++j)
      rate[kFingerVariables * f + 1 + j] = std::max(least, std::abs(haptic.flexion[f][j] - before.flexion[f][j]));
  }
  return rate;
}

// One step's attempt to better the pose: everything a round needs, so that the round reads top to bottom.
struct Round {
  const Scene& scene;
  const Configuration& haptic;
  SolverState& state;
  Workspace& work;
  Change weight;
  Configuration begin;  // of the step
  std::array<double, kVariables - kPalmVariables> rate;

  Configuration trial;
  HandPlacement trial_placement;

  // Places the hand at `q`; false if a link left the gathered margin or a gap is negative. `least` is the smallest gap.
  bool verify(const Configuration& q, double& least, double& motion) {
    const auto start = Clock::now();
    trial = q;
    trial_placement = place_hand(scene.hand, q);
    motion = largest_motion(scene.hand, work.candidates.from, trial_placement);
    least = evaluate_gaps(scene.hand, work.candidates, trial_placement, work.trial_gap.data());
    work.operations += work.candidates.count;
    work.verify_us += microseconds_since(start);
    return motion <= work.candidates.margin && least >= 0;
  }

  // What the joint limits and the rates leave of each variable from q; never without zero.
  void joint_room(const Configuration& q, Change& lower, Change& upper) const {
    lower.fill(-std::numeric_limits<double>::infinity());
    upper.fill(std::numeric_limits<double>::infinity());
    for (int f = 0; f < kFingers; ++f) {
      const Finger& finger = scene.hand.finger[f];
      const int v = kPalmVariables + kFingerVariables * f;
      const auto room = [&](int k, double angle, double from, const std::array<double, 2>& limit) {
        const double most = rate[kFingerVariables * f + k];
        lower[v + k] = std::min(0.0, std::max(limit[0], from - most) - angle);
        upper[v + k] = std::max(0.0, std::min(limit[1], from + most) - angle);
      };
      room(0, q.abduction[f], begin.abduction[f], finger.abduction_limit);
      for (int j = 0; j < kPhalanges; ++j) room(1 + j, q.flexion[f][j], begin.flexion[f][j], finger.flexion_limit[j]);
    }
  }

  // The programme at a pose: towards `wish`, no variable carrying a link farther than `motion`.
  QpResult programme(const HandPlacement& at, const Configuration& q, const double* gap, const Change& wish,
                     double motion, bool push_out) {
    const auto start = Clock::now();
    const Settings& s = scene.settings;
    QpResult result;
    if (!linearise(scene.hand, work.candidates, at, gap, motion, s.aim_m, push_out, work.rows,
                   work.row_candidate.data())) {
      result.status = QpStatus::iteration_limit;
      return result;
    }
    QpProblem problem;
    for (int v = 0; v < kVariables; ++v) problem.inverse_weight[v] = 1.0 / weight[v];
    problem.target = wish;
    problem.bound = variable_bounds(scene.hand, motion);
    joint_room(q, problem.lower, problem.upper);
    result = solve_qp(problem, work.rows, 1e-9, s.qp_iterations, work.violation.data());
    work.operations += work.rows.count + result.iterations;
    work.solve_us += microseconds_since(start);
    return result;
  }

  // Moves the trial pose, which sinks in by a second-order error, the least way to where every gap is `aim` again.
  bool restore(double allowed, double& least, double& motion) {
    for (int k = 0; k < scene.settings.corrections && least < 0 && motion <= work.candidates.margin; ++k) {
      const Configuration here = trial;
      const QpResult result = programme(trial_placement, here, work.trial_gap.data(), Change{}, allowed, true);
      if (result.status != QpStatus::solved) return false;
      if (verify(advance(here, result.x, 1.0), least, motion)) return true;
    }
    return false;
  }

  void remember_active(const QpResult& result) {
    work.active_count = 0;
    for (int j = 0; j < result.active; ++j)
      if (result.active_row[j] >= 0)
        work.active[work.active_count++] = {work.row_candidate[result.active_row[j]], result.multiplier[j]};
  }

  void publish() {
    state.graphic = trial;
    state.placement = trial_placement;
    std::swap(work.gap, work.trial_gap);
  }
};

// How a round ended: whether the pose moved, how far, and whether the margin (not the contacts) stopped it.
struct RoundEnd {
  bool moved = false;
  bool cut = false;
  double motion = 0;
};

RoundEnd run_round(Round& r) {
  const Scene& scene = r.scene;
  Workspace& work = r.work;
  const Configuration start = r.state.graphic;
  const HandPlacement start_placement = r.state.placement;
  const Change way = difference(r.haptic, start);
  const double start_cost = cost(r.weight, way);
  RoundEnd end;
  if (start_cost == 0) return end;

  // Room left of the gathered margin; 2 % spare, because a linear share of a turn is not quite a share of its motion.
  const double used = largest_motion(scene.hand, work.candidates.from, start_placement);
  const double room = 0.98 * (work.candidates.margin - used);
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < work.candidates.count; ++i) least = std::min(least, work.gap[i]);

  Change step = way;
  Configuration next = r.haptic;
  double allowed = room, fraction = 1.0;
  if (least <= room) {
    // Linear rows are good to about motion^2 / (2 x 50 mm): near contact a round moves no farther than reach_most.
    allowed = std::min(room, std::max(scene.settings.reach_most_m, least));
    const QpResult result = r.programme(start_placement, start, work.gap.data(), way, allowed, false);
    if (result.status != QpStatus::solved) return end;
    step = result.x;
    next = advance(start, step, 1.0);
    r.remember_active(result);
  } else {
    work.active_count = 0;
    Change lower, upper;
    r.joint_room(start, lower, upper);
    for (int v = 0; v < kVariables; ++v) step[v] = std::clamp(way[v], lower[v], upper[v]);
    // With nothing in the way it is the haptic pose itself, so that a free hand is the haptic hand to the bit.
    if (step != way) next = advance(start, step, 1.0);
  }

  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    double smallest, motion;
    bool good = r.verify(next, smallest, motion);
    double from_start = largest_motion(scene.hand, start_placement, r.trial_placement);
    // Rotations bend the path: a few rounds of scaling bring the motion within what is allowed.
    for (int k = 0; k < 3 && from_start > allowed; ++k) {
      end.cut = true;
      fraction *= 0.99 * allowed / from_start;
      good = r.verify(advance(start, step, fraction), smallest, motion);
      from_start = largest_motion(scene.hand, start_placement, r.trial_placement);
    }
    if (from_start < scene.settings.settled_m) return end;
    if (!good) good = r.restore(allowed, smallest, motion);
    if (good && cost(r.weight, difference(r.haptic, r.trial)) < start_cost) {
      end.motion = largest_motion(scene.hand, start_placement, r.trial_placement);
      end.moved = end.motion >= scene.settings.settled_m;
      if (end.moved) r.publish();
      return end;
    }
    // A quarter of the way has a sixteenth of the error.
    fraction *= 0.25;
    next = advance(start, step, fraction);
  }
  return end;
}

// Gathers candidates around the last pose, with less margin if they do not fit. False if they never do.
bool gather(const Scene& scene, SolverState& state, Workspace& work, double margin) {
  const auto start = Clock::now();
  std::uint32_t visited = 0;
  bool fits = false;
  for (int k = 0; k < 4 && !fits; ++k) {
    fits = gather_candidates(scene.hand, scene.palm, scene.object, state.placement, margin, work.candidates, visited);
    if (!fits) margin *= 0.25;
  }
  work.active_count = 0;  // its numbers are places in the list that was
  if (fits) {
    evaluate_gaps(scene.hand, work.candidates, state.placement, work.gap.data());
  } else {
    work.candidates.count = 0;                   // what was found has no gaps
    state.reach = scene.settings.reach_least_m;  // the next step starts from a smaller margin
  }
  work.operations += visited + work.candidates.count;
  work.search_us += microseconds_since(start);
  return fits;
}

// Did fingers push the palm, or contacts hold back what is imposed (rotation, abduction)?
bool has_yielded(const Round& r) {
  const Change d = difference(r.haptic, r.state.graphic);
  constexpr double kAngle = 1e-3;  // rad; a twentieth of a degree is not seen
  for (int k = 3; k < kPalmVariables; ++k)
    if (std::abs(d[k]) > kAngle) return true;
  for (int f = 0; f < kFingers; ++f)
    if (std::abs(d[kPalmVariables + kFingerVariables * f]) > kAngle) return true;
  Vec3 push(0, 0, 0);
  for (int j = 0; j < r.work.active_count; ++j) {
    const int candidate = r.work.active[j].candidate;
    if (candidate < r.work.candidates.link_start[1]) continue;
    const int link =
        int(std::upper_bound(r.work.candidates.link_start.begin(), r.work.candidates.link_start.end(), candidate) -
            r.work.candidates.link_start.begin()) -
        1;
    const Candidates::Pair& p = r.work.candidates.pairs[candidate];
    push += r.work.active[j].multiplier *
            capsule_sphere_gap(r.state.placement.phalanx[link - 1], p.center, p.radius).normal;
  }
  return push.norm() > 1e-4 * r.weight[0];  // 0.1 mm of the palm
}

}  // namespace

std::uint32_t solve_progressive(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  const Settings& s = scene.settings;
  Round round{scene,
              haptic,
              state,
              work,
              programme_weights(scene.hand, s),
              state.graphic,
              angle_rates(haptic, state.haptic, s.joint_step_rad),
              {},
              {}};
  state.haptic = haptic;
  work.active_count = 0;

  const double wanted = largest_motion(scene.hand, state.placement, place_hand(scene.hand, haptic));
  if (wanted == 0) {
    // Already there; gather what touches, for the contact list.
    return gather(scene, state, work, s.reach_least_m) ? kOk : kKeptPrevious;
  }
  if (!gather(scene, state, work, std::min(1.05 * wanted + 1e-6, state.reach))) return kKeptPrevious;
  bool moved_ever = false, converged = false;
  double moved_most = 0;
  for (int k = 0; k < s.iterations && !converged; ++k) {
    const RoundEnd end = run_round(round);
    moved_ever |= end.moved;
    moved_most = std::max(moved_most, end.motion);
    converged = !end.cut && end.motion < 5e-6;  // metres; what is left moves less than a tenth of this
    if (converged || k + 1 == s.iterations) break;
    // Look farther when the margin stopped the hand, farther still where nothing is near.
    const double used = largest_motion(scene.hand, work.candidates.from, state.placement);
    const bool near_end = work.candidates.margin - used < 2 * end.motion;
    if (end.cut || near_end) {
      const double most = work.candidates.count > 0 ? s.reach_most_m : s.free_reach_m;
      if (end.cut) state.reach = std::min(4 * state.reach, most);
      const double left = largest_motion(scene.hand, state.placement, place_hand(scene.hand, haptic));
      converged = left == 0;
      if (converged) break;
      if (!gather(scene, state, work, std::min(1.05 * left + 1e-6, state.reach))) return kKeptPrevious;
    }
  }
  // Next step: as far as this one moved and half as much again, within limits.
  const double most = work.candidates.count > 0 ? s.reach_most_m : s.free_reach_m;
  state.reach = std::clamp(2.5 * moved_most, s.reach_least_m, most);

  std::uint32_t status = kOk;
  if (!converged) status |= kIterationLimit;
  if (has_yielded(round)) status |= kYielded;
  return status;
}

}  // namespace palmar
