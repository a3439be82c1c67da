#include "contacts.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "wide.h"

namespace palmar {

namespace {

constexpr int kNodeRoom = 4096;  // nodes that a search may keep for later

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
      near(2 * per_link),
      nodes(kNodeRoom) {
  forget();
}

void Candidates::forget() {
  count.fill(0);
  margin.fill(-1.0);
  unfinished.link = -1;
}

int Candidates::total() const { return std::accumulate(count.begin(), count.end(), 0); }

void Candidates::put(const HandModel& hand, const CollisionObject& object, const HandPlacement& at, int link, int pairs,
                     double margin_m) {
  if (link == 0) {
    from.position = at.position;
    from.rotation = at.rotation;
  } else {
    from.phalanx[link - 1] = at.phalanx[link - 1];
  }
  count[link] = pairs;
  margin[link] = margin_m;
  const float shells = margin_m > 0 ? float(kShells / margin_m) : 0.0f;
  // Rounded down: a pair may lie in a nearer shell than it need, never in a farther one.
  const auto shell_of = [&](const Near& n) {
    const float k = n.gap * shells * (1.0f - 1e-6f);
    return k > 0.0f ? std::min(int(k), kShells - 1) : 0;
  };
  std::array<int, kShells> next{};
  for (int i = 0; i < pairs; ++i) ++next[shell_of(near[i])];
  for (int k = 0, sum = 0; k < kShells; ++k) {
    const int of_shell = next[k];
    next[k] = begin(link) + sum;
    shell_end[link][k] = sum += of_shell;
  }
  for (int i = 0; i < pairs; ++i) {
    const Near& n = near[i];
    const int to = next[shell_of(n)]++;
    const Sphere& sphere = object.leaves[n.object_sphere];
    x[to] = sphere.center.x();
    y[to] = sphere.center.y();
    z[to] = sphere.center.z();
    radius[to] = sphere.radius;
    object_sphere[to] = n.object_sphere;
    if (link > 0) continue;
    const PalmSphere& mine = hand.palm[n.palm_sphere];
    palm_x[to] = mine.center.x();
    palm_y[to] = mine.center.y();
    palm_z[to] = mine.center.z();
    palm_radius[to] = mine.radius;
    palm_sphere[to] = n.palm_sphere;
  }
}

double room_of(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, int link) {
  return candidates.margin[link] < 0 ? -1.0 : candidates.margin[link] - link_motion(hand, candidates.from, at, link);
}

double evaluate_gaps(const HandModel& hand, const Candidates& c, const HandPlacement& at, int link, double* gap,
                     double look, std::uint32_t& operations) {
  const double infinity = std::numeric_limits<double>::infinity();
  const int begin = c.begin(link);
  if (c.count[link] == 0) return infinity;
  // The shells that may be within sight, or the first one that holds any.
  int count = c.count[link];
  double beyond = infinity;
  if (look < infinity) {
    const double motion = link_motion(hand, c.from, at, link), shell = c.margin[link] / Candidates::kShells;
    int k = int(std::min(std::max(0.0, (motion + look) / shell), double(Candidates::kShells - 1)));
    while (c.shell_end[link][k] == 0) ++k;
    count = c.shell_end[link][k];
    beyond = (k + 1) * shell - motion;
  }
  operations += std::uint32_t(1 + count / 8);
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
  const double least = smallest(gap + begin, count);
  if (count == c.count[link]) return least;
  std::fill(gap + begin + count, gap + c.end(link), beyond);
  return std::min(least, beyond);
}

double evaluate_gaps(const HandModel& hand, const Candidates& candidates, const HandPlacement& at, double* gap) {
  double least = std::numeric_limits<double>::infinity();
  std::uint32_t operations = 0;
  for (int link = 0; link < kLinks; ++link)
    least = std::min(
        least, evaluate_gaps(hand, candidates, at, link, gap, std::numeric_limits<double>::infinity(), operations));
  return least;
}

bool linearise(const Candidates& candidates, const HandPlacement& at, const double* gap, const PerLink& limit,
               const std::uint8_t* also, double aim, bool push_out, QpRows& rows, std::int32_t* row_candidate) {
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
    row_candidate[rows.count] = i;
    return rows.count++;
  };
  const auto put_palm = [&](int row, double here, const Vec3& point, const Vec3& normal) {
    const double room = here - aim;
    rows.b[row] = push_out ? -room : -std::max(room, 0.0);
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
    put_palm(row, distance - candidates.palm_radius[i] - candidates.radius[i], center,
             distance > 0 ? Vec3(away / distance) : Vec3(0, 0, 1));
  }
  for (int f = 0; f < kFingers; ++f) {
    rows.group_start[f + 1] = rows.count;
    for (int phalanx = 0; phalanx < kPhalanges; ++phalanx) {
      const int link = 1 + kPhalanges * f + phalanx;
      for (int i = candidates.begin(link); i < candidates.end(link); ++i) {
        const int row = next_row(i, limit[link]);
        if (row < 0) continue;
        const CapsuleGap c = capsule_sphere_gap(at.phalanx[link - 1], candidates.center(i), candidates.radius[i]);
        put_palm(row, c.gap, c.axis, c.normal);
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
