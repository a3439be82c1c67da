// How balls of a CoverFit move, change places, come and go.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "cover_fit.h"
#include "parallel.h"

namespace palmar {
namespace {

constexpr std::size_t kBlock = 48;  // places judged against one state, or a share of many balls
constexpr std::size_t kBlockShare = 64;
constexpr double kSlack = 0.4;  // of the budget: what may enter a ball that passes over dents and facets

}  // namespace

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
