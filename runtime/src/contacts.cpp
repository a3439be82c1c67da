#include "contacts.h"

#include <algorithm>
#include <limits>
#include <numeric>

namespace palmar {

namespace {

constexpr int kFoundCapacity = 8192;

// Halves a range of palm spheres along its longest side until sixteen or fewer are left.
void add_groups(const HandModel& hand, std::uint32_t* begin, std::uint32_t* end, double slack,
                std::vector<PalmGroups::Group>& groups) {
  PalmGroups::Group group;
  group.low = group.high = hand.palm[*begin].center;
  group.radius = 0;
  group.count = int(std::min<std::ptrdiff_t>(end - begin, kWide));
  for (const std::uint32_t* i = begin; i < end; ++i) {
    group.low = group.low.cwiseMin(hand.palm[*i].center);
    group.high = group.high.cwiseMax(hand.palm[*i].center);
    group.radius = std::max(group.radius, hand.palm[*i].radius);
  }
  if (end - begin > kWide) {
    int axis;
    (group.high - group.low).maxCoeff(&axis);
    std::uint32_t* const middle = begin + (end - begin) / 2;
    std::nth_element(begin, middle, end, [&](std::uint32_t i, std::uint32_t j) {
      const double ci = hand.palm[i].center[axis], cj = hand.palm[j].center[axis];
      return ci < cj || (ci == cj && i < j);
    });
    add_groups(hand, begin, middle, slack, groups);
    add_groups(hand, middle, end, slack, groups);
    return;
  }
  for (int k = 0; k < kWide; ++k) {
    const bool used = k < group.count;
    const PalmSphere& s = hand.palm[used ? begin[k] : *begin];
    group.sphere[k] = used ? begin[k] : 0;
    group.node.x[k] = used ? float(s.center.x()) : 1e9f;  // farther than anything a pack may hold
    group.node.y[k] = float(s.center.y());
    group.node.z[k] = float(s.center.z());
    group.node.r[k] = float(s.radius + slack);
    group.node.child[k] = 0;
  }
  groups.push_back(group);
}

// A group's pairs, one sphere of the palm after the other: slower, but what a dense object has near one sphere fits.
bool gather_each_sphere(const HandModel& hand, const PalmGroups::Group& group, const CollisionObject& object,
                        const HandPlacement& at, double margin, Candidates& out, std::uint32_t& visited) {
  for (int k = 0; k < group.count; ++k) {
    const PalmSphere& mine = hand.palm[group.sphere[k]];
    const Vec3 center = at.rotation * mine.center + at.position;
    const int count =
        object.tree.find(ball_query(center, mine.radius, margin), out.found.data(), kFoundCapacity, visited);
    if (count > kFoundCapacity) return false;
    for (int i = 0; i < count; ++i) {
      const Sphere& sphere = object.leaves[out.found[i]];
      if ((center - sphere.center).norm() - mine.radius - sphere.radius > margin) continue;
      if (out.count == int(out.pairs.size())) return false;
      out.pairs[out.count++] = {sphere.center, sphere.radius, out.found[i], group.sphere[k]};
    }
  }
  return true;
}

// The object's spheres near the box of each group, then each against the group's sixteen at once, in the palm's frame.
bool gather_palm(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
                 double margin, Candidates& out, std::uint32_t& visited) {
  const int capacity = int(out.pairs.size());
  alignas(64) float excess[kWide];
  for (const PalmGroups::Group& group : palm.groups) {
    const Vec3 half = 0.5 * (group.high - group.low);
    const Vec3 middle = at.rotation * (0.5 * (group.low + group.high)) + at.position;
    BoxQuery box;
    box.cx = float(middle.x()), box.cy = float(middle.y()), box.cz = float(middle.z());
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) box.m[3 * i + k] = float(at.rotation(k, i));
    box.hx = float(half.x()), box.hy = float(half.y()), box.hz = float(half.z());
    box.radius = float(group.radius + margin + query_rounding(middle, half.norm() + group.radius));
    const int near = object.tree.find(box, out.found.data(), kFoundCapacity, visited);
    if (near > kFoundCapacity) {
      if (!gather_each_sphere(hand, group, object, at, margin, out, visited)) return false;
      continue;
    }
    visited += std::uint32_t(near);
    for (int i = 0; i < near; ++i) {
      const Sphere& sphere = object.leaves[out.found[i]];
      const Vec3 in_palm = at.rotation.transpose() * (sphere.center - at.position);
      const double rounding = query_rounding(in_palm, sphere.radius + hand.reach);
      ball_excess(group.node, float(in_palm.x()), float(in_palm.y()), float(in_palm.z()),
                  float(sphere.radius + margin + rounding), excess);
      for (int k = 0; k < group.count; ++k) {
        if (excess[k] > 0.0f) continue;
        const PalmSphere& mine = hand.palm[group.sphere[k]];
        if ((mine.center - in_palm).norm() - mine.radius - sphere.radius > margin) continue;
        if (out.count == capacity) return false;
        out.pairs[out.count++] = {sphere.center, sphere.radius, out.found[i], group.sphere[k]};
      }
    }
  }
  return true;
}

}  // namespace

Candidates::Candidates(int capacity) : pairs(capacity), found(kFoundCapacity) {}

