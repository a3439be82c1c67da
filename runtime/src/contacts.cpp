#include "contacts.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "wide.h"

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

// The box around a group's centres, rounded by its largest radius and the margin.
BoxQuery box_of(const PalmGroups::Group& group, const HandPlacement& at, double margin) {
  const Vec3 half = 0.5 * (group.high - group.low);
  const Vec3 middle = at.rotation * (0.5 * (group.low + group.high)) + at.position;
  BoxQuery box;
  box.cx = float(middle.x()), box.cy = float(middle.y()), box.cz = float(middle.z());
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) box.m[3 * i + k] = float(at.rotation(k, i));
  box.hx = float(half.x()), box.hy = float(half.y()), box.hz = float(half.z());
  box.radius = float(group.radius + margin + query_rounding(middle, half.norm() + group.radius));
  return box;
}

// Pairs found so far, in out.near; false when there is no more room.
bool add(Candidates& out, int& count, double gap, std::uint32_t object_sphere, std::uint32_t palm_sphere) {
  if (count == int(out.near.size())) return false;
  out.near[count++] = {gap, object_sphere, palm_sphere};
  return true;
}

// A group's pairs, one sphere of the palm after the other: slower, but what a dense object has near one sphere fits.
bool find_each_sphere(const HandModel& hand, const PalmGroups::Group& group, const CollisionObject& object,
                      const HandPlacement& at, double margin, Candidates& out, int& count, std::uint32_t& visited) {
  for (int k = 0; k < group.count; ++k) {
    const PalmSphere& mine = hand.palm[group.sphere[k]];
    const Vec3 center = at.rotation * mine.center + at.position;
    const int found =
        object.tree.find(ball_query(center, mine.radius, margin), out.found.data(), kFoundCapacity, visited);
    if (found > kFoundCapacity) return false;
    visited += std::uint32_t(found);
    for (int i = 0; i < found; ++i) {
      const Sphere& sphere = object.leaves[out.found[i]];
      const double gap = (center - sphere.center).norm() - mine.radius - sphere.radius;
      if (gap <= margin && !add(out, count, gap, out.found[i], group.sphere[k])) return false;
    }
  }
  return true;
}

// The object's spheres near the box of each group, then each against the group's sixteen at once, in the palm's frame.
bool find_palm(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
               double margin, Candidates& out, int& count, std::uint32_t& visited) {
  alignas(64) float excess[kWide];
  for (const PalmGroups::Group& group : palm.groups) {
    const int near = object.tree.find(box_of(group, at, margin), out.found.data(), kFoundCapacity, visited);
    if (near > kFoundCapacity) {
      if (!find_each_sphere(hand, group, object, at, margin, out, count, visited)) return false;
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
        const double gap = (mine.center - in_palm).norm() - mine.radius - sphere.radius;
        if (gap <= margin && !add(out, count, gap, out.found[i], group.sphere[k])) return false;
      }
    }
  }
  return true;
}

bool find_phalanx(const CollisionObject& object, const Capsule& c, double margin, Candidates& out, int& count,
                  std::uint32_t& visited) {
  const int found =
      object.tree.find(capsule_query(c.c1, c.c2, c.r1, c.r2, margin), out.found.data(), kFoundCapacity, visited);
  if (found > kFoundCapacity) return false;
  visited += std::uint32_t(found);
  for (int i = 0; i < found; ++i) {
    const Sphere& sphere = object.leaves[out.found[i]];
    const double gap = capsule_sphere_gap(c, sphere.center, sphere.radius).gap;
    if (gap <= margin && !add(out, count, gap, out.found[i], UINT32_MAX)) return false;
  }
  return true;
}

struct CapsuleLine {
  double x, y, z, ux, uy, uz, length, r1, sin_phi, tan_phi;
};

