// Nothing that a moving hand touches on its way is missing from the candidates gathered at the start, for 100,000
// spheres: against the first touch by dense sampling along the interpolated configuration and bisection, with a
// distance and kinematics of its own.
#include "brute_force.h"
#include "check.h"
#include "made_hand.h"
#include "search.h"

using namespace palmar;

namespace {

constexpr int kMotions = 520, kSpheres = 200, kSamples = 16;
std::mt19937 rng(11);
std::uniform_real_distribution<double> u(-1, 1);

// Where in [a, b] the gap, negative at b and not at a, passes zero.
template <class Gap>
double first_touch(const Gap& gap, double a, double b) {
  for (int i = 0; i < 50; ++i) {
    const double middle = 0.5 * (a + b);
    (gap(middle) < 0 ? b : a) = middle;
  }
  return b;
}

// The least of a smooth gap between two samples that enclose it: golden section.
template <class Gap>
double least_between(const Gap& gap, double a, double b, double& at) {
  for (int i = 0; i < 40; ++i) {
    const double part = 0.6180339887498949 * (b - a);
    if (gap(b - part) < gap(a + part))
      b = a + part;
    else
      a = b - part;
  }
  at = 0.5 * (a + b);
  return gap(at);
}

}  // namespace

int main() {
  const HandModel hand = made::hand();
  const PalmGroups palm(hand);
  const std::size_t rounds = made::rounds_of(hand, HandPose{}).size();
  Candidates candidates(8192);
  long queries = 0, touches = 0, grazes = 0, missed = 0, listed = 0, listed_in_vain = 0, beyond = 0, late = 0;

  for (int motion = 0; motion < kMotions; ++motion) {
    const Configuration from = made::random_configuration(rng, 0.05);
    // From a tenth of a millimetre to a hand's breadth in one step, turns and fingers included.
    Change change;
    for (double& c : change) c = u(rng);
    const double size = 1e-4 * std::pow(10.0, 1.35 * (1 + u(rng)));
    for (int v = 0; v < kVariables; ++v) change[v] *= size / (v < 3 ? 1 : 0.05);
    const auto pose_at = [&](double t) { return to_pose(advance(from, change, t)); };

    std::vector<std::vector<made::Round>> path;
    double margin = 0;
    const HandPlacement start = place_hand(hand, from);
    for (int k = 0; k <= kSamples; ++k) {
      path.push_back(made::rounds_of(hand, pose_at(double(k) / kSamples)));
      margin =
          std::max(margin, largest_motion(hand, start, place_hand(hand, advance(from, change, double(k) / kSamples))));
    }

    // Spheres about the hand's surface, where the touches are: from grains to balls.
    std::vector<Sphere> spheres;
    while (int(spheres.size()) < kSpheres) {
      const made::Round& r = path[std::size_t(kSamples * std::abs(u(rng)))][std::size_t(rng() % rounds)];
      const double x = std::abs(u(rng)), radius = 1e-4 * std::pow(10.0, 1.2 * (1 + u(rng)));
      const double out = r.r1 + x * (r.r2 - r.r1) + radius + margin * u(rng) + 1e-5 * u(rng);
      const Sphere s{r.from + x * (r.to - r.from) + out * Vec3(u(rng), u(rng), u(rng)).normalized(), radius};
      // The hand is free where it starts, as it always is.
      if (std::none_of(path[0].begin(), path[0].end(),
                       [&](const made::Round& mine) { return made::BruteForce::exact(mine, s) < 0; }))
        spheres.push_back(s);
    }
    const CollisionObject object(spheres);
    candidates.forget();  // of another object
    std::uint32_t visited = 0;
    // Between two samples a link strays from them by less than a thousandth of the way.
    for (int link = 0; link < kLinks; ++link) {
      gather_link(hand, palm, object, start, link, 1.001 * margin + 1e-9, candidates, visited);
      CHECK(candidates.margin[link] == 1.001 * margin + 1e-9);
    }
    std::vector<char> has(std::size_t(kSpheres) * rounds, 0);
    for (int link = 0; link < kLinks; ++link)
      for (int i = candidates.begin(link); i < candidates.end(link); ++i) {
        const std::size_t round =
            link == 0 ? candidates.palm_sphere[std::size_t(i)] : hand.palm.size() + std::size_t(link) - 1;
        has[object.number[candidates.object_sphere[std::size_t(i)]] * rounds + round] = 1;
      }

    // Spheres within others are no part of the object's surface.
    for (const std::size_t s : object.number) {
      ++queries;
      for (std::size_t r = 0; r < rounds; ++r) {
        double least = 1;
        int least_at = 0;
        for (int k = 0; k <= kSamples; ++k) {
          const double gap = made::BruteForce::exact(path[k][r], spheres[s]);
          if (gap < least) least = gap, least_at = k;
        }
        const auto gap = [&](double t) {
          return made::BruteForce::exact(made::rounds_of(hand, pose_at(t))[r], spheres[s]);
        };
        double at = double(least_at) / kSamples;
        // A touch between two samples: the gap there can be no more than half their distance lower.
        if (least > 0 && least < margin / kSamples) {
          least = least_between(gap, std::max(0, least_at - 1) / double(kSamples),
                                std::min(kSamples, least_at + 1) / double(kSamples), at);
          grazes += least < 0;
        }
        const bool listed_here = has[s * rounds + r] != 0;
        listed += listed_here;
        beyond += listed_here && made::BruteForce::exact(path[0][r], spheres[s]) > 1.001 * margin + 1e-9;
        if (least < 0) {
          ++touches;
          missed += !listed_here;
          // Where the touch begins the hand has moved no farther than the margin: the list was still good there.
          if (!listed_here)
            late +=
                largest_motion(hand, start, place_hand(hand, advance(from, change, first_touch(gap, 0, at)))) > margin;
        } else {
          listed_in_vain += listed_here;
        }
      }
    }
  }
  std::printf(
      "%ld queries: %ld touches (%ld between samples), %ld missed (%ld beyond the margin); of %ld listed pairs "
      "%.3f %% lay beyond the margin, %.1f %% were not touched\n",
      queries, touches, grazes, missed, late, listed, 100.0 * double(beyond) / double(listed),
      100.0 * double(listed_in_vain) / double(listed));
  CHECK(queries >= 100000);
  CHECK(touches > 30000 && grazes > 50);
  CHECK(missed == 0);
  // What is listed is within the margin but for float rounding. Most of that is not touched: the margin reaches out to
  // all sides, the hand goes one way.
  CHECK(double(beyond) < 0.01 * double(listed));
  return finish();
}
