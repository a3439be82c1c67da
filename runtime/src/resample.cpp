#include "resample.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "error.h"
#include "trig.h"

namespace palmar {
namespace {

constexpr double kMaxGrid = 1e8;
constexpr double kHoldIntervals = 1.75, kHoldLeast = 0.05, kHoldMost = 0.1;  // intervals, s, s

using Quaternion = std::array<double, 4>;
using Knots = std::vector<Knot>;

ResampleMethod method_named(const std::string& name) {
  if (name == "hold") return ResampleMethod::kHold;
  if (name == "linear") return ResampleMethod::kLinear;
  if (name == "pchip") return ResampleMethod::kPchip;
  throw Error("E-CONF", "resample", "'" + name + "'; 'hold', 'linear' or 'pchip' is allowed");
}

// Times nearer than this are the same: files hold nanoseconds, and i * 0.001 and i / 1000 differ in their last bits.
double rounding_s(double time_s) { return std::max(1e-9, 4 * std::numeric_limits<double>::epsilon() * time_s); }

int sign(double x) { return (x > 0) - (x < 0); }

// Slope at the end of a curve: of the parabola through three knots, kept monotone. h0, m0: length and slope of the last
// interval.
double end_slope(double h0, double h1, double m0, double m1) {
  const double d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1);
  if (sign(d) != sign(m0)) return 0;
  if (sign(m0) != sign(m1) && std::abs(d) > 3 * std::abs(m0)) return 3 * m0;
  return d;
}

// Slopes of the knots first to last, which no break parts. Inside: the weighted harmonic mean of both sides, 0 at a
// turn.
void set_pchip_slopes(Knots& knots, std::size_t first, std::size_t last) {
  if (first == last) return;
  const auto h = [&](std::size_t k) { return knots[k + 1].time_s - knots[k].time_s; };
  for (std::size_t c = 0; c < knots[first].value.size(); ++c) {
    const auto m = [&](std::size_t k) { return (knots[k + 1].value[c] - knots[k].value[c]) / h(k); };
    if (last == first + 1) {
      knots[first].slope[c] = knots[last].slope[c] = m(first);
      continue;
    }
    knots[first].slope[c] = end_slope(h(first), h(first + 1), m(first), m(first + 1));
    knots[last].slope[c] = end_slope(h(last - 1), h(last - 2), m(last - 1), m(last - 2));
    for (std::size_t k = first + 1; k < last; ++k) {
      const double before = m(k - 1), after = m(k);
      if (sign(before) * sign(after) <= 0) continue;
      const double w1 = 2 * h(k) + h(k - 1), w2 = h(k) + 2 * h(k - 1);
      knots[k].slope[c] = (w1 + w2) / (w1 / before + w2 / after);
    }
  }
}

// The cubic with values y0, y1 and slopes d0, d1 at both ends of an interval h, s after its start.
double hermite(double y0, double y1, double d0, double d1, double h, double s) {
  const double m = (y1 - y0) / h;
  const double t = (d0 + d1 - 2 * m) / h;
  return y0 + s * (d0 + s * ((m - d0) / h - t + s * (t / h)));
}

double dot(const Quaternion& a, const Quaternion& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]; }

Quaternion unit(Quaternion q) {
  const double norm = std::sqrt(dot(q, q));
  for (double& x : q) x /= norm;
  return q;
}

Quaternion negative(const Quaternion& q) { return {-q[0], -q[1], -q[2], -q[3]}; }