PalmGroups::PalmGroups(const HandModel& hand) {
  std::vector<std::uint32_t> order(hand.palm.size());
  std::iota(order.begin(), order.end(), 0u);
  // As WideTree's: a handful of float operations on coordinates no larger than the hand's reach.
  const double slack = 16.0 * hand.reach * std::numeric_limits<float>::epsilon();
  add_groups(hand, order.data(), order.data() + order.size(), slack, groups);
}

bool gather_candidates(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object,
                       const HandPlacement& at, double margin, Candidates& out, std::uint32_t& visited, int first_link,
                       int end_link) {
  const int capacity = int(out.pairs.size());
  out.from = at;
  out.margin = margin;
  out.count = first_link == 0 ? 0 : out.link_start[first_link];
  out.link_start[0] = 0;
  if (first_link == 0 && !gather_palm(hand, palm, object, at, margin, out, visited)) return false;
  std::fill(out.link_start.begin() + std::max(1, first_link), out.link_start.end(), out.count);

  for (int link = std::max(1, first_link); link < end_link; ++link) {
    const Capsule& c = at.phalanx[link - 1];
    const int count =
        object.tree.find(capsule_query(c.c1, c.c2, c.r1, c.r2, margin), out.found.data(), kFoundCapacity, visited);
    if (count > kFoundCapacity) return false;
    for (int i = 0; i < count; ++i) {
      const Sphere& sphere = object.leaves[out.found[i]];
      if (out.count == capacity) return false;
      out.pairs[out.count++] = {sphere.center, sphere.radius, out.found[i], UINT32_MAX};
    }
    out.link_start[link + 1] = out.count;
  }
  std::fill(out.link_start.begin() + end_link, out.link_start.end(), out.count);
  return true;
}

double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap) {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < candidates.link_start[1]; ++i) {
    const Candidates::Pair& p = candidates.pairs[i];
    const PalmSphere& mine = hand.palm[p.palm_sphere];
    gap[i] = (at.rotation * mine.center + at.position - p.center).norm() - mine.radius - p.radius;
    least = std::min(least, gap[i]);
  }
  for (int link = 1; link < kLinks; ++link) {
    const int begin = candidates.link_start[link], end = candidates.link_start[link + 1];
    if (begin == end) continue;
    const Capsule& c = at.phalanx[link - 1];
    for (int i = begin; i < end; ++i) {
      gap[i] = capsule_sphere_gap(c, candidates.pairs[i].center, candidates.pairs[i].radius).gap;
      least = std::min(least, gap[i]);
    }
  }
  return least;
}

bool linearise(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, const double* gap,
               double limit, double aim, bool push_out, QpRows& rows, std::int32_t* row_candidate) {
  rows.count = 0;
  rows.group_start.fill(0);
  const auto put_palm = [&](int row, const Vec3& point, const Vec3& normal) {
    // A turn w of the palm moves a point by w x (point - origin), so its share of the gap is (point - origin) x normal.
    const Vec3 turn = (point - at.position).cross(normal);
    for (int k = 0; k < 3; ++k) {
      rows.g[k][row] = normal[k];
      rows.g[3 + k][row] = turn[k];
    }
  };
  const auto put_bound = [&](int row, double g) {
    const double room = g - aim;
    rows.b[row] = push_out ? -room : -std::max(room, 0.0);
  };
  for (int i = 0; i < candidates.link_start[1]; ++i) {
    if (gap[i] > limit) continue;
    if (rows.count == rows.capacity) return false;
    const Candidates::Pair& p = candidates.pairs[i];
    const Vec3 center = at.rotation * hand.palm[p.palm_sphere].center + at.position;
    const Vec3 away = center - p.center;
    const double distance = away.norm();
    const Vec3 normal = distance > 0 ? Vec3(away / distance) : Vec3(0, 0, 1);
    put_palm(rows.count, center, normal);
    put_bound(rows.count, gap[i]);
    row_candidate[rows.count++] = i;
  }
  for (int f = 0; f < kFingers; ++f) {
    rows.group_start[f + 1] = rows.count;
    for (int phalanx = 0; phalanx < kPhalanges; ++phalanx) {
      const int link = 1 + 3 * f + phalanx;
      for (int i = candidates.link_start[link]; i < candidates.link_start[link + 1]; ++i) {
        if (gap[i] > limit) continue;
        if (rows.count == rows.capacity) return false;
        const CapsuleGap c =
            capsule_sphere_gap(at.phalanx[link - 1], candidates.pairs[i].center, candidates.pairs[i].radius);
        const int row = rows.count++;
        put_palm(row, c.axis, c.normal);
        const auto turn_about = [&](const Vec3& axis, const Vec3& joint) {
          return axis.dot((c.axis - joint).cross(c.normal));
        };
        rows.g[kPalmVariables][row] = turn_about(at.abduction_axis[f], at.joint[f][0]);
        for (int j = 0; j < kPhalanges; ++j)
          rows.g[kPalmVariables + 1 + j][row] = j <= phalanx ? turn_about(at.flexion_axis[f][j], at.joint[f][j]) : 0.0;
        put_bound(row, gap[i]);
        row_candidate[row] = i;
      }
    }
  }
  rows.group_start[kFingers + 1] = rows.count;
  return true;
}

}  // namespace palmar
