// The second derivatives of gaps against differences of the exact gap, and the metric that they make against its
// definition.
#include "check.h"
#include "contacts.h"
#include "curvature.h"
#include "made_hand.h"

using namespace palmar;

namespace {

double entry(const ArrowMatrix& h, int a, int b) {
  if (a > b) std::swap(a, b);
  const auto finger = [](int v) { return (v - kPalmVariables) / kFingerVariables; };
  const auto own = [](int v) { return (v - kPalmVariables) % kFingerVariables; };
  if (b < kPalmVariables) return h.palm[b][a];
  if (a < kPalmVariables) return h.across[finger(b)][a][own(b)];
  return finger(a) == finger(b) ? h.finger[finger(a)][own(b)][own(a)] : 0.0;
}

double gap_of(const HandModel& hand, const Configuration& q, int link, int palm_sphere, const Sphere& s) {
  const HandPlacement at = place_hand(hand, q);
  if (link > 0) return capsule_sphere_gap(at.phalanx[link - 1], s.center, s.radius).gap;
  const PalmSphere& mine = hand.palm[palm_sphere];
  return (at.rotation * mine.center + at.position - s.center).norm() - mine.radius - s.radius;
}

// Where on the capsule the gap is decided: -1 the first ball, 0 the side, 1 the second.
int part_of(const HandModel& hand, const Configuration& q, int link, const Sphere& s) {
  if (link == 0) return 0;
  const Capsule c = place_hand(hand, q).phalanx[link - 1];
  const Vec3 axis = capsule_sphere_gap(c, s.center, s.radius).axis;
  return axis == c.c1 ? -1 : (axis - c.c2).norm() < 1e-15 ? 1 : 0;
}

}  // namespace

int main() {
  std::mt19937 rng(9);
  std::uniform_real_distribution<double> u(-1, 1);
  const HandModel hand = made::hand();

  int sides = 0, ends = 0, palms = 0;
  for (int trial = 0; trial < 400; ++trial) {
    const Configuration q = made::random_configuration(rng, 0.06);
    const HandPlacement at = place_hand(hand, q);
    const int link = trial % kLinks, palm_sphere = int(rng() % hand.palm.size());
    const Vec3 near = link == 0 ? Vec3(at.rotation * hand.palm[palm_sphere].center + at.position)
                                : Vec3(at.phalanx[link - 1].c1 +
                                       (0.5 + 0.9 * u(rng)) * (at.phalanx[link - 1].c2 - at.phalanx[link - 1].c1));
    const Sphere sphere{near + 0.02 * Vec3(u(rng), u(rng), u(rng)).normalized(), 0.006};
    ArrowMatrix h;
    const GapShape shape = gap_shape(hand, at, link, std::uint32_t(palm_sphere), sphere);
    add_shape(shape, 2.0, 0.0, h);
    constexpr double d = 2e-5;  // rounding 1e-17 / d^2 is 2e-8, truncation d^2 / r^3 is 4e-4 at r = 10 mm, per metre
    const int part = part_of(hand, q, link, sphere);
    bool one_part = true;
    for (int a = 0; a < kVariables && one_part; ++a)
      for (double by : {-2 * d, 2 * d}) {
        Change change{};
        change[a] = by;
        one_part &= part_of(hand, advance(q, change, 1.0), link, sphere) == part;
      }
    if (!one_part || gap_of(hand, q, link, palm_sphere, sphere) < -0.002) continue;  // near an axis it has no curvature
    (link == 0 ? palms : part == 0 ? sides : ends) += 1;
    for (int a = 0; a < shape.count; ++a) {
      Change change{};
      change[a < kPalmVariables ? a : a + kFingerVariables * shape.finger] = d;
      const double slope = (gap_of(hand, advance(q, change, 1.0), link, palm_sphere, sphere) -
                            gap_of(hand, advance(q, change, -1.0), link, palm_sphere, sphere)) /
                           (2 * d);
      CHECK_NEAR(shape.slope[a], slope, 1e-6);
    }
    for (int a = 0; a < kVariables; ++a)
      for (int b = a; b < kVariables; ++b) {
        double second = 0;
        for (int i : {-1, 1})
          for (int k : {-1, 1}) {
            Change change{};
            change[a] += i * d;
            change[b] += k * d;
            second += i * k * gap_of(hand, advance(q, change, 1.0), link, palm_sphere, sphere) / (4 * d * d);
          }
        CHECK_NEAR(entry(h, a, b), 2.0 * second, 1e-2);
        if (checks_failed > 5) return finish();
      }
  }
  CHECK(sides > 50 && ends > 50 && palms > 10);

  // The metric of a random convex arrow: M' M H y = y. Of one that is not convex: refused.
  for (int trial = 0; trial < 200; ++trial) {
    Change weight, least, y;
    for (int v = 0; v < kVariables; ++v) {
      weight[v] = std::pow(10.0, 2 * u(rng));
      least[v] = 1e-3 * weight[v];
      y[v] = u(rng);
    }
    ArrowMatrix h = ArrowMatrix::diagonal(weight);
    for (int i = 0; i < 6; ++i) {
      const int f = int(rng() % kFingers);
      double g[kPalmVariables + kFingerVariables];
      for (double& x : g) x = u(rng);
      for (int a = 0; a < kPalmVariables; ++a) {
        for (int b = 0; b < kPalmVariables; ++b) h.palm[a][b] += g[a] * g[b];
        for (int b = 0; b < kFingerVariables; ++b) h.across[f][a][b] += g[a] * g[kPalmVariables + b];
      }
      for (int a = 0; a < kFingerVariables; ++a)
        for (int b = 0; b < kFingerVariables; ++b) h.finger[f][a][b] += g[kPalmVariables + a] * g[kPalmVariables + b];
    }
    Change times{};
    for (int a = 0; a < kVariables; ++a)
      for (int b = 0; b < kVariables; ++b) times[a] += entry(h, a, b) * y[b];
    Metric metric;
    CHECK(Metric::of(h, least, metric));
    const Change back = metric.inverse_times(times);
    for (int v = 0; v < kVariables; ++v) CHECK_NEAR(back[v], y[v], 1e-9);  // weights four decades apart
    h.finger[trial % kFingers][trial % kFingerVariables][trial % kFingerVariables] -= 1e4;
    CHECK(!Metric::of(h, least, metric));
  }
  return finish();
}