// Turns from a (u = 0) to b (u = 1) at even speed, the short way; the sign is that of a.
Quaternion slerp(const Quaternion& from, const Quaternion& to, double u) {
  const Quaternion a = unit(from);
  const Quaternion b = unit(dot(from, to) < 0 ? negative(to) : to);
  double apart = 0, together = 0;
  for (int i = 0; i < 4; ++i) {
    apart += (b[i] - a[i]) * (b[i] - a[i]);
    together += (b[i] + a[i]) * (b[i] + a[i]);
  }
  const double angle = 2 * arc_tangent(std::sqrt(apart), std::sqrt(together));
  // Below 1e-7 rad the sine is the angle to the last bits, and 0 / 0 is near.
  const bool tiny = angle < 1e-7;
  const double wa = tiny ? 1 - u : sine_cosine((1 - u) * angle).sine / sine_cosine(angle).sine;
  const double wb = tiny ? u : sine_cosine(u * angle).sine / sine_cosine(angle).sine;
  Quaternion q;
  for (int i = 0; i < 4; ++i) q[i] = wa * a[i] + wb * b[i];
  return unit(q);
}

Knot make_knot(std::size_t index, double time_s, const Placement& placement) {
  Knot knot;
  knot.sample = index;
  knot.time_s = time_s;
  std::copy(placement.position_m.begin(), placement.position_m.end(), knot.value.begin());
  knot.rotation_wxyz = placement.rotation_wxyz;
  return knot;
}

Knots hand_knots(const std::vector<Sample>& samples) {
  Knots knots;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (!samples[i].tracked) continue;
    Knot knot = make_knot(i, samples[i].time_s, samples[i].pose.palm);
    const auto rest = std::copy_n(samples[i].pose.flexion_rad.begin(), 15, knot.value.begin() + 3);
    std::copy_n(samples[i].pose.abduction_rad.begin(), 5, rest);
    knots.push_back(knot);
  }
  return knots;
}

Knots object_knots(const std::vector<Sample>& samples) {
  Knots knots;
  for (std::size_t i = 0; i < samples.size(); ++i)
    if (samples[i].has_object_pose) knots.push_back(make_knot(i, samples[i].time_s, samples[i].object));
  return knots;
}

// How long a silent device's last sample is held. The usual interval is the median, which gaps do not move.
double hold_for(const std::vector<Sample>& samples) {
  if (samples.size() < 2) return kHoldLeast;
  std::vector<double> apart_s;
  for (std::size_t i = 1; i < samples.size(); ++i) apart_s.push_back(samples[i].time_s - samples[i - 1].time_s);
  const auto middle = apart_s.begin() + static_cast<std::ptrdiff_t>(apart_s.size() / 2);
  std::nth_element(apart_s.begin(), middle, apart_s.end());
  return std::clamp(kHoldIntervals * *middle, kHoldLeast, kHoldMost);
}

void join(Knots& knots, const std::vector<Sample>& samples, ResampleMethod method, double hold_s, bool join_signs) {
  std::size_t first = 0;
  for (std::size_t k = 0; k < knots.size(); ++k) {
    const std::size_t after = knots[k].sample + 1;
    const bool told = after < samples.size() && !samples[after].tracked;
    knots[k].hold_s = told ? std::min(hold_s, samples[after].time_s - knots[k].time_s) : hold_s;
    if (k + 1 < knots.size()) {
      Knot& next = knots[k + 1];
      const double apart_s = next.time_s - knots[k].time_s;
      knots[k].broken = next.sample != knots[k].sample + 1 || apart_s > hold_s + rounding_s(next.time_s);
      if (join_signs && dot(knots[k].rotation_wxyz, next.rotation_wxyz) < 0)
        next.rotation_wxyz = negative(next.rotation_wxyz);
    }
    if (knots[k].broken) {
      if (method == ResampleMethod::kPchip) set_pchip_slopes(knots, first, k);
      first = k + 1;
    }
  }
}

// The last element at or before a time, or `size` if there is none.
template <class Timed>
std::size_t last_until(const std::vector<Timed>& all, double time_s) {
  const auto after = std::upper_bound(all.begin(), all.end(), time_s,
                                      [](double t, const Timed& element) { return t < element.time_s; });
  return after == all.begin() ? all.size() : static_cast<std::size_t>(after - all.begin()) - 1;
}

