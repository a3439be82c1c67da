// The input filter: Casiez, Roussel and Vogel, "1 Euro Filter: a simple speed-based low-pass filter for noisy input in
// interactive systems" (CHI 2012). Slow motion is smoothed hard, fast motion lags little.
#pragma once

#include "hand.h"

namespace palmar {

struct OneEuro {
  double cutoff_hz;  // of the low pass at rest
  double beta;       // Hz that the cutoff grows by for each rad/s, or each 50 mm/s of the palm
};

// The last pose as it came and as it was let through, and the filtered speed of each of its parts.
struct FilterState {
  bool started = false;
  Configuration raw, pose;
  Vec3 palm_speed{0, 0, 0}, turn_speed{0, 0, 0};
  std::array<double, kFingers * kFingerVariables> angle_speed{};
};

// `raw` filtered, `dt_s` after the last. The first pose passes as it is; a pose equal to the last one let through stays
// that pose, bit for bit.
Configuration filter_pose(const OneEuro& filter, FilterState& state, const Configuration& raw, double dt_s);

}  // namespace palmar
