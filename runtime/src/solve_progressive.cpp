// The product's solver: feasible sequential quadratic programming.
//
// Every step starts from the last published pose, which touches nothing (all gaps >= 0), and looks for one that costs
// less. One programme holds the palm (translation, rotation) and the fingers (abduction, three flexions), weighed by
// their springs, so that the force is the gradient of one energy. With `palm_priority` large the paper's order, palm
// before fingers (Eqs. 8, 9), comes back as a limit of weights; with `imposed_priority`, what the paper copies from the
// haptic hand, rotation and abduction, gives way last. Standing still satisfies every row, so the programme always has
// an answer, blocked fingers included: no mode to switch.
//
// A pose is published only if (1) no link moved farther than the margin of its list, so no
// sphere outside the list can have been touched or skipped; (2) every candidate's exact gap there is >= 0; (3) it costs
// less than the pose before. By (3) a constant input has no limit cycle.
#include <algorithm>
#include <chrono>
#include <limits>

#include "solver.h"

namespace palmar {

namespace {

using Clock = std::chrono::steady_clock;

constexpr int kRowRounds = 8;        // programmes in a round, each with the rows that the last one lacked,
constexpr int kRowsMore = 4;         // at most so many for each link
constexpr double kAhead = 2.0;       // a list looks farther than the step needs: by this share of it,
constexpr double kAheadMost = 1e-3;  // and at most by this, metres
constexpr double kDense = 400;       // pairs of one link
constexpr int kAttempts = 3;         // trial poses along one direction: all of it, a quarter, a sixteenth

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

bool same(const Configuration& a, const Configuration& b) {
  return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() && a.abduction == b.abduction &&
         a.flexion == b.flexion;
}

double cost(const Change& weight, const Change& d) {
  double sum = 0;
  for (int v = 0; v < kVariables; ++v) sum += weight[v] * d[v] * d[v];
  return 0.5 * sum;
}

// No variable alone may carry link l farther than motion[l].
Change variable_bounds(const HandModel& hand, const PerLink& motion) {
  Change bound;
  const double least = *std::min_element(motion.begin(), motion.end());
  for (int k = 0; k < 3; ++k) {
    bound[k] = least;
    bound[3 + k] = least / hand.reach;
  }
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    for (int j = 0; j < kPhalanges; ++j) {
      bound[v + 1 + j] = std::numeric_limits<double>::infinity();
      for (int k = j; k < kPhalanges; ++k)
        bound[v + 1 + j] = std::min(bound[v + 1 + j], motion[1 + kPhalanges * f + k] / hand.finger[f].lever[j][k]);
    }
    bound[v] = bound[v + 1];
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

constexpr double kRowNear = 3e-5;  // metres: a pair this near gets a row before it is asked for

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
  double trial_least = 0;    // its smallest gap
  bool trial_known = false;  // no link has left what its list covers

  // Places the hand at `q` and looks how it stands there. True if every gap is known and none is negative.
  bool verify(const Configuration& q) {
    const auto start = Clock::now();
    trial = q;
    trial_placement = place_hand(scene.hand, q);
    trial_known = true;
    for (int link = 0; link < kLinks; ++link)
      trial_known &= room_of(scene.hand, work.candidates, trial_placement, link) >= 0;
    trial_least = evaluate_gaps(scene.hand, work.candidates, trial_placement, work.trial_gap.data());
    work.operations += work.candidates.total();
    work.verify_us += microseconds_since(start);
    return trial_known && trial_least >= 0;
  }

  // The most that any link moved between two placements, as a share of what it is allowed.
  double excess(const HandPlacement& from, const HandPlacement& to, const PerLink& allowed) const {
    double most = 0;
    for (int link = 0; link < kLinks; ++link)
      most = std::max(most, link_motion(scene.hand, from, to, link) / allowed[link]);
    return most;
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

  // The programme at a pose: towards `wish`, no variable carrying a link farther than it is allowed, with a row for
  // each pair within `near` of its link or named in work.wanted.
  QpResult programme(const HandPlacement& at, const Configuration& q, const double* gap, const Change& wish,
                     const PerLink& allowed, const PerLink& near, bool push_out) {
    const auto start = Clock::now();
    const Settings& s = scene.settings;
    // Rows that do not fit are left out: whether they were needed is seen at the trial pose.
    linearise(scene.hand, work.candidates, at, gap, near, work.wanted.data(), s.aim_m, push_out, work.rows,
              work.row_candidate.data());
    QpProblem problem;
    for (int v = 0; v < kVariables; ++v) problem.inverse_weight[v] = 1.0 / weight[v];
    problem.target = wish;
    problem.bound = variable_bounds(scene.hand, allowed);
    joint_room(q, problem.lower, problem.upper);
    const QpResult result = solve_qp(problem, work.rows, 1e-9, s.qp_iterations, work.violation.data());
    work.operations += work.rows.count + result.iterations;
    work.solve_us += microseconds_since(start);
    return result;
  }

  // Names, of the pairs of each link that the trial pose sinks into and that had no row, the kRowsMore deepest: their
  // rows keep most of the others out. True if there are any.
  bool want_more_rows() {
    const int before = work.wanted_count;
    for (int link = 0; link < kLinks; ++link) {
      std::array<int, kRowsMore> deepest;
      int count = 0;
      for (int i = work.candidates.begin(link); i < work.candidates.end(link); ++i) {
        if (work.trial_gap[i] >= 0 || work.wanted[i]) continue;
        // Of two that are as deep to a nanometre the first in the list, so that rounding does not choose.
        const auto deeper = [&](int than) { return work.trial_gap[i] < work.trial_gap[than] - 1e-9; };
        if (count == kRowsMore && !deeper(deepest[count - 1])) continue;
        int k = count < kRowsMore ? count++ : count - 1;
        for (; k > 0 && deeper(deepest[k - 1]); --k) deepest[k] = deepest[k - 1];
        deepest[k] = i;
      }
      for (int k = 0; k < count; ++k) {
        work.wanted[deepest[k]] = 1;
        work.wanted_pair[work.wanted_count++] = deepest[k];
      }
    }
    return work.wanted_count > before;
  }

  void want_none() {
    while (work.wanted_count > 0) work.wanted[work.wanted_pair[--work.wanted_count]] = 0;
  }

  // Moves the trial pose, which sinks in by a second-order error, the least way to where every gap is `aim` again.
  bool restore(const PerLink& allowed) {
    PerLink near;
    near.fill(kRowNear);
    for (int k = 0; k < scene.settings.corrections && trial_least < 0 && trial_known; ++k) {
      const Configuration here = trial;
      want_more_rows();
      const QpResult result = programme(trial_placement, here, work.trial_gap.data(), Change{}, allowed, near, true);
      if (result.status != QpStatus::solved) return false;
      if (verify(moved(here, result.x, 1.0))) return true;
    }
    return false;
  }

  // q moved by a share of a change, joints not past their limits by rounding.
  Configuration moved(const Configuration& q, const Change& change, double share) const {
    Configuration to = advance(q, change, share);
    for (int f = 0; f < kFingers; ++f) {
      const Finger& finger = scene.hand.finger[f];
      to.abduction[f] = std::clamp(to.abduction[f], finger.abduction_limit[0], finger.abduction_limit[1]);
      for (int j = 0; j < kPhalanges; ++j)
        to.flexion[f][j] = std::clamp(to.flexion[f][j], finger.flexion_limit[j][0], finger.flexion_limit[j][1]);
    }
    return to;
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

// How a round ended: whether the pose moved, how far, and which links their lists (not the contacts) stopped.
struct RoundEnd {
  bool moved = false;
  double motion = 0;
  std::array<bool, kLinks> cut{};
  bool any_cut = false;
  bool failed = false;  // there was somewhere to go, and no pose on the way could be verified
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

  // What each list leaves its link; 2 % spare, because a linear share of a turn is not quite a share of its motion.
  // Linear rows are good to about motion^2 / (2 x 50 mm): near contact a round moves a link no farther than reach_most.
  PerLink allowed, near;
  bool touching = false;
  for (int link = 0; link < kLinks; ++link) {
    const int first = work.candidates.begin(link);
    const double room = 0.98 * room_of(scene.hand, work.candidates, start_placement, link);
    const double least = smallest(work.gap.data() + first, work.candidates.count[link]);
    if (!(room > 0)) {
      end.failed = true;
      return end;
    }
    touching |= least <= room;
    allowed[link] = std::min(room, std::max(scene.settings.reach_most_m, least));
    near[link] = std::min(allowed[link], kRowNear);
  }

  const auto verify_within = [&](const Configuration& next, const Change& step, double& fraction) {
    bool good = r.verify(next);
    double over = r.excess(start_placement, r.trial_placement, allowed);
    // Rotations bend the path: a few rounds of scaling bring the motion within what is allowed.
    // A bound that holds to rounding is held: a thousandth of the spare is enough for that.
    for (int k = 0; k < 3 && over > 1.001; ++k) {
      for (int link = 0; link < kLinks; ++link)
        end.cut[link] |= link_motion(scene.hand, start_placement, r.trial_placement, link) > allowed[link];
      end.any_cut = true;
      fraction *= 0.99 / over;
      good = r.verify(r.moved(start, step, fraction));
      over = r.excess(start_placement, r.trial_placement, allowed);
    }
    return good;
  };

  Change step = way;
  double fraction = 1.0;
  bool good = false;
  r.want_none();
  if (touching) {
    for (int k = 0; k < kRowRounds; ++k) {
      const QpResult result = r.programme(start_placement, start, work.gap.data(), way, allowed, near, false);
      if (result.status != QpStatus::solved) {
        end.failed = true;
        return end;
      }
      step = result.x;
      fraction = 1.0;
      r.remember_active(result);
      good = verify_within(r.moved(start, step, 1.0), step, fraction);
      if (good || !r.want_more_rows()) break;
    }
  } else {
    work.active_count = 0;
    Change lower, upper;
    r.joint_room(start, lower, upper);
    for (int v = 0; v < kVariables; ++v) step[v] = std::clamp(way[v], lower[v], upper[v]);
    // With nothing in the way it is the haptic pose itself, so that a free hand is the haptic hand to the bit.
    good = verify_within(step == way ? r.haptic : advance(start, step, 1.0), step, fraction);
  }

  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const auto from_start = [&] { return largest_motion(scene.hand, start_placement, r.trial_placement); };
    if (touching && from_start() < scene.settings.settled_m) {
      end.failed = false;
      return end;
    }
    if (!good) good = r.restore(allowed);
    if (good && cost(r.weight, difference(r.haptic, r.trial)) < start_cost) {
      end.motion = from_start();
      end.moved = end.motion > (touching ? scene.settings.settled_m : 0.0);
      end.failed = false;
      if (end.moved) r.publish();
      return end;
    }
    end.failed = !good;
    if (attempt + 1 == kAttempts) break;
    // A quarter of the way has a sixteenth of the error.
    fraction *= 0.25;
    good = verify_within(r.moved(start, step, fraction), step, fraction);
  }
  return end;
}

// Makes anew the lists that do not reach as far around their links as the step may want: `reach` around the pose, or to
// the haptic pose if that is nearer. A list looks farther than that, to serve some steps. False if a link has none.
bool gather(const Scene& scene, const HandPlacement& haptic, SolverState& state, Workspace& work) {
  const auto start = Clock::now();
  std::uint32_t visited = 0;
  bool complete = true;
  for (int link = 0; link < kLinks; ++link) {
    const double wanted = link_motion(scene.hand, state.placement, haptic, link);
    const double reach = std::min(1.05 * wanted + 1e-6, state.reach[link]);
    if (room_of(scene.hand, work.candidates, state.placement, link) >= reach) continue;
    double margin = reach + std::min(kAhead * reach, kAheadMost);
    // Where spheres lie dense it looks less far, by what the last list was like: cost follows the length of the lists.
    const int had = work.candidates.count[link];
    if (had > 0 && work.candidates.margin[link] > 0)
      margin = std::min(margin, std::max(scene.settings.reach_least_m, work.candidates.margin[link] * kDense / had));
    gather_link(scene.hand, scene.palm, scene.object, state.placement, link, margin, work.candidates, visited);
    evaluate_gaps(scene.hand, work.candidates, state.placement, link, work.gap.data());
    visited += std::uint32_t(work.candidates.count[link]);
    work.active_count = 0;  // its numbers are places in the lists that were
    complete &= work.candidates.margin[link] > 0;
    if (work.candidates.margin[link] < reach)
      state.reach[link] = std::max(work.candidates.margin[link], scene.settings.reach_least_m);
  }
  work.operations += visited;
  work.search_us += microseconds_since(start);
  return complete;
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
    const int pair = r.work.active[j].candidate;
    const int link = r.work.candidates.link_of(pair);
    if (link == 0) continue;
    push +=
        r.work.active[j].multiplier * capsule_sphere_gap(r.state.placement.phalanx[link - 1],
                                                         r.work.candidates.center(pair), r.work.candidates.radius[pair])
                                          .normal;
  }
  return push.norm() > 1e-4 * r.weight[0];  // 0.1 mm of the palm
}

}  // namespace

std::uint32_t solve_progressive(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  const Settings& s = scene.settings;
  if (state.resting && same(haptic, state.haptic)) return state.status;
  Round round{scene,
              haptic,
              state,
              work,
              programme_weights(scene.hand, s),
              state.graphic,
              angle_rates(haptic, state.haptic, s.joint_step_rad),
              {},
              {}};
  const bool held = same(haptic, state.haptic);
  state.haptic = haptic;
  state.resting = false;
  const HandPlacement haptic_placement = place_hand(scene.hand, haptic);
  const PerLink reach_before = state.reach;
  for (double& reach : state.reach) reach = std::max(reach, s.reach_least_m);

  if (!gather(scene, haptic_placement, state, work)) return kKeptPrevious;
  bool moved_ever = false, converged = false, failed = false;
  PerLink moved_most{};
  for (int k = 0; k < s.iterations && !converged; ++k) {
    const HandPlacement before = state.placement;
    const RoundEnd end = run_round(round);
    moved_ever |= end.moved;
    if (end.moved)
      for (int link = 0; link < kLinks; ++link)
        moved_most[link] = std::max(moved_most[link], link_motion(scene.hand, before, state.placement, link));
    failed |= end.failed;
    converged =
        !end.any_cut && !end.failed && end.motion < 5e-6;  // metres; what is left moves less than a tenth of this
    if (converged || end.failed || k + 1 == s.iterations) break;
    // Look farther where a list stopped its link, farther still where nothing is near.
    for (int link = 0; link < kLinks; ++link) {
      const double most = work.candidates.count[link] > 0 ? s.reach_most_m : s.free_reach_m;
      if (end.cut[link]) state.reach[link] = std::min(4 * state.reach[link], most);
    }
    converged = largest_motion(scene.hand, state.placement, haptic_placement) == 0;
    if (converged) break;
    if (!gather(scene, haptic_placement, state, work)) return kKeptPrevious;
  }
  // Next step: as far as this one moved and half as much again, within limits.
  for (int link = 0; link < kLinks; ++link) {
    const double most = work.candidates.count[link] > 0 ? s.reach_most_m : s.free_reach_m;
    state.reach[link] = std::clamp(2.5 * moved_most[link], s.reach_least_m, most);
  }
  state.motion = moved_most;

  state.status = kOk;
  if (!converged) state.status |= kIterationLimit;
  if (failed && !moved_ever) state.status |= kKeptPrevious;
  if (has_yielded(round)) state.status |= kYielded;
  state.resting = held && !moved_ever && state.reach == reach_before;
  return state.status;
}

}  // namespace palmar
