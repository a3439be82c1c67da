// The judge itself: its distance is the least over the axis, its search misses nothing, and its objects have the size
// and the thickness that they are named for.
#include "brute_force.h"
#include "check.h"
#include "made_hand.h"
#include "made_objects.h"

using namespace palmar;

namespace {

// Least over the axis of distance less radius, which is convex in the place: golden section.
double least_over_axis(const made::Round& r, const Sphere& s) {
  const auto at = [&](double x) {
    return (r.from + x * (r.to - r.from) - s.center).norm() - (r.r1 + x * (r.r2 - r.r1)) - s.radius;
  };
  double low = 0, high = 1;
  for (int i = 0; i < 100; ++i) {
    const double third = made::kGoldenShare * (high - low);
    if (at(high - third) < at(low + third))
      high = low + third;
    else
      low = high - third;
  }
  return std::min({at(0), at(1), at(0.5 * (low + high))});
}

}  // namespace

int main() {
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> u(-1, 1);

  for (int trial = 0; trial < 20000; ++trial) {
    const made::Round r{0.03 * Vec3(u(rng), u(rng), u(rng)), 0.03 * Vec3(u(rng), u(rng), u(rng)),
                        0.008 + 0.004 * u(rng), 0.008 + 0.004 * u(rng), 1};
    if ((r.to - r.from).norm() <= std::abs(r.r1 - r.r2)) continue;  // one ball holds the other: no side
    // A tenth of the centres on the axis itself.
    const Vec3 center = trial % 10 == 0 ? Vec3(r.from + u(rng) * (r.to - r.from)) : 0.06 * Vec3(u(rng), u(rng), u(rng));
    const Sphere s{center, 0.003};
    CHECK_NEAR(made::BruteForce::exact(r, s), least_over_axis(r, s), 1e-12);  // metres: rounding of 0.1 m sums
  }

  // The float pass and the exact one over few are the exact one over all; the kinematics are the runtime's.
  const HandModel hand = made::hand();
  int inside = 0;
  for (const std::string& name : made::object_names())
    for (int trial = 0; trial < 40; ++trial) {
      const std::vector<Sphere> leaves = made::object(name, 700);
      const Configuration q = made::random_configuration(rng, 0.09);
      const HandPose pose = to_pose(q);
      made::Deepest all;
      for (const made::Round& r : made::rounds_of(hand, pose))
        for (std::uint32_t i = 0; i < leaves.size(); ++i) {
          const double gap = made::BruteForce::exact(r, leaves[i]);
          if (gap < all.gap_m) all = {gap, r.link, i};
        }
      const made::Deepest found = made::BruteForce(leaves).deepest(hand, pose);
      CHECK_NEAR(found.gap_m, all.gap_m, all.gap_m < 1e-4 ? 0 : 1e-6);
      inside += all.gap_m < 0;
      const HandPlacement at = place_hand(hand, q);
      const std::vector<made::Round> rounds = made::rounds_of(hand, pose);
      for (int link = 1; link < kLinks; ++link) {
        const made::Round& r = rounds[hand.palm.size() + std::size_t(link) - 1];
        CHECK((r.from - at.phalanx[link - 1].c1).norm() < 1e-14 && (r.to - at.phalanx[link - 1].c2).norm() < 1e-14);
      }
    }
  CHECK(inside > 50);

  // The same surface at any count: a 6 mm ball that comes to rest on 3,000 leaves rests on 30,000, but for the leaves'
  // rounding of edges (1.1 spacings) and the dents between them.
  const auto gap_of = [](const std::vector<Sphere>& leaves, const Vec3& p) {
    double gap = 1;
    for (const Sphere& s : leaves) gap = std::min(gap, (p - s.center).norm() - s.radius - 0.006);
    return gap;
  };
  for (const std::string& name : made::object_names()) {
    for (int count : {500, 3000, 30000, 100000}) {
      const std::vector<Sphere> leaves = made::object(name, count);
      CHECK(int(leaves.size()) == count);
      Vec3 low(1, 1, 1), high(-1, -1, -1);
      for (const Sphere& s : leaves) {
        low = low.cwiseMin(s.center - Vec3::Constant(s.radius));
        high = high.cwiseMax(s.center + Vec3::Constant(s.radius));
      }
      const double largest = (high - low).maxCoeff();
      CHECK(largest > 0.078 && largest < 0.102);
    }
    const auto coarse = made::object(name, 3000), fine = made::object(name, 30000);
    int rested = 0;
    for (int trial = 0; trial < 20; ++trial) {
      Vec3 p = 0.15 * Vec3(u(rng), u(rng), u(rng)).normalized();
      const Vec3 way = (0.02 * Vec3(u(rng), u(rng), u(rng)) - p).normalized();
      double gap = gap_of(coarse, p);
      for (int i = 0; i < 200 && gap > 1e-6 && p.norm() < 0.2; ++i) p += gap * way, gap = gap_of(coarse, p);
      if (gap > 1e-6) continue;
      ++rested;
      CHECK_NEAR(gap_of(fine, p), 0, 2.5e-3);
    }
    CHECK(rested > 5);
  }
  return finish();
}
