#include "hand.h"

#include <algorithm>

#include "error.h"

namespace palmar {

std::uint32_t links_of(const std::string& parts) {
  if (parts == "none") return 0;
  static const std::string names[] = {"palm", "thumb", "index", "middle", "ring", "little"};
  std::uint32_t links = 0;
  for (std::size_t start = 0; start <= parts.size();) {
    const std::size_t end = std::min(parts.find('+', start), parts.size());
    const auto found = std::find(std::begin(names), std::end(names), parts.substr(start, end - start));
    if (found == std::end(names))
      throw Error("E-CONF-VALUE", "leave_out",
                  "'" + parts + "'; none, or some of palm, thumb, index, middle, ring, little with + between them");
    const int part = int(found - std::begin(names));
    links |= part == 0 ? 1u : 7u << (1 + kPhalanges * (part - 1));
    start = end + 1;
  }
  return links;
}

void HandModel::finish() {
  palm_low = palm_high = palm.front().center;
  reach = 0;
  for (const PalmSphere& s : palm) {
    palm_low = palm_low.cwiseMin(s.center);
    palm_high = palm_high.cwiseMax(s.center);
    reach = std::max(reach, s.center.norm() + s.radius);
  }
  for (Finger& f : finger) {
    for (int j = 0; j < kPhalanges; ++j) {
      double stretched = 0;
      for (int k = j; k < kPhalanges; ++k) {
        const Capsule& c = f.phalanx[k];
        f.lever[j][k] = stretched + std::max((c.c1 - f.joint[k]).norm(), (c.c2 - f.joint[k]).norm());
        if (k + 1 < kPhalanges) stretched += (f.joint[k + 1] - f.joint[k]).norm();
      }
    }
    // A chain stretched to its full length, plus how far the last shape stands off its joint.
    double chain = f.joint[0].norm();
    for (int j = 0; j < kPhalanges; ++j) {
      const Capsule& c = f.phalanx[j];
      const double ends = std::max((c.c1 - f.joint[j]).norm() + c.r1, (c.c2 - f.joint[j]).norm() + c.r2);
      reach = std::max(reach, chain + ends);
      if (j + 1 < kPhalanges) chain += (f.joint[j + 1] - f.joint[j]).norm();
    }
  }
}

Capsule capsule_of_frustum(const Vec3& d, const Vec3& e, double r1, double r2) {
  const double length = (e - d).norm();
  const double tan_phi = (r1 - r2) / length;
  const double inv_cos_phi = std::sqrt(1.0 + tan_phi * tan_phi);
  const Vec3 u = (e - d) / length;
  return {d - r1 * tan_phi * u, e - r2 * tan_phi * u, r1 * inv_cos_phi, r2 * inv_cos_phi};
}

Configuration to_configuration(const HandPose& pose) {
  Configuration q;
  q.position = to_vec3(pose.palm.position_m);
  q.rotation = to_quat(pose.palm.rotation_wxyz);
  q.abduction = pose.abduction_rad;
  for (int f = 0; f < kFingers; ++f)
    for (int j = 0; j < kPhalanges; ++j) q.flexion[f][j] = pose.flexion_rad[3 * f + j];
  return q;
}

HandPose to_pose(const Configuration& q) {
  HandPose pose;
  pose.palm.position_m = to_array(q.position);
  pose.palm.rotation_wxyz = to_array(q.rotation);
  pose.abduction_rad = q.abduction;
  for (int f = 0; f < kFingers; ++f)
    for (int j = 0; j < kPhalanges; ++j) pose.flexion_rad[3 * f + j] = q.flexion[f][j];
  return pose;
}

Configuration advance(const Configuration& q, const Change& change, double fraction) {
  Configuration y = q;
  y.position += fraction * Vec3(change[0], change[1], change[2]);
  const Vec3 turn = fraction * Vec3(change[3], change[4], change[5]);
  // A turn of exactly zero leaves the quaternion's bits alone, so that a still hand stays still.
  if (turn.squaredNorm() > 0) y.rotation = (rotation_exp(turn) * q.rotation).normalized();
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    y.abduction[f] += fraction * change[v];
    for (int j = 0; j < kPhalanges; ++j) y.flexion[f][j] += fraction * change[v + 1 + j];
  }
  return y;
}

Change difference(const Configuration& target, const Configuration& q) {
  Change d;
  const Vec3 p = target.position - q.position;
  const bool same = target.rotation.coeffs() == q.rotation.coeffs();
  const Vec3 w = same ? Vec3::Zero().eval() : rotation_log(target.rotation * q.rotation.conjugate());
  for (int k = 0; k < 3; ++k) {
    d[k] = p[k];
    d[3 + k] = w[k];
  }
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    d[v] = target.abduction[f] - q.abduction[f];
    for (int j = 0; j < kPhalanges; ++j) d[v + 1 + j] = target.flexion[f][j] - q.flexion[f][j];
  }
  return d;
}

HandPlacement place_hand(const HandModel& hand, const Configuration& q) {
  HandPlacement h;
  h.position = q.position;
  h.rotation = q.rotation.toRotationMatrix();
  for (int f = 0; f < kFingers; ++f) {
    const Finger& finger = hand.finger[f];
    h.abduction_axis[f] = h.rotation * finger.abduction_axis;
    // World point of a zero-pose point x carried by the current link: turn * x + shift.
    Mat3 turn = h.rotation * rotation_about(finger.abduction_axis, q.abduction[f]);
    Vec3 shift = h.rotation * finger.joint[0] + h.position - turn * finger.joint[0];
    for (int j = 0; j < kPhalanges; ++j) {
      const Vec3 joint = turn * finger.joint[j] + shift;
      h.joint[f][j] = joint;
      h.flexion_axis[f][j] = turn * finger.flexion_axis[j];
      turn = turn * rotation_about(finger.flexion_axis[j], q.flexion[f][j]);
      shift = joint - turn * finger.joint[j];
      const Capsule& c = finger.phalanx[j];
      h.phalanx[3 * f + j] = {turn * c.c1 + shift, turn * c.c2 + shift, c.r1, c.r2};
    }
  }
  return h;
}

double link_motion(const HandModel& hand, const HandPlacement& a, const HandPlacement& b, int link) {
  if (link > 0) {
    const Capsule &ca = a.phalanx[link - 1], &cb = b.phalanx[link - 1];
    return std::sqrt(std::max((ca.c1 - cb.c1).squaredNorm(), (ca.c2 - cb.c2).squaredNorm()));
  }
  const Mat3 turn = b.rotation - a.rotation;
  const Vec3 shift = b.position - a.position;
  double most = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3 c((corner & 1) ? hand.palm_high.x() : hand.palm_low.x(),
                 (corner & 2) ? hand.palm_high.y() : hand.palm_low.y(),
                 (corner & 4) ? hand.palm_high.z() : hand.palm_low.z());
    most = std::max(most, (turn * c + shift).squaredNorm());
  }
  return std::sqrt(most);
}

double largest_motion(const HandModel& hand, const HandPlacement& a, const HandPlacement& b) {
  double most = 0;
  for (int link = 0; link < kLinks; ++link) most = std::max(most, link_motion(hand, a, b, link));
  return most;
}

}  // namespace palmar