// capsule_sphere_gap, many at once.
PALMAR_WIDE void capsule_gaps(const CapsuleLine& c, const double* __restrict x, const double* __restrict y,
                              const double* __restrict z, const double* __restrict radius, int count,
                              double* __restrict gap) {
  for (int i = 0; i < count; ++i) {
    const double dx = x[i] - c.x, dy = y[i] - c.y, dz = z[i] - c.z;
    const double t = dx * c.ux + dy * c.uy + dz * c.uz;
    const double off = dx * dx + dy * dy + dz * dz - t * t;
    const double rho = std::sqrt(off > 0.0 ? off : 0.0);
    double s = t - rho * c.tan_phi;
    s = s < c.length ? s : c.length;
    s = s > 0.0 ? s : 0.0;
    const double ax = dx - s * c.ux, ay = dy - s * c.uy, az = dz - s * c.uz;
    gap[i] = std::sqrt(ax * ax + ay * ay + az * az) - (c.r1 - s * c.sin_phi) - radius[i];
  }
}

// Where the object's frame is, seen from the palm.
struct PalmFrame {
  double m[9], px, py, pz;
};

PALMAR_WIDE void palm_gaps(const PalmFrame& f, const double* __restrict x, const double* __restrict y,
                           const double* __restrict z, const double* __restrict radius, const double* __restrict palm_x,
                           const double* __restrict palm_y, const double* __restrict palm_z,
                           const double* __restrict palm_radius, int count, double* __restrict gap) {
  for (int i = 0; i < count; ++i) {
    const double ox = x[i] - f.px, oy = y[i] - f.py, oz = z[i] - f.pz;
    const double dx = f.m[0] * ox + f.m[1] * oy + f.m[2] * oz - palm_x[i];
    const double dy = f.m[3] * ox + f.m[4] * oy + f.m[5] * oz - palm_y[i];
    const double dz = f.m[6] * ox + f.m[7] * oy + f.m[8] * oz - palm_z[i];
    gap[i] = std::sqrt(dx * dx + dy * dy + dz * dz) - palm_radius[i] - radius[i];
  }
}

}  // namespace

double smallest(const double* gap, int count) {
  // Four at a time: each minimum waits for the last one of its own.
  double least[4];
  for (double& l : least) l = std::numeric_limits<double>::infinity();
  int i = 0;
  for (; i + 4 <= count; i += 4)
    for (int k = 0; k < 4; ++k) least[k] = gap[i + k] < least[k] ? gap[i + k] : least[k];
  for (; i < count; ++i) least[0] = std::min(least[0], gap[i]);
  return std::min(std::min(least[0], least[1]), std::min(least[2], least[3]));
}

Candidates::Candidates(int per_link_)
    : per_link(per_link_),
      x(size()),
      y(size()),
      z(size()),
      radius(size()),
      palm_x(per_link),
      palm_y(per_link),
      palm_z(per_link),
      palm_radius(per_link),
      object_sphere(size()),
      palm_sphere(size(), UINT32_MAX),
      found(kFoundCapacity),
      near(kFoundCapacity) {
  forget();
}

void Candidates::forget() {
  count.fill(0);
  margin.fill(-1.0);
}

int Candidates::total() const { return std::accumulate(count.begin(), count.end(), 0); }

PalmGroups::PalmGroups(const HandModel& hand) {
  std::vector<std::uint32_t> order(hand.palm.size());
  std::iota(order.begin(), order.end(), 0u);
  // As WideTree's: a handful of float operations on coordinates no larger than the hand's reach.
  const double slack = 16.0 * hand.reach * std::numeric_limits<float>::epsilon();
  add_groups(hand, order.data(), order.data() + order.size(), slack, groups);
}

