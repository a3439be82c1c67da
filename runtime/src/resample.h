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
};

// Methods: "hold" (the last sample at or before), "linear", "pchip" (Fritsch and Carlson 1980, the slopes of
// scipy.interpolate.PchipInterpolator). Rotations turn evenly from knot to knot (slerp, the short way) for both.
//
// Knots are the tracked samples. Between two of them that have an untracked sample between, or lie more than max_gap_s
// apart, nothing is interpolated: the earlier one is held, and untracked from the first untracked sample on or after
// max_gap_s. The object's pose is held across its gaps. At the time of a sample its values come out exactly. With
// "linear" and "pchip" a rotation's sign is the nearer to the one before, unless the trace lies on the grid as it is:
// then nothing is changed.
class Resampler {
 public:
  // Throws Error E-CONF for an unknown method or a rate that is not 1 to 100,000 Hz, E-TRACE-EMPTY if no sample is
  // tracked, E-TRACE-TIME if times do not rise or the grid would have over 100 million of them.
  Resampler(const Trace& trace, const std::string& method, double rate_hz, double max_gap_s = 0.1);

  std::size_t size() const { return size_; }
  // For i < size(): the sample at first time + i / rate_hz.
  Sample at(std::size_t i) const;

 private:
  ResampleMethod method_;
  double rate_hz_, max_gap_s_;
  std::size_t size_ = 0;
  std::vector<Sample> samples_;
  std::vector<Knot> hand_, object_;
};

}  // namespace palmar
