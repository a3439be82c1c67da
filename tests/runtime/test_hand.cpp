#include "check.h"
#include "made_hand.h"

using namespace palmar;

int main() {
  const HandModel hand = made::hand();
  std::mt19937 rng(1);
  std::uniform_real_distribution<double> u(-1, 1);

  // The zero pose is the model itself.
  const HandPlacement rest = place_hand(hand, Configuration{});
  for (int f = 0; f < kFingers; ++f)
    for (int j = 0; j < kPhalanges; ++j) {
      CHECK_NEAR((rest.phalanx[3 * f + j].c1 - hand.finger[f].phalanx[j].c1).norm(), 0, 1e-16);
      CHECK_NEAR((rest.joint[f][j] - hand.finger[f].joint[j]).norm(), 0, 1e-16);
    }

  for (int trial = 0; trial < 200; ++trial) {
    const Configuration a = made::random_configuration(rng, 0.1), b = made::random_configuration(rng, 0.1);

    // difference and advance undo each other.
    const Configuration c = advance(a, difference(b, a), 1.0);
    CHECK_NEAR((c.position - b.position).norm(), 0, 1e-15);
    CHECK_NEAR(c.rotation.angularDistance(b.rotation), 0, 1e-7);  // rad; acos near 1 keeps half the digits
    for (int f = 0; f < kFingers; ++f) CHECK_NEAR(c.flexion[f][1], b.flexion[f][1], 1e-15);

    // Phalanges keep their lengths and joints stay joined.
    const HandPlacement at = place_hand(hand, a), bt = place_hand(hand, b);
    for (int f = 0; f < kFingers; ++f)
      for (int j = 0; j + 1 < kPhalanges; ++j)
        CHECK_NEAR((at.joint[f][j + 1] - at.joint[f][j]).norm(),
                   (hand.finger[f].joint[j + 1] - hand.finger[f].joint[j]).norm(), 1e-15);

    // link_motion bounds the motion of every point of the link: points of the axis, palm spheres' centres.
    for (int link = 1; link < kLinks; ++link) {
      const double most = link_motion(hand, at, bt, link);
      const Capsule &ca = at.phalanx[link - 1], &cb = bt.phalanx[link - 1];
      for (double s = 0; s <= 1; s += 0.125)
        CHECK((ca.c1 + s * (ca.c2 - ca.c1) - cb.c1 - s * (cb.c2 - cb.c1)).norm() <= most + 1e-15);
    }
    const double palm_most = link_motion(hand, at, bt, 0);
    for (const PalmSphere& s : hand.palm)
      CHECK((at.rotation * s.center + at.position - bt.rotation * s.center - bt.position).norm() <= palm_most + 1e-15);

    // No point is farther from the palm's origin than the reach.
    for (const Capsule& c2 : at.phalanx) {
      CHECK((c2.c1 - at.position).norm() + c2.r1 <= hand.reach + 1e-12);
      CHECK((c2.c2 - at.position).norm() + c2.r2 <= hand.reach + 1e-12);
    }
  }

  // The tapered capsule touches the frustum's side: at distance r along the rim's normal, for both rims.
  for (int trial = 0; trial < 100; ++trial) {
    const double r1 = 0.008 + 0.003 * u(rng), r2 = 0.006 + 0.003 * u(rng), length = 0.03;
    const Capsule c = capsule_of_frustum(Vec3(0, 0, 0), Vec3(length, 0, 0), r1, r2);
    const double tan_phi = (r1 - r2) / length, cos_phi = 1 / std::sqrt(1 + tan_phi * tan_phi);
    // Distance from a sphere's centre to the side line y = r1 - x tan(phi) equals its radius.
    CHECK_NEAR((r1 - c.c1.x() * tan_phi) * cos_phi, c.r1, 1e-15);
    CHECK_NEAR((r1 - c.c2.x() * tan_phi) * cos_phi, c.r2, 1e-15);
    // and the touching point is the rim itself.
    CHECK_NEAR((c.c1 - Vec3(0, r1, 0)).norm(), c.r1, 1e-15);
    CHECK_NEAR((c.c2 - Vec3(length, r2, 0)).norm(), c.r2, 1e-15);
  }
  return finish();
}
