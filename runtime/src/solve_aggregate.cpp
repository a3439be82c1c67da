// One programme over the whole hand, with far fewer rows: contacts merged before they are solved.
//
// A. Talvas, M. Marchal, C. Duriez, M. A. Otaduy, "Aggregate constraints for virtual manipulation with soft fingers",
// IEEE Trans. Vis. Comput. Graph. 21(4), 2015: the contact constraints of one phalanx are replaced by a minimal set of
// averages, each contact weighted by the volume it stands for. Here the programme is that of `monolithic`, and a region
// is what lies on one link within 30 degrees and 10 mm of the region's deepest contact; its row is
//     sum(w g) / sum(w) . x >= sum(w b) / sum(w),   w = (band - gap)^2 R,
// the volume of the cap that a leaf of radius R cuts off the 0.5 mm band, up to a factor.
//
// Expected to fail: an average holds while its ends do not: the hand sinks in on one side of a region and stands off on
// the other; and everything that `monolithic` leaves open.
#include <algorithm>
#include <limits>

#include "baseline.h"

namespace palmar {

namespace {

constexpr double kBand = 5e-4;         // metres, as in `monolithic`
constexpr double kRegion = 1e-2;       // metres: a fingertip's radius
constexpr double kSameNormal = 0.866;  // cos 30 degrees

struct Region {
  std::int32_t candidate;  // the deepest
  double weight = 0, b = 0;
  std::array<double, kPalmVariables + kFingerVariables> g{};
};

struct Merger {
  Workspace& work;

  double gap_of(int row) const { return work.gap[work.row_candidate[row]]; }
  Vec3 normal_of(int row) const { return {work.rows.g[0][row], work.rows.g[1][row], work.rows.g[2][row]}; }

  // On the object's sphere, where the hand meets it.
  Vec3 point_of(int row) const {
    const int pair = work.row_candidate[row];
    return work.candidates.center(pair) + work.candidates.radius[pair] * normal_of(row);
  }

  void add(Region& r, int row) const {
    // A contact at the band's very edge has no volume; the floor keeps a region of such ones defined.
    const double depth = std::max(kBand - gap_of(row), 1e-9);
    const double w = depth * depth * work.candidates.radius[work.row_candidate[row]];
    r.weight += w;
    r.b += w * work.rows.b[row];
    for (std::size_t k = 0; k < r.g.size(); ++k) r.g[k] += w * work.rows.g[k][row];
  }

  // Rows begin .. end - 1, all of one link, become one a region, written from `to` on. Regions grow around the deepest
  // contact that has none; should there be more than the programme has variables, the last takes the rest.
  int merge(int begin, int end, int to) const {
    std::array<Region, kVariables> region;
    int count = 0;
    double* const left = work.violation.data();  // gap of a row without region, infinity for the others
    constexpr double kTaken = std::numeric_limits<double>::infinity();
    for (int row = begin; row < end; ++row) left[row] = gap_of(row);
    for (int taken = begin; taken < end; ++count) {
      const int seed = int(std::min_element(left + begin, left + end) - left);
      const Vec3 normal = normal_of(seed), point = point_of(seed);
      const bool last = count + 1 == kVariables;
      region[count].candidate = work.row_candidate[seed];
      for (int row = begin; row < end; ++row) {
        if (left[row] == kTaken) continue;
        if (!last && row != seed &&
            (normal_of(row).dot(normal) < kSameNormal || (point_of(row) - point).norm() > kRegion))
          continue;
        add(region[count], row);
        left[row] = kTaken;
        ++taken;
      }
    }
    for (int k = 0; k < count; ++k, ++to) {
      const Region& r = region[k];
      for (std::size_t c = 0; c < r.g.size(); ++c) work.rows.g[c][to] = r.g[c] / r.weight;
      work.rows.b[to] = r.b / r.weight;
      work.row_candidate[to] = r.candidate;
    }
    return to;
  }

  // Rows come sorted by link; they stay so.
  void merge_all() const {
    QpRows& rows = work.rows;
    const int last = rows.count;
    int begin = 0, to = 0;
    for (int link = 0; link < kLinks; ++link) {
      if (link % kPhalanges == 1) rows.group_start[1 + (link - 1) / kPhalanges] = to;
      int end = begin;
      while (end < last && work.row_candidate[end] < work.candidates.end(link)) ++end;
      if (end > begin) to = merge(begin, end, to);
      begin = end;
    }
    rows.count = rows.group_start[kFingers + 1] = to;
  }
};

}  // namespace

std::uint32_t solve_aggregate(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work) {
  state.haptic = haptic;
  work.active_count = 0;
  Configuration q = state.graphic;
  q.abduction = haptic.abduction;
  const HandPlacement at = place_hand(scene.hand, q);
  if (!gather_near(scene, at, kBand, 0, kLinks, work)) return kKeptPrevious;
  PerLink band;
  band.fill(kBand);
  if (!linearise(work.candidates, at, work.gap.data(), band, nullptr, 0.0, true, work.rows, work.row_candidate.data()))
    return kKeptPrevious;
  Merger{work}.merge_all();
  bool relaxed;
  const QpResult result = solve_least_violation(scene, towards(scene.hand, q, haptic), work, relaxed);
  std::uint32_t status = result.status == QpStatus::solved ? kOk : kIterationLimit;
  if (!relaxed) remember_active(scene, result, work);
  q = result.active == 0 ? haptic : advance(q, result.x, 1.0);
  return status | publish_unverified(scene, q, state, work);
}

}  // namespace palmar