void gather_link(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
                 int link, double margin, Candidates& out, std::uint32_t& visited) {
  if (link == 0) {
    out.from.position = at.position;
    out.from.rotation = at.rotation;
  } else {
    out.from.phalanx[link - 1] = at.phalanx[link - 1];
  }
  // Where even the search's own room is too small, it looks less far: a fourth time at a 64th.
  int count = 0;
  bool fits = false;
  for (int k = 0; k < 4 && !fits; ++k) {
    if (k > 0) margin *= 0.25;
    count = 0;
    fits = link == 0 ? find_palm(hand, palm, object, at, margin, out, count, visited)
                     : find_phalanx(object, at.phalanx[link - 1], margin, out, count, visited);
  }
  if (!fits) {
    out.count[link] = 0;
    out.margin[link] = -1.0;
    return;
  }
  if (count > out.per_link) {
    const auto nearer = [](const Candidates::Near& a, const Candidates::Near& b) {
      if (a.gap != b.gap) return a.gap < b.gap;
      if (a.object_sphere != b.object_sphere) return a.object_sphere < b.object_sphere;
      return a.palm_sphere < b.palm_sphere;
    };
    std::nth_element(out.near.begin(), out.near.begin() + out.per_link, out.near.begin() + count, nearer);
    margin = out.near[out.per_link].gap;
    count = out.per_link;
  }
  out.count[link] = count;
  out.margin[link] = margin;
  const int begin = out.begin(link);
  for (int i = 0; i < count; ++i) {
    const Candidates::Near& n = out.near[i];
    const Sphere& sphere = object.leaves[n.object_sphere];
    out.x[begin + i] = sphere.center.x();
    out.y[begin + i] = sphere.center.y();
    out.z[begin + i] = sphere.center.z();
    out.radius[begin + i] = sphere.radius;
    out.object_sphere[begin + i] = n.object_sphere;
    if (link > 0) continue;
    const PalmSphere& mine = hand.palm[n.palm_sphere];
    out.palm_x[i] = mine.center.x();
    out.palm_y[i] = mine.center.y();
    out.palm_z[i] = mine.center.z();
    out.palm_radius[i] = mine.radius;
    out.palm_sphere[i] = n.palm_sphere;
  }
}

bool is_free(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
             std::uint32_t& visited) {
  constexpr int kTouching = 256;
  std::array<std::uint32_t, kTouching> found;
  const auto enters = [&](const SphereQuery& query, const auto& gap_of) {
    const int count = object.tree.find(query, found.data(), kTouching, visited);
    return count > kTouching || std::any_of(found.begin(), found.begin() + count,
                                            [&](std::uint32_t i) { return gap_of(object.leaves[i]) < 0; });
  };
  for (const Capsule& c : at.phalanx)
    if (enters(capsule_query(c.c1, c.c2, c.r1, c.r2, 0.0),
               [&](const Sphere& s) { return capsule_sphere_gap(c, s.center, s.radius).gap; }))
      return false;
  for (const PalmGroups::Group& group : palm.groups) {
    if (object.tree.find(box_of(group, at, 0.0), found.data(), kTouching, visited) == 0) continue;
    for (int k = 0; k < group.count; ++k) {
      const PalmSphere& mine = hand.palm[group.sphere[k]];
      const Vec3 center = at.rotation * mine.center + at.position;
      if (enters(ball_query(center, mine.radius, 0.0),
                 [&](const Sphere& s) { return (center - s.center).norm() - mine.radius - s.radius; }))
        return false;
    }
  }
  return true;
}

double room_of(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link) {
  return candidates.margin[link] < 0 ? -1.0 : candidates.margin[link] - link_motion(hand, candidates.from, at, link);
}

