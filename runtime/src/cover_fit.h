// Balls inside a solid, moved and exchanged until few samples of its surface lie farther out than a budget.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "algebra.h"
#include "inside_ball.h"
#include "point_tree.h"
#include "random.h"
#include "triangle_tree.h"

namespace palmar {

struct Samples {
  std::vector<Vec3> points, inward;
  std::vector<std::int32_t> faces, zones;  // zone: 0 of the rest, k + 1 of zone k
};

// The gap of a sample is the least of |sample - centre| - held over all balls; in a zone, what of it exceeds the excess
// is divided by the zone's share. It costs 0 up to the budget's low end,
// 1 from its high end on, straight between them. Every search below lowers the sum. Its result depends on the seed but
// not on the number of threads: places are judged in blocks against one state, then taken one by one if still better.
class CoverFit {
 public:
  CoverFit(const TriangleTree& tree, std::vector<Zone> zones, const Samples& samples, std::uint64_t seed, int threads);

  // The first `fixed` balls stay where they are.
  void set_balls(std::vector<InsideBall> balls, int fixed);
  const std::vector<InsideBall>& balls() const { return balls_; }
  // excess: what the balls will be grown by; matters to zones alone.
  void set_budget(double low, double high, double excess);

  // The gap that `share` of the samples of each zone do not exceed, as far as it lies below the budget's high end.
  double quantile(double share) const;
  // Each ball tries `moves` places up to `step` discs away, worse ones too at a temperature (in samples). Returns how
  // many balls moved.
  int polish(double step, int moves, double temperature);
  // Takes balls of little use out and puts them where samples are bare, `trials` times. Returns how many were moved.
  int exchange(int trials, int candidates);
  // Takes the `count` balls of least use out, one at least staying; and those without which no sample costs more.
  void remove(int count);
  void remove_useless();
  // Puts up to `count` balls where samples are most bare. Returns how many.
  int add(int count, int candidates);

 private:
  static constexpr std::int32_t kNone = -1;
  static constexpr int kKept = 6;
  struct Seen {
    std::int32_t ball[kKept];  // those with the least gaps, in order
    float gap[kKept];
  };
  struct Hit {
    std::int32_t sample;
    float gap;
  };
  using Hits = std::vector<Hit>;
  // What a thread proposes: a ball for the one at `out`, and the samples in reach of both, so that whether it is taken
  // costs no more searches.
  struct Move {
    std::int32_t out;
    std::optional<InsideBall> in;
    Hits before, after;
  };
  double cost_of(float gap) const { return gap <= low_ ? 0.0 : gap >= high_ ? 1.0 : (double(gap) - low_) * slope_; }
  float gap_of(std::int32_t sample, float distance, float held) const {
    const float gap = distance - held;
    return gap + (gap - excess_) * stricter_[sample];
  }
  double disc(const InsideBall& ball) const;
  std::optional<InsideBall> ball_at(const Vec3& center, const Closest& found) const;
  std::optional<InsideBall> shot(const Vec3& point, const Vec3& inward, std::int32_t face, double slack,
                                 double start) const;
  void see_all();
  int take_out(int count, bool useless);
  // The samples whose gap to the ball is less than what is kept, in their order.
  void reach(const InsideBall& ball, Hits& hits, std::int32_t part = 0) const;
  void enter(std::int32_t ball, const Hits& hits);
  void leave(std::int32_t ball, const Hits& hits);
  double gain(const Hits& hits, std::int32_t without) const;  // what a ball with these would save
  double loss(std::int32_t ball, const Hits& hits) const;
  std::vector<double> losses() const;
  Vec3 pull(std::int32_t ball, const Hits& hits) const;
  std::optional<InsideBall> moved(const InsideBall& ball, const Vec3& shift, Random& random) const;
  void walk(Move& move, double step, int moves, double temperature, Random random) const;
  void find_best(Move& move, std::size_t sample, int candidates, Random& random) const;
  std::vector<std::int32_t> bare() const;
  // work(run, first, last) for each of a few runs of the samples, whose number is the same for any number of threads.
  void in_runs(const std::function<void(std::size_t, std::size_t, std::size_t)>& work) const;

  const TriangleTree& tree_;
  std::vector<Zone> zones_;
  PointTree samples_;
  std::vector<Vec3> points_, inward_;
  std::vector<std::int32_t> faces_, zone_;
  std::vector<float> stricter_;  // of each sample: 1 / share - 1
  std::vector<InsideBall> balls_;
  std::size_t fixed_ = 0;
  std::vector<Seen> seen_;
  std::vector<float> complete_;  // of each sample: every ball with a gap below this stands in its list
  int threads_;
  double low_ = 0, high_ = 0, slope_ = 0, budget_ = 0;
  double kept_ = 0;  // gaps up to this stand in lists: a little more than the high end, which moves
  float excess_ = 0;
  Random random_;
};

}  // namespace palmar
