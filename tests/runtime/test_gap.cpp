#include "check.h"
#include "made_hand.h"
#include "search.h"

using namespace palmar;

namespace {

// Gap by its definition: the least over a fine sweep of the axis. Overestimates by at most spacing^2 / (2 distance).
double swept_gap(const Capsule& c, const Vec3& o, double r) {
  double least = 1e9;
  for (int i = 0; i <= 20000; ++i) {
    const double s = i / 20000.0;
    least = std::min(least, (c.c1 + s * (c.c2 - c.c1) - o).norm() - (c.r1 + s * (c.r2 - c.r1)) - r);
  }
  return least;
}

}  // namespace

int main() {
  std::mt19937 rng(2);
  std::uniform_real_distribution<double> u(-1, 1);

  for (int trial = 0; trial < 300; ++trial) {
    const Capsule c{0.02 * Vec3(u(rng), u(rng), u(rng)), 0.03 * Vec3(u(rng), u(rng), u(rng)) + Vec3(0.05, 0, 0),
                    0.008 + 0.004 * u(rng), 0.008 + 0.004 * u(rng)};
    const Vec3 o = c.c1 + Vec3(0.1 * u(rng), 0.05 * u(rng), 0.05 * u(rng));
    const double exact = capsule_sphere_gap(c, o, 0.003).gap;
    CHECK_NEAR(exact, swept_gap(c, o, 0.003), 2e-9);  // metres: (4 um)^2 / (2 x 5 mm)
  }

  // A centre on the axis, and a sphere of no size: a finite unit normal all the same.
  const CapsuleGap on_axis = capsule_sphere_gap({Vec3(0, 0, 0), Vec3(0.03, 0, 0), 0.01, 0.008}, Vec3(0.01, 0, 0), 0.0);
  CHECK_NEAR(on_axis.normal.norm(), 1, 1e-15);
  CHECK(on_axis.gap < 0);

  // Rows: every coefficient against central differences of the exact gap, at random poses, palm and fingers.
  const HandModel hand = made::hand();
  const PalmGroups palm(hand);
  int compared = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const Configuration q = made::random_configuration(rng, 0.06);
    const CollisionObject object(made::ball(300, 0.05, 0.006));
    const HandPlacement at = place_hand(hand, q);
    Candidates candidates(4096);
    std::uint32_t visited = 0;
    for (int link = 0; link < kLinks; ++link) {
      gather_link(hand, palm, object, at, link, 0.01, candidates, visited);
      CHECK(candidates.margin[link] == 0.01);
    }
    PerLink limit;
    limit.fill(0.01);
    std::vector<double> gap(candidates.size()), plus(candidates.size()), minus(candidates.size());
    evaluate_gaps(hand, candidates, at, gap.data());
    QpRows rows(20000);
    std::vector<std::int32_t> row_candidate(20000);
    CHECK(linearise(candidates, at, gap.data(), limit, nullptr, 1e-6, false, rows, row_candidate.data()));
    constexpr double h = 1e-6;  // rad or m: truncation h^2 / r^2 and rounding 1e-16 / h both stay below 1e-8
    for (int v = 0; v < kVariables; ++v) {
      Change change{};
      change[v] = h;
      evaluate_gaps(hand, candidates, place_hand(hand, advance(q, change, 1.0)), plus.data());
      evaluate_gaps(hand, candidates, place_hand(hand, advance(q, change, -1.0)), minus.data());
      for (int group = 0; group <= kFingers; ++group)
        for (int row = rows.group_start[group]; row < rows.group_start[group + 1]; ++row) {
          const int i = row_candidate[row], finger = group - 1;
          if (gap[i] < -0.005) continue;  // near an axis the gap has no gradient
          double g = 0;
          if (v < kPalmVariables)
            g = rows.g[v][row];
          else if (finger == (v - kPalmVariables) / kFingerVariables)
            g = rows.g[kPalmVariables + (v - kPalmVariables) % kFingerVariables][row];
          const double difference = (plus[i] - minus[i]) / (2 * h);
          if (std::abs(g - difference) > 1e-6) std::printf("variable %d row %d\n", v, row);
          CHECK_NEAR(g, difference, 1e-6);
          ++compared;
        }
    }
  }
  CHECK(compared > 100000);
  return finish();
}
