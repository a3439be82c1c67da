// What a round's programme knows of how contacts bend.
#include "round.h"

namespace palmar {

namespace {

constexpr double kLeastPivot = 0.01;                // of the stiffness that curvature has to leave
constexpr double kAcross = 1e3, kAcrossMore = 3e4;  // times the springs' stiffness across a contact, added

}  // namespace

// At the round's start; a pair that is asked for again has its shape.
const GapShape& Round::shape_of(const Pressing& p) {
  for (int k = 0; k < work.bent_count; ++k) {
    const BentPair& b = work.bent[k];
    if (b.link == p.link && b.object_sphere == p.object_sphere && b.palm_sphere == p.palm_sphere) return b.shape;
  }
  BentPair& made = work.bent[work.bent_count++];
  made = {p.link, p.object_sphere, p.palm_sphere,
          gap_shape(scene.hand, state.placement, p.link, p.palm_sphere, scene.object.leaves[p.object_sphere])};
  return made.shape;
}

// The second derivatives of the Lagrangian: the springs' stiffness less what the contacts' curvature, each with the
// force that it last carried, takes from it. Convex is asked only along the contacts: across them and at joint limits,
// where rows and bounds hold the answer anyway, stiffness is added, many times the springs' own. False where that does
// not do either: there the hand is about to slip off.
bool Round::bend(const Change& way, Metric& metric, Change& wish) {
  if (state.pressing_count == 0 || scene.settings.curvature == 0) return false;
  if (work.bent_count + state.pressing_count > int(work.bent.size())) work.bent_count = 0;
  ArrowMatrix bent = ArrowMatrix::diagonal(weight);
  Change force;
  for (int v = 0; v < kVariables; ++v) force[v] = weight[v] * way[v];
  std::array<const GapShape*, kVariables> pressing;
  std::array<double, kVariables> stiffness, off;  // of the springs across each contact; how far its row lets it come
  const auto variable = [](const GapShape& s, int a) {
    return a < kPalmVariables ? a : a + kFingerVariables * s.finger;
  };
  for (int k = 0; k < state.pressing_count; ++k) {
    const Pressing& p = state.pressing[k];
    const GapShape& s = *(pressing[k] = &shape_of(p));
    double yield = 0;
    for (int a = 0; a < s.count; ++a) yield += s.slope[a] * s.slope[a] / weight[variable(s, a)];
    stiffness[k] = 1 / yield;
    off[k] = std::max(0.0, s.gap - scene.settings.aim_m);
    add_shape(s, -scene.settings.curvature * p.multiplier, 0.0, bent);
  }
  // The energy of a turn by the vector w from the haptic hand, 1/2 k |w|^2, is flatter across w than along it.
  const Vec3 turn(way[3], way[4], way[5]);
  const double angle = turn.norm();
  if (angle > 1e-6) {
    const Vec3 axis = turn / angle;
    const auto [sine, cosine] = sine_cosine(0.5 * angle);
    const double flat = weight[3] * (1.0 - 0.5 * angle * cosine / sine);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j <= i; ++j) bent.palm[3 + i][3 + j] -= flat * ((i == j) - axis[i] * axis[j]);
  }
  Change least;
  for (int v = 0; v < kVariables; ++v) least[v] = kLeastPivot * weight[v];
  // What is added across a contact rests where the pair's row ends, or one that stands off would be kept off. A second,
  // larger share is for contacts that are nearly alike: the directions in which they differ are held only weakly.
  for (const double share : {kAcross, kAcrossMore}) {
    for (int k = 0; k < state.pressing_count; ++k) {
      const GapShape& s = *pressing[k];
      add_shape(s, 0.0, share * stiffness[k], bent);
      for (int a = 0; a < s.count; ++a) force[variable(s, a)] -= share * stiffness[k] * off[k] * s.slope[a];
    }
    for (int v = 0; v < kVariables; ++v)
      if (state.at_limit >> v & 1) bent.add_diagonal(v, share * weight[v]);
    if (!Metric::of(bent, least, metric)) continue;
    wish = metric.inverse_times(force);
    return true;
  }
  return false;
}

}  // namespace palmar
