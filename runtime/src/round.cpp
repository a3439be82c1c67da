#include "round.h"

#include <algorithm>
#include <limits>

namespace palmar {

namespace {

constexpr int kRowRounds = 8;           // programmes in a round, each with the rows that the last one lacked,
constexpr int kRowsNear = 32;           // rows that a link gets unasked, and as many more as lie within twice aim_m,
constexpr int kRowsMore = 4;            // and at most so many more each time
constexpr double kRowNear = kLook;      // metres: a pair this near gets a row before it is asked for
constexpr double kBend = 0.015;         // metres: with curvature, a move by m leaves about m^2 / kBend to go,
constexpr double kWithout = 0.1;        // without it about this share of m
constexpr double kRowTolerance = 1e-9;  // metres, to which a programme meets its rows
constexpr double kLeastAim = 10 * kRowTolerance;
constexpr int kAttempts = 3;                         // trial poses along one direction: all of it and two shorter
constexpr std::uint32_t kVerifyOperations = 75;      // but for the gaps
constexpr std::uint32_t kProgrammeOperations = 225;  // but for
constexpr std::uint32_t kRowOperations = 4;          // each row, and
constexpr std::uint32_t kIterationOperations = 36;   // each iteration but for its rows
constexpr std::uint32_t kStartOperations = 12;       // each row that it begins with

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

}  // namespace

// Places the hand at `q` and looks how it stands there. True if every gap is known and none is negative.
bool Round::verify(const Configuration& q) {
  const auto start = Clock::now();
  if (work.left() < kVerifyOperations + kLinks + std::uint32_t(work.candidates.total() / 8)) {
    trial_known = false;
    return false;
  }
  work.operations += kVerifyOperations;
  trial = q;
  trial_placement = place_hand(scene.hand, q);
  trial_known = true;
  for (int link = 0; link < kLinks; ++link)
    trial_known &= room_of(scene.hand, work.candidates, trial_placement, link) >= 0;
  trial_least = std::numeric_limits<double>::infinity();
  for (int link = 0; link < kLinks; ++link)
    trial_least = std::min(trial_least, evaluate_gaps(scene.hand, work.candidates, trial_placement, link,
                                                      work.trial_gap.data(), kLook, work.operations));
  work.verify_us += microseconds_since(start);
  return trial_known && trial_least >= 0;
}

// The most that any link moved between two placements, as a share of what it is allowed.
double Round::excess(const HandPlacement& from, const HandPlacement& to, const PerLink& allowed) const {
  double most = 0;
  for (int link = 0; link < kLinks; ++link)
    most = std::max(most, link_motion(scene.hand, from, to, link) / allowed[link]);
  return most;
}

// What the joint limits and the rates leave of each variable from q; never without zero.
void Round::joint_room(const Configuration& q, Change& lower, Change& upper) const {
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

// Up to which gap the pairs of a link get a row unasked: kRowNear, or less where that would be many.
double Round::near_limit(int link, const double* gap) const {
  double limit = kRowNear;
  const auto near = [&] {
    return std::count_if(gap + work.candidates.begin(link), gap + work.candidates.end(link),
                         [&](double g) { return g <= limit; });
  };
  while (limit > 2 * scene.settings.aim_m && near() > kRowsNear) limit *= 0.5;
  return limit;
}

// Rows, joint limits and step bounds that held the last programme's answer and are in this one as well.
QpStart Round::held_by(const Change& lower) const {
  QpStart start;
  for (int k = 0; k < state.pressing_count; ++k) {
    const Pressing& p = state.pressing[k];
    const int group = p.link == 0 ? 0 : 1 + (p.link - 1) / kPhalanges;
    for (int row = work.rows.group_start[group]; row < work.rows.group_start[group + 1]; ++row) {
      const int pair = work.row_candidate[row];
      if (work.candidates.object_sphere[pair] != p.object_sphere || work.candidates.link_of(pair) != p.link ||
          work.candidates.palm_sphere[pair] != p.palm_sphere)
        continue;
      start.row[start.count++] = row;
      break;
    }
  }
  for (int v = 0; v < kVariables && start.count < kVariables; ++v) {
    const int low = int(at_step_bound >> (2 * v) & 1), high = int(at_step_bound >> (2 * v + 1) & 1);
    if (state.at_limit >> v & 1)
      start.row[start.count++] = -1 - (2 * v + (lower[v] == 0 ? 0 : 1));
    else if (low || high)
      start.row[start.count++] = -1 - (2 * v + high);
  }
  return start;
}

// The programme at a pose: towards `wish`, no variable carrying a link farther than it is allowed, with a row for
// each pair within `near` of its link or named in work.wanted.
QpResult Round::programme(const HandPlacement& at, const Configuration& q, const double* gap, const Metric& metric,
                          const Change& wish, const PerLink& allowed, const PerLink& near, double aim, bool push_out) {
  if (work.left() < kProgrammeOperations + kRowOperations * std::uint32_t(work.rows.capacity)) {
    QpResult none;
    none.status = QpStatus::iteration_limit;
    return none;
  }
  const auto start = Clock::now();
  // Rows that do not fit are left out: whether they were needed is seen at the trial pose. Those of a round's start
  // stay as they are until more are wanted.
  if (push_out || rows_wanted != work.wanted_count) {
    linearise(work.candidates, at, gap, near, work.wanted.data(), aim, push_out, work.rows, work.row_candidate.data());
    work.operations += kRowOperations * std::uint32_t(work.rows.count);
    rows_wanted = push_out ? -1 : work.wanted_count;
  }
  QpProblem problem;
  problem.metric = metric;
  problem.target = wish;
  problem.bound = step_bound = variable_bounds(scene.hand, allowed);
  joint_room(q, problem.lower, problem.upper);
  // A correction goes somewhere else, and what presses says nothing of it.
  const QpStart held = push_out ? QpStart{} : held_by(problem.lower);
  work.operations += kProgrammeOperations + kStartOperations * std::uint32_t(held.count);
  const std::uint32_t each = kIterationOperations + std::uint32_t(work.rows.count) / 8;
  const auto solve_from = [&](const QpStart& from) {
    const int most = std::min(scene.settings.qp_iterations, int(work.left() / each));
    const QpResult found = solve_qp(problem, work.rows, kRowTolerance, most, work.violation.data(), from);
    work.operations += each * std::uint32_t(std::min(found.iterations, most));
    return found;
  };
  QpResult result = solve_from(held);
  // Standing still is an answer; rows that nearly depend on one another may hide that, in this order or in another.
  if (result.status == QpStatus::infeasible && held.count > 0) result = solve_from({});
  work.solve_us += microseconds_since(start);
  return result;
}

// Names, of the pairs of each link that the trial pose sinks into and that had no row, being beyond `near` where the
// programme was made, the kRowsMore deepest: their rows keep most of the others out. True if there are any.
bool Round::want_more_rows(const PerLink& near) {
  const int before = work.wanted_count;
  for (int link = 0; link < kLinks; ++link) {
    std::array<int, kRowsMore> deepest;
    int count = 0;
    for (int i = work.candidates.begin(link); i < work.candidates.end(link); ++i) {
      if (work.trial_gap[i] >= 0 || work.gap[i] <= near[link] || work.wanted[i]) continue;
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

void Round::want_none() {
  while (work.wanted_count > 0) work.wanted[work.wanted_pair[--work.wanted_count]] = 0;
}

// Moves the trial pose, which sinks in by a second-order error, the least way to where every gap is again what a row
// asks for, or four times as far outside as the worst was inside if that is less: the whole would cost more than a
// small move gains.
bool Round::restore(const PerLink& allowed) {
  for (int k = 0; k < scene.settings.corrections && trial_least < 0 && trial_known; ++k) {
    const Configuration here = trial;
    const double aim = std::min(scene.settings.aim_m, std::max(kLeastAim, -4 * trial_least));
    PerLink near;
    for (int link = 0; link < kLinks; ++link) near[link] = near_limit(link, work.trial_gap.data());
    const QpResult result =
        programme(trial_placement, here, work.trial_gap.data(), springs, Change{}, allowed, near, aim, true);
    if (result.status != QpStatus::solved) return false;
    if (verify(moved(here, result.x, 1.0))) return true;
  }
  return false;
}

// q moved by a share of a change, joints not past their limits by rounding.
Configuration Round::moved(const Configuration& q, const Change& change, double share) const {
  Configuration to = advance(q, change, share);
  for (int f = 0; f < kFingers; ++f) {
    const Finger& finger = scene.hand.finger[f];
    to.abduction[f] = std::clamp(to.abduction[f], finger.abduction_limit[0], finger.abduction_limit[1]);
    for (int j = 0; j < kPhalanges; ++j)
      to.flexion[f][j] = std::clamp(to.flexion[f][j], finger.flexion_limit[j][0], finger.flexion_limit[j][1]);
  }
  return to;
}

Round::Contacts Round::remember_active(const QpResult& result) {
  const auto before = state.pressing;
  const int count_before = state.pressing_count;
  const std::uint32_t at_limit_before = state.at_limit;
  bool whole = true;
  at_step_bound = 0;
  work.active_count = 0;
  state.pressing_count = 0;
  state.at_limit = 0;
  for (int j = 0; j < result.active; ++j) {
    const int row = result.active_row[j];
    if (row < 0) {
      const int variable = (-1 - row) / 2;
      if (std::abs(result.x[variable]) < 1e-12)
        state.at_limit |= 1u << variable;
      else {
        at_step_bound |= 1ull << (-1 - row);
        whole &= std::abs(result.x[variable]) < 0.999 * step_bound[variable];  // or it is its rate that ends it
      }
      continue;
    }
    const int pair = work.row_candidate[row];
    work.active[work.active_count++] = {pair, result.multiplier[j]};
    state.pressing[state.pressing_count++] = {work.candidates.link_of(pair), work.candidates.object_sphere[pair],
                                              work.candidates.palm_sphere[pair], result.multiplier[j]};
  }
  const auto among = [](const Pressing& p, const auto& list, int count) {
    return std::any_of(list.begin(), list.begin() + count, [&](const Pressing& q) {
      return p.link == q.link && p.object_sphere == q.object_sphere && p.palm_sphere == q.palm_sphere;
    });
  };
  const auto all_among = [&](const auto& these, int count, const auto& list, int list_count) {
    return std::all_of(these.begin(), these.begin() + count,
                       [&](const Pressing& p) { return among(p, list, list_count); });
  };
  return {
      all_among(state.pressing, state.pressing_count, before, count_before),
      all_among(before, count_before, state.pressing, state.pressing_count) && (at_limit_before & ~state.at_limit) == 0,
      whole};
}

void Round::publish() {
  state.graphic = trial;
  state.placement = trial_placement;
  std::swap(work.gap, work.trial_gap);
}

RoundEnd Round::run() {
  const Configuration start = state.graphic;
  const HandPlacement start_placement = state.placement;
  const Change way = difference(haptic, start);
  const double start_cost = cost(weight, way);
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
    near[link] = std::min(allowed[link], near_limit(link, work.gap.data()));
  }

  const auto verify_within = [&](const Configuration& next, const Change& step, double& fraction) {
    bool good = verify(next);
    double over = excess(start_placement, trial_placement, allowed);
    // Rotations bend the path: a few rounds of scaling bring the motion within what is allowed.
    // A bound that holds to rounding is held: a thousandth of the spare is enough for that.
    for (int k = 0; k < 3 && over > 1.001; ++k) {
      for (int link = 0; link < kLinks; ++link)
        end.cut[link] |= link_motion(scene.hand, start_placement, trial_placement, link) > allowed[link];
      end.any_cut = true;
      fraction *= 0.99 / over;
      good = verify(moved(start, step, fraction));
      over = excess(start_placement, trial_placement, allowed);
    }
    return good;
  };

  // Along a programme's answer, or a quarter or a sixteenth of it, to a verified pose that costs less.
  const auto advance_along = [&](const Change& step, double fraction, bool good, bool whole, bool with_curvature) {
    for (int attempt = 0; attempt < kAttempts; ++attempt) {
      const double from_start = largest_motion(scene.hand, start_placement, trial_placement);
      if (touching && from_start < scene.settings.settled_m) {
        end.failed = false;
        return true;
      }
      if (!good) good = restore(allowed);
      if (good && cost(weight, difference(haptic, trial)) < start_cost) {
        end.motion = largest_motion(scene.hand, start_placement, trial_placement);
        end.left = end.motion * (!whole || fraction < 1 ? 1 : with_curvature ? end.motion / kBend : kWithout);
        end.moved = end.motion > (touching ? scene.settings.settled_m : 0.0);
        end.failed = false;
        if (end.moved) publish();
        for (int k = 0; k < work.active_count; ++k) end.slack = std::max(end.slack, work.gap[work.active[k].candidate]);
        return true;
      }
      end.failed = !good;
      if (attempt + 1 == kAttempts) break;
      // A quarter of the way has a sixteenth of the error. What costs more than where it began is past the parabola's
      // least through both.
      double share = 0.25;
      if (good) {
        double slope = 0;
        for (int v = 0; v < kVariables; ++v) slope -= fraction * weight[v] * way[v] * step[v];
        share = std::clamp(-0.5 * slope / (cost(weight, difference(haptic, trial)) - start_cost - slope), 0.0625, 0.5);
      }
      fraction *= share;
      good = verify_within(moved(start, step, fraction), step, fraction);
    }
    return false;
  };

  want_none();
  at_step_bound = 0;
  rows_wanted = -1;
  work.bent_count = 0;
  if (!touching) {
    work.active_count = state.pressing_count = 0;
    state.at_limit = 0;
    Change lower, upper, step;
    joint_room(start, lower, upper);
    for (int v = 0; v < kVariables; ++v) step[v] = std::clamp(way[v], lower[v], upper[v]);
    // With nothing in the way it is the haptic pose itself, so that a free hand is the haptic hand to the bit.
    double fraction = 1.0;
    const bool good = verify_within(step == way ? haptic : advance(start, step, 1.0), step, fraction);
    advance_along(step, fraction, good, true, false);
    return end;
  }

  Metric bent;
  Change bent_wish;
  for (bool bends : {bend(way, bent, bent_wish), false}) {
    Change step;
    double fraction = 1.0;
    bool good = false, solved = false;
    Contacts contacts{};
    for (int k = 0; k < kRowRounds; ++k) {
      const QpResult result = programme(start_placement, start, work.gap.data(), bends ? bent : springs,
                                        bends ? bent_wish : way, allowed, near, scene.settings.aim_m, false);
      if (result.status != QpStatus::solved) break;  // some way along the last answer may do, if there is one
      solved = true;
      step = result.x;
      fraction = 1.0;
      contacts = remember_active(result);
      // A contact that presses no more is held by nothing but what was added across it: again, without that.
      if (bends && !contacts.kept && k + 1 < kRowRounds) {
        bends = bend(way, bent, bent_wish);
        continue;
      }
      good = verify_within(moved(start, step, 1.0), step, fraction);
      if (good || !want_more_rows(near)) break;
    }
    end.failed = !solved;
    if (solved && advance_along(step, fraction, good, contacts.whole, bends && contacts.known)) break;
    if (!bends) break;
  }
  return end;
}

}  // namespace palmar
