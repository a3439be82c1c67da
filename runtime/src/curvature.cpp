#include "curvature.h"

#include "gap.h"

namespace palmar {

namespace {

constexpr int kOfLink = kPalmVariables + kFingerVariables;

// One variable of a pose: it turns what comes after it about an axis, and carries the sphere's centre, as if that hung
// on the link, along `way`.
struct Motion {
  Vec3 turn, way;
};

}  // namespace

// Seen from the link, a change x moves the sphere's centre o to y(x) = o - sum way_v x_v + ..., with the second
// derivatives turn_b x way_a for a variable a that comes before b in the chain palm, abduction, flexions. The gap is
// the distance of y from a surface of balls, so
//   d2 gap / da db = way_a' D way_b - n . (turn_b x way_a),
// D = (I - n n' - e e') / |o - axis|, n from the centre to the axis point, e along the side where it is straight.
GapShape gap_shape(const HandModel& hand, const HandPlacement& at, int link, std::uint32_t palm_sphere,
                   const Sphere& sphere) {
  const Vec3& o = sphere.center;
  Motion motion[kOfLink];
  for (int k = 0; k < 3; ++k) {
    const Vec3 axis = Vec3::Unit(k);
    motion[k] = {Vec3::Zero(), axis};
    motion[3 + k] = {axis, axis.cross(o - at.position)};
  }
  int count = kPalmVariables;
  Vec3 away, straight = Vec3::Zero();
  double radius;
  const int finger = (link - 1) / kPhalanges, phalanx = (link - 1) % kPhalanges;
  if (link == 0) {
    away = at.rotation * hand.palm[palm_sphere].center + at.position - o;
    radius = hand.palm[palm_sphere].radius;
  } else {
    const Capsule& c = at.phalanx[link - 1];
    const CapsuleGap side = capsule_sphere_gap(c, o, sphere.radius);
    const Vec3 axis_point = side.axis, along = c.c2 - c.c1;
    away = axis_point - o;
    radius = side.radius;
    // On the side, not on one of the two balls at the ends.
    if (axis_point != c.c1 && (axis_point - c.c1).squaredNorm() < (1 - 1e-12) * along.squaredNorm()) straight = along;
    const auto add = [&](const Vec3& axis, const Vec3& joint) { motion[count++] = {axis, axis.cross(o - joint)}; };
    add(at.abduction_axis[finger], at.joint[finger][0]);
    for (int j = 0; j <= phalanx; ++j) add(at.flexion_axis[finger][j], at.joint[finger][j]);
  }
  GapShape shape;
  shape.finger = link == 0 ? -1 : finger;
  shape.count = count;
  const double distance = away.norm();
  shape.gap = distance - radius - sphere.radius;
  const Vec3 n = distance > 0 ? Vec3(away / distance) : Vec3(0, 0, 1);
  straight -= straight.dot(n) * n;
  const double length = straight.norm();
  if (length > 0) straight /= length;
  const double flat = distance > 0 ? 1 / distance : 0.0;

  for (int a = 0; a < count; ++a) {
    const Vec3& way = motion[a].way;
    shape.slope[a] = way.dot(n);
    const Vec3 across = flat * (way - shape.slope[a] * n - way.dot(straight) * straight);
    const Vec3 turning = way.cross(n);  // n . (turn_b x way_a) = turn_b . (way_a x n)
    for (int b = a; b < count; ++b) shape.bend[a][b] = across.dot(motion[b].way) - motion[b].turn.dot(turning);
  }
  // The palm turns about one vector, not about three axes one after the other.
  for (int a = 3; a < kPalmVariables; ++a)
    for (int b = a + 1; b < kPalmVariables; ++b)
      shape.bend[a][b] +=
          0.5 * (motion[b].turn.dot(motion[a].way.cross(n)) - motion[a].turn.dot(motion[b].way.cross(n)));
  return shape;
}

void add_shape(const GapShape& s, double bend_factor, double slope_factor, ArrowMatrix& h) {
  const auto value = [&](int a, int b) { return bend_factor * s.bend[a][b] + slope_factor * s.slope[a] * s.slope[b]; };
  for (int a = 0; a < kPalmVariables; ++a)
    for (int b = a; b < kPalmVariables; ++b) h.palm[b][a] += value(a, b);
  if (s.finger < 0) return;
  auto& across = h.across[s.finger];
  auto& finger = h.finger[s.finger];
  for (int b = kPalmVariables; b < s.count; ++b) {
    const int k = b - kPalmVariables;
    for (int a = 0; a < kPalmVariables; ++a) across[a][k] += value(a, b);
    for (int a = kPalmVariables; a <= b; ++a) finger[k][a - kPalmVariables] += value(a, b);
  }
}

}  // namespace palmar
