#include <set>

#include "check.h"
#include "made_hand.h"
#include "search.h"

using namespace palmar;

// The tree gives every sphere within the margin: against all spheres, one by
// one, for capsules, and for whole hands.
int main() {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(-1, 1);
  std::uniform_real_distribution<double> size(0, 1);

  for (int count : {1, 2, 15, 16, 17, 257, 3000}) {
    std::vector<Sphere> spheres;
    for (int i = 0; i < count; ++i)
      // From 0.05 mm to 50 mm in one tree.
      spheres.push_back({0.1 * Vec3(u(rng), u(rng), u(rng)), 5e-5 * std::pow(1000.0, size(rng))});
    const WideTree tree(spheres);
    std::vector<std::uint32_t> found(count);
    std::uint32_t visited = 0;
    for (int trial = 0; trial < 100; ++trial) {
      const Capsule c{0.15 * Vec3(u(rng), u(rng), u(rng)), 0.15 * Vec3(u(rng), u(rng), u(rng)), 0.012, 0.009};
      const double margin = 0.002;
      const int n = tree.find(capsule_query(c.c1, c.c2, c.r1, c.r2, margin), found.data(), count, visited);
      const std::set<std::uint32_t> set(found.begin(), found.begin() + n);
      CHECK(int(set.size()) == n);
      for (int i = 0; i < count; ++i)
        if (capsule_sphere_gap(c, spheres[i].center, spheres[i].radius).gap <= margin) CHECK(set.contains(i));
    }
    CHECK(tree.find(ball_query(Vec3(0, 0, 0), 1.0, 0.0), found.data(), count, visited) == count);
    if (count > 1) CHECK(tree.find(ball_query(Vec3(0, 0, 0), 1.0, 0.0), found.data(), count - 1, visited) == count);
  }

  // An object far smaller than what searches for it: a few grains of a
  // micrometre, touched within a nanometre.
  {
    std::vector<Sphere> grains;
    for (int i = 0; i < 40; ++i) grains.push_back({2e-4 * Vec3(u(rng), u(rng), u(rng)), 1e-6});
    const WideTree tree(grains);
    std::vector<std::uint32_t> found(grains.size());
    std::uint32_t visited = 0;
    int missed = 0, near = 0;
    for (int trial = 0; trial < 5000; ++trial) {
      const Vec3 along = Vec3(u(rng), u(rng), u(rng)).normalized();
      const Sphere& grain = grains[trial % grains.size()];
      Capsule c{Vec3(0, 0, 0), 0.045 * along, 0.009, 0.007};
      // Moved so that this grain lies at its side, just outside.
      const Vec3 side = along.unitOrthogonal();
      const Vec3 shift = grain.center - 0.045 * size(rng) * along - 0.0085 * side;
      c.c1 += shift, c.c2 += shift;
      const CapsuleGap gap = capsule_sphere_gap(c, grain.center, grain.radius);
      c.c1 += (1e-9 - gap.gap) * gap.normal, c.c2 += (1e-9 - gap.gap) * gap.normal;
      const int n = tree.find(capsule_query(c.c1, c.c2, c.r1, c.r2, 2e-9), found.data(), int(found.size()), visited);
      const std::set<std::uint32_t> set(found.begin(), found.begin() + n);
      for (std::uint32_t i = 0; i < grains.size(); ++i)
        if (capsule_sphere_gap(c, grains[i].center, grains[i].radius).gap <= 2e-9) ++near, missed += !set.contains(i);
    }
    CHECK(near >= 5000);
    CHECK(missed == 0);
  }

  const HandModel hand = made::hand();
  const PalmGroups palm(hand);
  const CollisionObject object(made::ears());
  // Every pair within a list's margin is in it, also where the list has no room for all that was asked for.
  int pairs = 0, shrunk = 0;
  for (int trial = 0; trial < 100; ++trial) {
    Candidates candidates(trial % 2 == 0 ? 4096 : 20);
    const HandPlacement at = place_hand(hand, made::random_configuration(rng, 0.08));
    const double margin = 0.003;
    std::uint32_t visited = 0;
    std::set<std::array<std::uint32_t, 3>> set;
    for (int link = 0; link < kLinks; ++link) {
      gather_link(hand, palm, object, at, link, margin, candidates, visited);
      CHECK(candidates.margin[link] == margin || (candidates.margin[link] < margin && candidates.count[link] == 20));
      shrunk += candidates.margin[link] < margin;
      for (int i = candidates.begin(link); i < candidates.end(link); ++i)
        set.insert({std::uint32_t(link), candidates.object_sphere[i], candidates.palm_sphere[i]});
    }
    // The list's own gaps differ from these by rounding.
    const auto within = [&](int link, double gap) { return gap < candidates.margin[link] - 1e-12; };
    for (std::uint32_t o = 0; o < object.leaves.size(); ++o) {
      const Sphere& s = object.leaves[o];
      for (std::uint32_t p = 0; p < hand.palm.size(); ++p)
        if (within(0, (at.rotation * hand.palm[p].center + at.position - s.center).norm() - hand.palm[p].radius -
                          s.radius)) {
          ++pairs;
          CHECK(set.contains(std::array<std::uint32_t, 3>{0u, o, p}));
        }
      for (std::uint32_t link = 1; link < kLinks; ++link)
        if (within(int(link), capsule_sphere_gap(at.phalanx[link - 1], s.center, s.radius).gap)) {
          ++pairs;
          CHECK(set.contains(std::array<std::uint32_t, 3>{link, o, UINT32_MAX}));
        }
    }
  }
  CHECK(pairs > 1000);
  CHECK(shrunk > 10);

  // A search with too few operations goes on at the next call, and in the end knows what one without a bound knows.
  int calls = 0, alone = 0, nearer = 0;
  for (int trial = 0; trial < 100; ++trial) {
    Candidates all(4096), bounded(4096);
    const HandPlacement at = place_hand(hand, made::random_configuration(rng, 0.03));
    std::uint32_t operations = 0;
    for (int link = 0; link < kLinks; ++link) {
      gather_link(hand, palm, object, at, link, 0.003, all, operations);
      for (++alone; bounded.margin[link] < 0 && calls < 100000; ++calls)
        gather_link(hand, palm, object, at, link, 0.003, bounded, operations, {.operations = 20});
      CHECK(bounded.margin[link] > 0);
      std::set<std::array<std::uint32_t, 2>> known;
      for (int i = bounded.begin(link); i < bounded.end(link); ++i)
        known.insert({bounded.object_sphere[i], bounded.palm_sphere[i]});
      std::vector<double> gap(std::size_t(all.size()));
      evaluate_gaps(hand, all, at, link, gap.data(), 1.0, operations);
      for (int i = all.begin(link); i < all.end(link); ++i) {
        if (gap[std::size_t(i)] >= bounded.margin[link] - 1e-12) continue;  // lists' own gaps differ by rounding
        ++nearer;
        CHECK(known.contains(std::array<std::uint32_t, 2>{all.object_sphere[i], all.palm_sphere[i]}));
      }
    }
  }
  CHECK(calls > alone && nearer > 100);

  // A palm of thousands of spheres: every pair within the margin is found.
  {
    HandModel many = made::hand();
    for (int i = 0; i < 5000; ++i) many.palm.push_back({1e-6 * Vec3(u(rng), u(rng), u(rng)), 0.011});
    many.finish();
    Candidates room(8192);
    std::uint32_t visited = 0;
    gather_link(many, PalmGroups(many), CollisionObject({{Vec3(0, 0, 0.0115), 0.001}}),
                place_hand(many, Configuration{}), 0, 0.001, room, visited);
    CHECK(room.margin[0] == 0.001);
    int within = 0;
    for (const PalmSphere& s : many.palm) within += (s.center - Vec3(0, 0, 0.0115)).norm() - s.radius - 0.001 <= 0.001;
    CHECK(within >= 5000);
    CHECK(room.count[0] == within);
  }
  return finish();
}