// The curve at a time: knot k itself, held, or on the way to the next.
Knot evaluate(const Knots& knots, std::size_t k, double time_s, ResampleMethod method) {
  Knot knot = knots[k];
  if (knot.broken || method == ResampleMethod::kHold || time_s == knot.time_s) return knot;
  const Knot& next = knots[k + 1];
  const double h = next.time_s - knot.time_s, s = time_s - knot.time_s;
  for (std::size_t c = 0; c < knot.value.size(); ++c)
    knot.value[c] = method == ResampleMethod::kLinear
                        ? knot.value[c] + (next.value[c] - knot.value[c]) * (s / h)
                        : hermite(knot.value[c], next.value[c], knot.slope[c], next.slope[c], h, s);
  knot.rotation_wxyz = slerp(knot.rotation_wxyz, next.rotation_wxyz, s / h);
  return knot;
}

Placement placement_of(const Knot& knot) { return {{knot.value[0], knot.value[1], knot.value[2]}, knot.rotation_wxyz}; }

}  // namespace

Resampler::Resampler(const Trace& trace, const std::string& method, double rate_hz)
    : method_(method_named(method)), rate_hz_(rate_hz), hold_s_(hold_for(trace.samples)), samples_(trace.samples) {
  if (!(rate_hz >= 1 && rate_hz <= 100'000))
    throw Error("E-CONF", "rate_hz", std::to_string(rate_hz) + "; 1 to 100000 Hz are allowed");
  for (std::size_t i = 1; i < samples_.size(); ++i)
    if (!(samples_[i].time_s > samples_[i - 1].time_s))
      throw Error("E-TRACE-TIME", "sample " + std::to_string(i), "its time does not rise; times must rise");
  hand_ = hand_knots(samples_);
  object_ = object_knots(samples_);
  if (hand_.empty()) throw Error("E-TRACE-EMPTY", "trace", "no sample is tracked; at least one is needed");

  const double end_s = samples_.back().time_s;
  const double steps = std::floor((end_s - samples_.front().time_s + rounding_s(end_s)) * rate_hz) + 1;
  if (steps > kMaxGrid)
    throw Error("E-TRACE-TIME", "trace",
                std::to_string(end_s - samples_.front().time_s) + " s long; at most 100 million steps are replayed");
  size_ = static_cast<std::size_t>(steps);

  bool on_grid = size_ == samples_.size();
  for (std::size_t i = 0; on_grid && i < size_; ++i) {
    const double grid_s = samples_.front().time_s + static_cast<double>(i) / rate_hz;
    on_grid = std::abs(samples_[i].time_s - grid_s) <= rounding_s(grid_s);
  }
  const bool join_signs = method_ != ResampleMethod::kHold && !on_grid;
  join(hand_, samples_, method_, hold_s_, join_signs);
  join(object_, samples_, method_, hold_s_, join_signs);
}

Sample Resampler::at(std::size_t i) const {
  double time_s = samples_.front().time_s + static_cast<double>(i) / rate_hz_;
  Sample sample = samples_[last_until(samples_, time_s + rounding_s(time_s))];
  if (std::abs(sample.time_s - time_s) <= rounding_s(time_s)) time_s = sample.time_s;
  sample.time_s = time_s;

  const std::size_t k = last_until(hand_, time_s);
  const bool before = k == hand_.size();
  const Knot hand = before ? hand_.front() : evaluate(hand_, k, time_s, method_);
  sample.tracked = sample.tracked && !before && time_s - hand.time_s <= hold_s_ + rounding_s(time_s);
  sample.held_s = sample.tracked || before ? 0 : hand.hold_s;
  sample.pose.palm = placement_of(hand);
  std::copy_n(hand.value.begin() + 3, 15, sample.pose.flexion_rad.begin());
  std::copy_n(hand.value.begin() + 18, 5, sample.pose.abduction_rad.begin());

  if (!object_.empty()) {
    const std::size_t m = last_until(object_, time_s);
    sample.has_object_pose = true;
    sample.object = placement_of(m == object_.size() ? object_.front() : evaluate(object_, m, time_s, method_));
  }
  return sample;
}

}  // namespace palmar
