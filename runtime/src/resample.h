// A trace on the uniform grid that replay steps on.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "records.h"

namespace palmar {

enum class ResampleMethod { kHold, kLinear, kPchip };

// A tracked sample as the curves see it. Coordinates: position, then for the hand 15 flexions and 5 abductions.
struct Knot {
  std::size_t sample = 0;  // where in the trace
  double time_s = 0;
  std::array<double, 23> value{}, slope{};
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};
  bool broken = true;  // nothing is interpolated between this knot and the next
  double hold_s = 0;   // so long after it the hand is lost, if nothing has come by then
};

// Methods: "hold" (the last sample at or before), "linear", "pchip" (Fritsch and Carlson 1980, the slopes of
// scipy.interpolate.PchipInterpolator). Rotations turn evenly from knot to knot (slerp, the short way) for both.
//
// Knots are the tracked samples. Between two of them that have an untracked sample between, or lie farther apart than
// hold_s, nothing is interpolated: the earlier one is held, and untracked from the first untracked sample on or after
// hold_s, as a host that waits for the next sample would have it. hold_s is 1.75 of the usual interval between samples,
// so that a jitter of a third of it is no gap, but 0.05 s at least and 0.1 s at most: what is left of the 0.1 s in
// which a lost hand's forces have to be gone is for them to fade. The object's pose is held across its gaps. At the
// time of a sample its values come out exactly. With "linear" and "pchip" a rotation's sign is the nearer to the one
// before, unless the trace lies on the grid as it is: then nothing is changed.
class Resampler {
 public:
  // Throws Error E-CONF for an unknown method or a rate that is not 1 to 100,000 Hz, E-TRACE-EMPTY if no sample is
  // tracked, E-TRACE-TIME if times do not rise or the grid would have over 100 million of them.
  Resampler(const Trace& trace, const std::string& method, double rate_hz);

  double hold_s() const { return hold_s_; }
  std::size_t size() const { return size_; }
  // For i < size(): the sample at first time + i / rate_hz.
  Sample at(std::size_t i) const;

 private:
  ResampleMethod method_;
  double rate_hz_, hold_s_;
  std::size_t size_ = 0;
  std::vector<Sample> samples_;
  std::vector<Knot> hand_, object_;
};

}  // namespace palmar
