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

#include "round.h"

namespace palmar {

namespace {

constexpr double kAhead = 2.0;               // a list looks farther than the step needs: by this share of it,
constexpr double kAheadMost = 1e-3;          // and at most by this, metres
constexpr double kLeft = 1e-6;               // metres; a step is done where no more than this is left to go
constexpr double kSlack = 1e-6;              // metres that a pressing pair may stand off: force times them is energy
constexpr int kPalmShares = 3;               // of a search's operations that are kept for the palm's, besides its own
constexpr std::uint32_t kLeastRound = 7000;  // operations without which a further round does not begin
constexpr int kEnough = 200;                 // pairs of one link beyond reach_least_m

bool same(const Configuration& a, const Configuration& b) {
  return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() && a.abduction == b.abduction &&
         a.flexion == b.flexion;
}

// The springs' stiffness, weighed by the settings' priorities.
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

Metric metric_of(const Change& weight) {
  Metric metric;
  for (int v = 0; v < kVariables; ++v) metric.set_diagonal(v, 1.0 / weight[v]);
  return metric;
}

AngleRates angle_rates(const Configuration& haptic, const Configuration& before, double least) {
  AngleRates rate;
  for (int f = 0; f < kFingers; ++f) {
    rate[kFingerVariables * f] = std::max(least, std::abs(haptic.abduction[f] - before.abduction[f]));
    for (int j = 0; j < kPhalanges; ++j)
      rate[kFingerVariables * f + 1 + j] = std::max(least, std::abs(haptic.flexion[f][j] - before.flexion[f][j]));
  }
  return rate;
}

// Makes anew the lists that do not reach as far around their links as the step may want: `reach` around the pose, or to
// the haptic pose if that is nearer. A list looks farther than that, to serve some steps. At most three quarters of the
// operations that are left go into it, shared by the links; a list that they do not suffice for reaches less far. False
// if a link has none.
bool gather(const Scene& scene, const HandPlacement& haptic, SolverState& state, Workspace& work) {
  const auto start = Clock::now();
  const Settings& s = scene.settings;
  PerLink reach{};
  int links = 0;
  for (int link = 0; link < kLinks; ++link) {
    const double wanted = link_motion(scene.hand, state.placement, haptic, link);
    reach[link] = std::min(1.05 * wanted + 1e-6, state.reach[link]);
    if (room_of(scene.hand, work.candidates, state.placement, link) >= reach[link]) reach[link] = 0;
    links += reach[link] > 0;
  }
  std::uint32_t left = work.left() / 4 * 3;
  const auto renew = [&](int link, std::uint32_t operations_most) {
    double margin = reach[link] + std::min(kAhead * reach[link], kAheadMost);
    // Where spheres lie dense it looks less far, by what the last list was like: cost follows the length of the lists.
    const int had = work.candidates.count[link];
    if (had > 0 && work.candidates.margin[link] > 0)
      margin = std::min(margin, std::max(s.reach_least_m, work.candidates.margin[link] * kEnough / had));
    const std::uint32_t before = work.operations;
    gather_link(scene.hand, scene.palm, scene.object, state.placement, link, margin, work.candidates, work.operations,
                {s.reach_least_m, kEnough, operations_most});
    evaluate_gaps(scene.hand, work.candidates, state.placement, link, work.gap.data(), kLook, work.operations);
    left -= std::min(left, work.operations - before);
    work.active_count = 0;  // its numbers are places in the lists that were
    if (work.candidates.margin[link] < reach[link])
      state.reach[link] = std::max(work.candidates.margin[link], s.reach_least_m);
    return room_of(scene.hand, work.candidates, state.placement, link) > 0;
  };
  bool complete = true;
  // What the last step's operations did not suffice for goes on first, and alone until it is done.
  const int unfinished = work.candidates.unfinished.link;
  if (unfinished >= 0 && reach[unfinished] > 0) {
    complete = renew(unfinished, left);
    reach[unfinished] = 0;
    --links;
  }
  // The palm, whose search is the dearest, last: it may have what the others left.
  for (int link = kLinks; link-- > 0 && complete;) {
    if (reach[link] == 0) continue;
    complete = renew(link, left / std::uint32_t(links-- + (link > 0 ? kPalmShares : 0)));
  }
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
  const Change weight = programme_weights(scene.hand, s);
  Round round{scene,         haptic,
              state,         work,
              weight,        metric_of(weight),
              state.graphic, angle_rates(haptic, state.haptic, s.joint_step_rad)};
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
    const RoundEnd end = round.run();
    moved_ever |= end.moved;
    if (end.moved)
      for (int link = 0; link < kLinks; ++link)
        moved_most[link] = std::max(moved_most[link], link_motion(scene.hand, before, state.placement, link));
    failed |= end.failed;
    converged = !end.any_cut && !end.failed && end.left < kLeft && end.slack < kSlack;
    if (converged || end.failed || k + 1 == s.iterations) break;
    // Look farther where a list stopped its link, farther still where nothing is near.
    for (int link = 0; link < kLinks; ++link) {
      const double most = work.candidates.count[link] > 0 ? s.reach_most_m : s.free_reach_m;
      if (end.cut[link]) state.reach[link] = std::min(4 * state.reach[link], most);
    }
    converged = largest_motion(scene.hand, state.placement, haptic_placement) == 0;
    if (converged) break;
    if (work.left() < kLeastRound || !gather(scene, haptic_placement, state, work)) break;
  }
  // Next step: as far as this one moved and half as much again, within limits.
  for (int link = 0; link < kLinks; ++link) {
    const double most = work.candidates.count[link] > 0 ? s.reach_most_m : s.free_reach_m;
    state.reach[link] = std::clamp(2.5 * moved_most[link], s.reach_least_m, most);
  }

  state.status = kOk;
  if (!converged) state.status |= kIterationLimit;
  if (failed && !moved_ever) state.status |= kKeptPrevious;
  if (has_yielded(round)) state.status |= kYielded;
  state.resting = held && !moved_ever && state.reach == reach_before;
  return state.status;
}

}  // namespace palmar
