#include "filter.h"

#include <numbers>

namespace palmar {

namespace {

constexpr double kSpeedCutoff = 1.0;  // Hz, of the speed's own low pass: the paper's value
constexpr double kLever = 0.05;       // metres of palm motion that count as a radian

// Weight of the new value in a first-order low pass: 1 / (1 + tau / dt), tau = 1 / (2 pi cutoff).
double share(double cutoff_hz, double dt_s) { return 1.0 / (1.0 + 1.0 / (2 * std::numbers::pi * cutoff_hz * dt_s)); }

}  // namespace

Configuration filter_pose(const OneEuro& filter, FilterState& state, const Configuration& raw, double dt_s) {
  if (!state.started) {
    state = {};
    state.started = true;
    return state.raw = state.pose = raw;
  }
  const Change moved = difference(raw, state.raw), way = difference(raw, state.pose);
  const double speed_share = share(kSpeedCutoff, dt_s);
  Change move;
  const auto vector = [&](int first, double lever, Vec3& speed) {
    speed += speed_share * (Vec3(moved[first], moved[first + 1], moved[first + 2]) / dt_s - speed);
    const double weight = share(filter.cutoff_hz + filter.beta * speed.norm() / lever, dt_s);
    for (int k = first; k < first + 3; ++k) move[k] = weight * way[k];
  };
  vector(0, kLever, state.palm_speed);
  vector(3, 1.0, state.turn_speed);
  for (int k = kPalmVariables; k < kVariables; ++k) {
    double& speed = state.angle_speed[k - kPalmVariables];
    speed += speed_share * (moved[k] / dt_s - speed);
    move[k] = share(filter.cutoff_hz + filter.beta * std::abs(speed), dt_s) * way[k];
  }
  state.raw = raw;
  return state.pose = advance(state.pose, move, 1.0);
}

}  // namespace palmar
