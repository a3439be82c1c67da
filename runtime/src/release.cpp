#include "release.h"

#include <algorithm>

namespace palmar {

namespace {

constexpr double kArrived = 1e-3;  // metres between the palms
constexpr double kSpeed = 1.5;     // m/s along the way: around a 100 mm object in well under a second
constexpr double kStall = 0.1;     // s without following, and another direction is tried
constexpr double kFollowed = 0.1;  // share of the asked motion that counts as following

// Ways off the object: from its centre, out of it wrist first, by the back of the hand, palm first.
constexpr int kDirections = 4;

Vec3 way_off(const Configuration& graphic, const CollisionObject& object, int direction) {
  const Vec3 out = graphic.position - object.center;
  switch (direction) {
    case 1:
      return graphic.rotation * Vec3(0, -1, 0);
    case 2:
      return graphic.rotation * Vec3(0, 0, 1);
    case 3:
      return graphic.rotation * Vec3(0, 0, -1);
    default:
      return out.norm() > 0 ? Vec3(out.normalized()) : Vec3(0, 0, 1);
  }
}

Configuration opened(const HandModel& hand, Configuration q) {
  for (int f = 0; f < kFingers; ++f)
    for (int j = 0; j < kPhalanges; ++j) {
      const auto& limit = hand.finger[f].flexion_limit[j];
      q.flexion[f][j] = std::clamp(0.0, limit[0], limit[1]);
    }
  return q;
}

// `from` turned towards `to` about the centre by at most `angle`.
Vec3 turned(const Vec3& from, const Vec3& to, double angle) {
  const double cosine = std::clamp(from.dot(to), -1.0, 1.0);
  const double between = arc_tangent(std::sqrt((1 - cosine) * (1 + cosine)), cosine);
  if (between <= angle) return to;
  Vec3 axis = from.cross(to);
  // Opposite sides: every way round is as long.
  axis = axis.norm() > 1e-9 ? Vec3(axis.normalized()) : Vec3(from.unitOrthogonal());
  return rotation_about(axis, angle) * from;
}

}  // namespace

Configuration Release::aim(const ReleaseRule& rule, const HandModel& hand, const CollisionObject& object,
                           const Configuration& haptic, const Configuration& graphic, bool left_behind, double dt_s) {
  if (!left_behind || (haptic.position - graphic.position).norm() <= kArrived) {
    *this = {};
    return haptic;
  }
  if (stage_ == Stage::failed) return haptic;
  if (stage_ == Stage::none) {
    waited_s_ += dt_s;
    if (waited_s_ < rule.after_s) return haptic;
    stage_ = Stage::off;
    before_ = graphic.position;
  }
  const double step = kSpeed * dt_s;
  const bool followed = (graphic.position - before_).norm() > kFollowed * step;
  stalled_s_ = followed ? 0 : stalled_s_ + dt_s;
  before_ = graphic.position;

  const Vec3 from_center = graphic.position - object.center;
  const double around = object.radius + hand.reach;  // from here on nothing of the hand can touch
  if (stage_ == Stage::off && from_center.norm() >= around) stage_ = Stage::around, stalled_s_ = 0;
  if (stage_ == Stage::off) {
    if (stalled_s_ > kStall) direction_ = (direction_ + 1) % kDirections, stalled_s_ = 0;
    Configuration aim = opened(hand, graphic);
    aim.position = graphic.position + step * way_off(graphic, object, direction_);
    return aim;
  }

  const Vec3 to_haptic = haptic.position - object.center;
  const Vec3 side = to_haptic.norm() > 0 ? Vec3(to_haptic.normalized()) : Vec3(from_center.normalized());
  Configuration aim = haptic;
  if (stage_ == Stage::around) {
    const double distance = std::max(around, from_center.norm());
    const Vec3 next = turned(from_center.normalized(), side, step / distance);
    if (next == side) stage_ = Stage::towards;
    aim.position = object.center + distance * next;
    const Vec3 turn = rotation_log(haptic.rotation * graphic.rotation.conjugate());
    const double most = step / hand.reach;
    if (turn.norm() > most) aim.rotation = (rotation_exp(most / turn.norm() * turn) * graphic.rotation).normalized();
    return aim;
  }
  if (stalled_s_ > kStall) {
    stage_ = Stage::failed;
    return haptic;
  }
  const Vec3 way = haptic.position - graphic.position;
  if (way.norm() > step) aim.position = graphic.position + step / way.norm() * way;
  return aim;
}

}  // namespace palmar
