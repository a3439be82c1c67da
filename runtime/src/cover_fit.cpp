#include "cover_fit.h"

#include <algorithm>
#include <cmath>

#include "parallel.h"

namespace palmar {
namespace {

constexpr double kKeep = 1.04, kKeepMost = 1.3;  // times the budget's high end: what lists hold
constexpr double kStale = 1e-3;                  // share of the samples whose lists may be short
constexpr std::size_t kParts = 64;               // of the samples, each with one thread when lists are made anew
constexpr std::size_t kRuns = 8;                 // of the samples, each summed by itself

}  // namespace

CoverFit::CoverFit(const TriangleTree& tree, std::vector<Zone> zones, const Samples& samples, std::uint64_t seed,
                   int threads)
    : tree_(tree),
      zones_(std::move(zones)),
      samples_(samples.points, threads),
      seen_(samples.points.size()),
      complete_(samples.points.size()),
      threads_(threads),
      random_{seed} {
  for (std::vector<Vec3>* rows : {&points_, &inward_}) rows->reserve(samples.points.size());
  for (std::vector<std::int32_t>* rows : {&faces_, &zone_}) rows->reserve(samples.points.size());
  stricter_.reserve(samples.points.size());
  for (const std::int32_t s : samples_.order()) {
    points_.push_back(samples.points[s]);
    inward_.push_back(samples.inward[s]);
    faces_.push_back(samples.faces[s]);
    zone_.push_back(samples.zones[s]);
    stricter_.push_back(zone_.back() ? float(1 / zones_[zone_.back() - 1].share - 1) : 0.0f);
  }
}

std::optional<InsideBall> CoverFit::ball_at(const Vec3& center, const Closest& found) const {
  const double inside = std::sqrt(found.squared);
  if (inside < kSmallestBall * tree_.size()) return {};
  return InsideBall{center, inside, found.face, held_inside(zones_, center, inside, excess_)};
}

std::optional<InsideBall> CoverFit::shot(const Vec3& point, const Vec3& inward, std::int32_t face, double slack,
                                         double start) const {
  auto ball = shoot(tree_, point, inward, face, slack, start);
  if (ball) ball->held = held_inside(zones_, ball->center, ball->inside, excess_);
  return ball;
}

double CoverFit::disc(const InsideBall& ball) const { return std::sqrt(2 * ball.inside * budget_ + budget_ * budget_); }

void CoverFit::set_balls(std::vector<InsideBall> balls, int fixed) {
  balls_ = std::move(balls);
  fixed_ = std::size_t(fixed);
  kept_ = 0;
  set_budget(low_, high_, excess_);
}

void CoverFit::set_budget(double low, double high, double excess) {
  excess_ = float(excess);
  low_ = low;
  high_ = high;
  budget_ = 0.5 * (low + high);
  slope_ = high > low ? 1 / (high - low) : 0;
  // Without zones gaps depend on no budget, and lists that reach far enough and lack nothing are as good as new.
  if (zones_.empty() && high <= kept_ && kept_ <= kKeepMost * high) {
    std::size_t stale = 0;
    for (std::size_t s = 0; s < seen_.size(); ++s) stale += seen_[s].gap[1] > complete_[s] && complete_[s] < high;
    if (double(stale) <= kStale * double(seen_.size())) return;
  }
  for (InsideBall& ball : balls_) ball.held = held_inside(zones_, ball.center, ball.inside, excess_);
  kept_ = kKeep * high;
  see_all();
}

void CoverFit::see_all() {
  Seen nothing;
  std::fill_n(nothing.ball, kKept, kNone);
  std::fill_n(nothing.gap, kKept, float(kept_));
  std::fill(seen_.begin(), seen_.end(), nothing);
  std::fill(complete_.begin(), complete_.end(), float(kept_));
  const std::vector<std::int32_t> parts = samples_.parts(kParts);
  in_parallel(threads_, parts.size(), [&](std::size_t part) {
    Hits hits;
    for (std::size_t k = 0; k < balls_.size(); ++k) {
      reach(balls_[k], hits, parts[part]);
      enter(std::int32_t(k), hits);
    }
  });
}

void CoverFit::reach(const InsideBall& ball, Hits& hits, std::int32_t part) const {
  hits.clear();
  const float held = float(ball.held), most = float(kept_);
  const auto add = [&](std::int32_t s, float distance) {
    const float gap = gap_of(s, distance, held);
    if (gap < most) hits.push_back({s, gap});
  };
  samples_.within(ball.center, ball.held + kept_, add, part);
}

void CoverFit::enter(std::int32_t index, const Hits& hits) {
  for (const auto& [s, gap] : hits) {
    Seen& seen = seen_[s];
    int at = kKept - 1;
    const float last = std::max(gap, seen.gap[at]);  // what the list has no room for
    if (seen.ball[at] >= 0) complete_[s] = std::min(complete_[s], last);
    if (!(gap < seen.gap[at])) continue;
    for (; at > 0 && gap < seen.gap[at - 1]; --at) {
      seen.gap[at] = seen.gap[at - 1];
      seen.ball[at] = seen.ball[at - 1];
    }
    seen.gap[at] = gap;
    seen.ball[at] = index;
  }
}

void CoverFit::leave(std::int32_t index, const Hits& hits) {
  for (const auto& [s, gap] : hits) {
    Seen& seen = seen_[s];
    int at = 0;
    while (at < kKept && seen.ball[at] != index) ++at;
    if (at == kKept) continue;
    for (; at + 1 < kKept; ++at) {
      seen.gap[at] = seen.gap[at + 1];
      seen.ball[at] = seen.ball[at + 1];
    }
    seen.gap[kKept - 1] = float(kept_);
    seen.ball[kKept - 1] = kNone;
  }
}

double CoverFit::quantile(double share) const {
  std::vector<std::vector<float>> gaps(zones_.size() + 1);
  for (std::size_t s = 0; s < seen_.size(); ++s) gaps[zone_[s]].push_back(seen_[s].gap[0]);
  float worst = 0;
  for (std::vector<float>& of_zone : gaps) {
    if (of_zone.empty()) continue;
    const auto at = of_zone.begin() + std::ptrdiff_t(share * double(of_zone.size() - 1));
    std::nth_element(of_zone.begin(), at, of_zone.end());
    worst = std::max(worst, *at);
  }
  return std::min(double(worst), high_);
}

double CoverFit::gain(const Hits& hits, std::int32_t without) const {
  double sum = 0;
  for (const auto& [s, gap] : hits) {
    const Seen& seen = seen_[s];
    const float rest = seen.ball[0] == without ? seen.gap[1] : seen.gap[0];
    if (gap < rest) sum += cost_of(rest) - cost_of(gap);
  }
  return sum;
}

double CoverFit::loss(std::int32_t index, const Hits& hits) const {
  double sum = 0;
  for (const auto& [s, gap] : hits) {
    const Seen& seen = seen_[s];
    if (seen.ball[0] == index) sum += cost_of(seen.gap[1]) - cost_of(seen.gap[0]);
  }
  return sum;
}

std::vector<double> CoverFit::losses() const {
  std::vector<std::vector<double>> parts(kRuns);
  in_runs([&](std::size_t run, std::size_t first, std::size_t last) {
    std::vector<double>& sum = parts[run];
    sum.assign(balls_.size(), 0.0);
    for (std::size_t s = first; s < last; ++s) {
      const Seen& seen = seen_[s];
      if (seen.ball[0] >= 0) sum[seen.ball[0]] += cost_of(seen.gap[1]) - cost_of(seen.gap[0]);
    }
  });
  for (std::size_t run = 1; run < kRuns; ++run) {
    for (std::size_t k = 0; k < balls_.size(); ++k) parts[0][k] += parts[run][k];
  }
  return std::move(parts[0]);
}

std::vector<std::int32_t> CoverFit::bare() const {
  std::vector<std::vector<std::int32_t>> parts(kRuns);
  in_runs([&](std::size_t run, std::size_t first, std::size_t last) {
    for (std::size_t s = first; s < last; ++s) {
      if (seen_[s].gap[0] > budget_) parts[run].push_back(std::int32_t(s));
    }
  });
  for (std::size_t run = 1; run < kRuns; ++run) parts[0].insert(parts[0].end(), parts[run].begin(), parts[run].end());
  return std::move(parts[0]);
}

void CoverFit::in_runs(const std::function<void(std::size_t, std::size_t, std::size_t)>& work) const {
  in_parallel(threads_, kRuns,
              [&](std::size_t run) { work(run, run * seen_.size() / kRuns, (run + 1) * seen_.size() / kRuns); });
}

}  // namespace palmar