double evaluate_gaps(const HandModel& hand, const Candidates& c, const HandPlacement& at, int link, double* gap) {
  const int begin = c.begin(link), count = c.count[link];
  if (count == 0) return std::numeric_limits<double>::infinity();
  if (link == 0) {
    PalmFrame f;
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) f.m[3 * i + k] = at.rotation(k, i);
    f.px = at.position.x(), f.py = at.position.y(), f.pz = at.position.z();
    palm_gaps(f, c.x.data(), c.y.data(), c.z.data(), c.radius.data(), c.palm_x.data(), c.palm_y.data(), c.palm_z.data(),
              c.palm_radius.data(), count, gap);
  } else {
    const Capsule& p = at.phalanx[link - 1];
    const Vec3 along = p.c2 - p.c1;
    const double length = along.norm();
    const Vec3 u = length > 0 ? Vec3(along / length) : Vec3(1, 0, 0);
    const double sin_phi = length > 0 ? (p.r1 - p.r2) / length : 0.0;
    const double tan_phi = sin_phi / std::sqrt(std::max(1e-12, 1.0 - sin_phi * sin_phi));
    capsule_gaps({p.c1.x(), p.c1.y(), p.c1.z(), u.x(), u.y(), u.z(), length, p.r1, sin_phi, tan_phi}, &c.x[begin],
                 &c.y[begin], &c.z[begin], &c.radius[begin], count, gap + begin);
  }
  return smallest(gap + begin, count);
}

double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap) {
  double least = std::numeric_limits<double>::infinity();
  for (int link = 0; link < kLinks; ++link) least = std::min(least, evaluate_gaps(hand, candidates, at, link, gap));
  return least;
}

bool linearise(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, const double* gap,
               const PerLink& limit, const std::uint8_t* also, double aim, bool push_out, QpRows& rows,
               std::int32_t* row_candidate) {
  rows.count = 0;
  rows.group_start.fill(0);
  bool fits = true;
  // A row more, if the pair wants one; below zero if not.
  const auto next_row = [&](int i, double most) {
    if (gap[i] > most && !(also && also[i])) return -1;
    if (rows.count == rows.capacity) {
      fits = false;
      return -1;
    }
    const double room = gap[i] - aim;
    rows.b[rows.count] = push_out ? -room : -std::max(room, 0.0);
    row_candidate[rows.count] = i;
    return rows.count++;
  };
  const auto put_palm = [&](int row, const Vec3& point, const Vec3& normal) {
    // A turn w of the palm moves a point by w x (point - origin), so its share of the gap is (point - origin) x normal.
    const Vec3 turn = (point - at.position).cross(normal);
    for (int k = 0; k < 3; ++k) {
      rows.g[k][row] = normal[k];
      rows.g[3 + k][row] = turn[k];
    }
  };
  for (int i = candidates.begin(0); i < candidates.end(0); ++i) {
    const int row = next_row(i, limit[0]);
    if (row < 0) continue;
    const Vec3 mine(candidates.palm_x[i], candidates.palm_y[i], candidates.palm_z[i]);
    const Vec3 center = at.rotation * mine + at.position;
    const Vec3 away = center - candidates.center(i);
    const double distance = away.norm();
    put_palm(row, center, distance > 0 ? Vec3(away / distance) : Vec3(0, 0, 1));
  }
  for (int f = 0; f < kFingers; ++f) {
    rows.group_start[f + 1] = rows.count;
    for (int phalanx = 0; phalanx < kPhalanges; ++phalanx) {
      const int link = 1 + kPhalanges * f + phalanx;
      for (int i = candidates.begin(link); i < candidates.end(link); ++i) {
        const int row = next_row(i, limit[link]);
        if (row < 0) continue;
        const CapsuleGap c = capsule_sphere_gap(at.phalanx[link - 1], candidates.center(i), candidates.radius[i]);
        put_palm(row, c.axis, c.normal);
        const auto turn_about = [&](const Vec3& axis, const Vec3& joint) {
          return axis.dot((c.axis - joint).cross(c.normal));
        };
        rows.g[kPalmVariables][row] = turn_about(at.abduction_axis[f], at.joint[f][0]);
        for (int j = 0; j < kPhalanges; ++j)
          rows.g[kPalmVariables + 1 + j][row] = j <= phalanx ? turn_about(at.flexion_axis[f][j], at.joint[f][j]) : 0.0;
      }
    }
  }
  rows.group_start[kFingers + 1] = rows.count;
  return fits;
}

}  // namespace palmar
