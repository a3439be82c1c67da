#include "cover_fit.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "parallel.h"

namespace palmar {
namespace {

constexpr std::int32_t kNone = -1;
constexpr std::size_t kBlock = 48;  // places judged against one state, or a share of many balls
constexpr std::size_t kBlockShare = 64;
constexpr double kSlack = 0.4;  // of the budget: what may enter a ball that passes over dents and facets
constexpr double kKeep = 1.04, kKeepMost = 1.3;  // times the budget's high end: what lists hold
constexpr double kStale = 1e-3;                  // share of the samples whose lists may be short
constexpr std::size_t kParts = 64;               // of the samples, each with one thread when lists are made anew

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
  std::vector<double> sum(balls_.size(), 0.0);
  for (const Seen& seen : seen_) {
    if (seen.ball[0] >= 0) sum[seen.ball[0]] += cost_of(seen.gap[1]) - cost_of(seen.gap[0]);
  }
  return sum;
}

Vec3 CoverFit::pull(std::int32_t index, const Hits& hits) const {
  const InsideBall& ball = balls_[index];
  Vec3 sum = Vec3::Zero();
  for (const auto& [s, gap] : hits) {
    const Seen& seen = seen_[s];
    if (seen.ball[0] == index && seen.gap[0] > low_) sum += (points_[s] - ball.center).normalized();
  }
  const double length = sum.norm();
  return length > 0 ? Vec3(sum / length) : sum;
}

std::optional<InsideBall> CoverFit::moved(const InsideBall& ball, const Vec3& shift, Random& random) const {
  const double far = shift.norm();
  if (far >= ball.inside) return {};
  const Vec3 center = ball.center + shift;
  const Closest found = tree_.closest(center, ball.face);
  const double distance = std::sqrt(found.squared);
  if (distance < kSmallestBall * tree_.size()) return {};
  if (random.uniform() < 0.2) return ball_at(center, found);
  // Up from the surface to the medial axis again, or a little past it.
  const Vec3 inward = (center - found.point) / distance;
  const double slack = random.uniform() < 0.5 ? 0.0 : kSlack * budget_ * random.uniform();
  return shot(found.point, inward, found.face, slack, distance + 2 * far + slack);
}

void CoverFit::walk(Move& move, double step, int moves, double temperature, Random random) const {
  const std::int32_t index = move.out;
  InsideBall at = balls_[index];
  move.in.reset();
  reach(at, move.before);
  const double own = loss(index, move.before);
  double worse_at = 0;
  const Vec3 towards = pull(index, move.before);
  Vec3 again = Vec3::Zero();
  Hits hits;
  for (int k = 0; k < moves; ++k) {
    const double size = step * disc(at) * std::pow(8.0, -random.uniform());
    Vec3 shift = again;
    if (again.isZero()) shift = size * (random.in_ball() + (k % 2 ? 0.0 : 1.0) * towards);
    again.setZero();
    const auto other = moved(at, shift, random);
    if (!other) continue;
    reach(*other, hits);
    const double worse = own - gain(hits, index);
    const bool better = worse < worse_at;
    if (better || (temperature > 0 && random.uniform() < std::exp((worse_at - worse) / temperature))) {
      if (better) again = other->center - at.center;
      at = *other;
      worse_at = worse;
      move.in = at;
      std::swap(hits, move.after);
    }
  }
}

int CoverFit::polish(double step, int moves, double temperature) {
  std::vector<std::int32_t> order(balls_.size() - fixed_);
  std::iota(order.begin(), order.end(), std::int32_t(fixed_));
  for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[random_.below(k)]);
  std::vector<Move> found(kBlock);
  int taken = 0;
  for (std::size_t first = 0; first < order.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, order.size() - first);
    const std::uint64_t seed = random_.next();
    in_parallel(threads_, count, [&](std::size_t k) {
      found[k].out = order[first + k];
      walk(found[k], step, moves, temperature, Random{seed + k * 0x2545f4914f6cdd1dull});
    });
    for (std::size_t k = 0; k < count; ++k) {
      const auto& [index, in, before, after] = found[k];
      if (!in) continue;
      const double worse = loss(index, before) - gain(after, index);
      if (worse < 0 || (temperature > 0 && random_.uniform() < std::exp(-worse / temperature))) {
        leave(index, before);
        balls_[index] = *in;
        enter(index, after);
        ++taken;
      }
    }
  }
  return taken;
}

void CoverFit::find_best(Move& move, std::size_t sample, int candidates, Random& random) const {
  move.in.reset();
  double most = 0;
  Hits hits;
  const auto judge = [&](const std::optional<InsideBall>& ball) {
    if (!ball) return;
    reach(*ball, hits);
    const double now = gain(hits, kNone);
    if (now <= most) return;
    most = now;
    move.in = ball;
    std::swap(hits, move.after);
  };
  const Vec3 &from = points_[sample], &inward = inward_[sample];
  for (int k = 0; k < candidates; ++k) {
    if (k % 4 == 3) {
      // Down from an edge or a corner, where medial balls are tiny.
      const Vec3 center = from + 3 * budget_ * random.uniform() * inward;
      const Closest found = tree_.closest(center, faces_[sample]);
      const bool open = !tree_.crosses(from + kSurfaceRounding * tree_.size() * inward, center);
      if (open) judge(ball_at(center, found));
    } else {
      const double slack = k % 2 ? kSlack * budget_ * random.uniform() : 0.0;
      judge(shot(from, inward, faces_[sample], slack, 0.5 * tree_.size()));
      if (move.in) judge(moved(*move.in, random.uniform() * disc(*move.in) * random.in_ball(), random));
    }
  }
}

std::vector<std::int32_t> CoverFit::bare() const {
  std::vector<std::int32_t> found;
  for (std::size_t s = 0; s < seen_.size(); ++s) {
    if (seen_[s].gap[0] > budget_) found.push_back(std::int32_t(s));
  }
  return found;
}

int CoverFit::exchange(int trials, int candidates) {
  int taken = 0;
  const std::size_t block = std::max(kBlock, balls_.size() / kBlockShare);
  std::vector<Move> moves(block);
  for (int first = 0; first < trials && balls_.size() > fixed_; first += int(block)) {
    const std::vector<double> lost = losses();
    std::vector<std::int32_t> order(balls_.size() - fixed_);
    std::iota(order.begin(), order.end(), std::int32_t(fixed_));
    const std::size_t pool = std::min(order.size(), std::max(block, order.size() / 10));
    std::partial_sort(order.begin(), order.begin() + std::ptrdiff_t(pool), order.end(),
                      [&](std::int32_t i, std::int32_t j) { return std::pair(lost[i], i) < std::pair(lost[j], j); });
    const std::vector<std::int32_t> targets = bare();
    if (targets.empty()) break;
    const std::size_t count = std::min(block, std::size_t(trials - first));
    const std::uint64_t seed = random_.next();
    in_parallel(threads_, count, [&](std::size_t k) {
      Random random{seed + k * 0x2545f4914f6cdd1dull};
      moves[k].out = order[random.below(pool)];
      find_best(moves[k], std::size_t(targets[random.below(targets.size())]), candidates, random);
      if (moves[k].in) reach(balls_[moves[k].out], moves[k].before);
    });
    int now = 0;
    std::vector<bool> gone(balls_.size());
    for (std::size_t k = 0; k < count; ++k) {
      auto& [out, in, before, after] = moves[k];
      if (!in) continue;
      if (gone[out]) reach(balls_[out], before);
      if (gain(after, kNone) <= loss(out, before)) continue;
      leave(out, before);
      balls_[out] = *in;
      enter(out, after);
      gone[out] = true;
      ++now;
    }
    taken += now;
    if (!now && first > trials / 4) break;
  }
  return taken;
}

void CoverFit::remove(int count) {
  while (count > 0) {
    const int gone = take_out(count, false);
    if (!gone) return;
    count -= gone;
  }
}

void CoverFit::remove_useless() {
  // Lists of the least gaps are short: where many balls see the same samples, the next round sees more.
  while (take_out(int(balls_.size()), true) > int(balls_.size() / 20)) set_budget(low_, high_, excess_);
}

int CoverFit::take_out(int count, bool useless) {
  const std::size_t least = std::max<std::size_t>(fixed_, 1);
  if (balls_.size() <= least) return 0;
  const std::vector<double> lost = losses();
  std::vector<std::int32_t> order(balls_.size() - fixed_);
  std::iota(order.begin(), order.end(), std::int32_t(fixed_));
  std::sort(order.begin(), order.end(),
            [&](std::int32_t i, std::int32_t j) { return std::pair(lost[i], i) < std::pair(lost[j], j); });
  // What goes changes what the others are worth: a tenth at a time, or as long as nothing is lost.
  const std::size_t most = std::min(balls_.size() - least, useless ? order.size() : std::size_t(count));
  std::vector<std::int32_t> gone;
  Hits hits;
  for (const std::int32_t k : order) {
    if (gone.size() == most || (useless ? lost[k] > 0 : gone.size() > order.size() / 10)) break;
    reach(balls_[k], hits);
    if (useless && loss(k, hits) > 0) continue;
    leave(k, hits);
    gone.push_back(k);
  }
  std::sort(gone.rbegin(), gone.rend());
  for (const std::int32_t k : gone) {
    const std::int32_t last = std::int32_t(balls_.size()) - 1;
    if (k != last) {
      reach(balls_[last], hits);
      leave(last, hits);
      balls_[k] = balls_[last];
      enter(k, hits);
    }
    balls_.pop_back();
  }
  return int(gone.size());
}

int CoverFit::add(int count, int candidates) {
  const std::size_t block = std::max(kBlock, balls_.size() / kBlockShare);
  int added = 0;
  while (added < count) {
    std::vector<std::int32_t> targets = bare();
    if (targets.empty()) break;
    const std::size_t some = std::min<std::size_t>({std::size_t(count - added), block, targets.size()});
    std::vector<Move> moves(some);
    const std::uint64_t seed = random_.next();
    in_parallel(threads_, some, [&](std::size_t k) {
      Random random{seed + k * 0x2545f4914f6cdd1dull};
      // Of a few bare samples the one with most to gain.
      double most = 0;
      Move move;
      for (int turn = 0; turn < 4; ++turn) {
        find_best(move, std::size_t(targets[random.below(targets.size())]), candidates, random);
        const double now = move.in ? gain(move.after, kNone) : 0;
        if (now > most) most = now, std::swap(moves[k], move);
      }
    });
    int now = 0;
    for (const Move& move : moves) {
      if (!move.in || gain(move.after, kNone) <= 0) continue;
      balls_.push_back(*move.in);
      enter(std::int32_t(balls_.size()) - 1, move.after);
      ++now;
    }
    if (!now) break;
    added += now;
  }
  return added;
}

}  // namespace palmar
