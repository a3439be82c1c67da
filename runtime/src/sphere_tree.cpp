#include "sphere_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "wide.h"

namespace palmar {

namespace {

constexpr int kMaxDepth = 16;  // 16^16 spheres
constexpr int kMaxStack = kMaxDepth * (kWide - 1) + 1;

// A ball around balls: centre of their box, then the farthest surface.
Sphere bound_of(const Sphere* spheres, int count) {
  Vec3 low = spheres[0].center, high = low;
  for (int i = 0; i < count; ++i) {
    const Vec3 r = Vec3::Constant(spheres[i].radius);
    low = low.cwiseMin(spheres[i].center - r);
    high = high.cwiseMax(spheres[i].center + r);
  }
  Sphere bound{0.5 * (low + high), 0};
  for (int i = 0; i < count; ++i)
    bound.radius = std::max(bound.radius, (spheres[i].center - bound.center).norm() + spheres[i].radius);
  return bound;
}

// Sets child `i` of a node's slabs: the thinnest way through the centres of `count` spheres, and how far they reach
// along it from the ball's centre.
void set_slab(WideSlabs& slabs, int i, const Vec3& center, const std::uint32_t* first, std::size_t count,
              const std::vector<Sphere>& spheres, double slack) {
  Mat3 spread = Mat3::Zero();
  Vec3 mean = Vec3::Zero();
  for (std::size_t k = 0; k < count; ++k) mean += spheres[first[k]].center / double(count);
  for (std::size_t k = 0; k < count; ++k) {
    const Vec3 d = spheres[first[k]].center - mean;
    spread += d * d.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Mat3> axes(spread);
  // Not longer than one after rounding, so that a distance along it is never too large.
  const Eigen::Vector3f n = ((1 - 1e-6) * axes.eigenvectors().col(0)).cast<float>();
  double up = -std::numeric_limits<double>::infinity(), down = up, across = 0, radius = 0;
  for (std::size_t k = 0; k < count; ++k) {
    const Sphere& s = spheres[first[k]];
    const double along = n.cast<double>().dot(s.center - center);
    up = std::max(up, along + s.radius);
    down = std::max(down, s.radius - along);
    across = std::max(across, (s.center - center - along * n.cast<double>()).norm());
    radius = std::max(radius, s.radius);
  }
  slabs.nx[i] = n.x(), slabs.ny[i] = n.y(), slabs.nz[i] = n.z();
  slabs.up[i] = float(up + slack), slabs.down[i] = float(down + slack);
  slabs.across[i] = float(across + slack), slabs.radius[i] = float(radius + slack);
}

}  // namespace

PALMAR_WIDE void node_gaps(const WideNode& node, const SphereQuery& query, float* __restrict gap) {
  const SphereQuery q = query;  // a copy cannot alias `gap`, or the loop would not be vectorised
  for (int i = 0; i < kWide; ++i) {
    const float dx = node.x[i] - q.x, dy = node.y[i] - q.y, dz = node.z[i] - q.z;
    const float t = dx * q.ux + dy * q.uy + dz * q.uz;
    const float across = dx * dx + dy * dy + dz * dz - t * t;
    const float rho2 = across > 0.0f ? across : 0.0f;
    const float rho = __builtin_sqrtf(rho2);
    float s = t - rho * q.tan_phi;
    s = s > 0.0f ? s : 0.0f;
    s = s < q.length ? s : q.length;
    const float along = t - s;
    gap[i] = __builtin_sqrtf(along * along + rho2) - (q.r1 - s * q.sin_phi) - node.r[i] - q.margin;
  }
}

PALMAR_WIDE void node_gaps(const WideNode& node, const BoxQuery& query, float* __restrict gap) {
  const BoxQuery q = query;
  for (int i = 0; i < kWide; ++i) {
    const float dx = node.x[i] - q.cx, dy = node.y[i] - q.cy, dz = node.z[i] - q.cz;
    const float ax = q.m[0] * dx + q.m[1] * dy + q.m[2] * dz;
    const float ay = q.m[3] * dx + q.m[4] * dy + q.m[5] * dz;
    const float az = q.m[6] * dx + q.m[7] * dy + q.m[8] * dz;
    float ox = __builtin_fabsf(ax) - q.hx;
    float oy = __builtin_fabsf(ay) - q.hy;
    float oz = __builtin_fabsf(az) - q.hz;
    // The positive part without a branch: the compiler splits three conditions into eight paths and vectorises none.
    ox = 0.5f * (ox + __builtin_fabsf(ox));
    oy = 0.5f * (oy + __builtin_fabsf(oy));
    oz = 0.5f * (oz + __builtin_fabsf(oz));
    gap[i] = __builtin_sqrtf(ox * ox + oy * oy + oz * oz) - node.r[i] - q.radius;
  }
}

PALMAR_WIDE void slab_gaps(const WideNode& node, const WideSlabs& slabs, const SphereQuery& query,
                           float* __restrict gap) {
  const SphereQuery q = query;
  const float r2 = q.r1 - q.length * q.sin_phi;
  for (int i = 0; i < kWide; ++i) {
    // The hull of two balls is as far from a plane as the nearer of them.
    const float d1 =
        slabs.nx[i] * (q.x - node.x[i]) + slabs.ny[i] * (q.y - node.y[i]) + slabs.nz[i] * (q.z - node.z[i]);
    const float d2 = d1 + q.length * (slabs.nx[i] * q.ux + slabs.ny[i] * q.uy + slabs.nz[i] * q.uz);
    const float up1 = d1 - q.r1, up2 = d2 - r2, down1 = -d1 - q.r1, down2 = -d2 - r2;
    const float above = (up1 < up2 ? up1 : up2) - slabs.up[i];
    const float below = (down1 < down2 ? down1 : down2) - slabs.down[i];
    const float most = (above > below ? above : below) - q.margin;
    gap[i] = most > gap[i] ? most : gap[i];
  }
}

PALMAR_WIDE void slab_gaps(const WideNode& node, const WideSlabs& slabs, const BoxQuery& query, float* __restrict gap) {
  const BoxQuery q = query;
  for (int i = 0; i < kWide; ++i) {
    const float nx = slabs.nx[i], ny = slabs.ny[i], nz = slabs.nz[i];
    const float d = nx * (q.cx - node.x[i]) + ny * (q.cy - node.y[i]) + nz * (q.cz - node.z[i]);
    const float half = __builtin_fabsf(nx * q.m[0] + ny * q.m[1] + nz * q.m[2]) * q.hx +
                       __builtin_fabsf(nx * q.m[3] + ny * q.m[4] + nz * q.m[5]) * q.hy +
                       __builtin_fabsf(nx * q.m[6] + ny * q.m[7] + nz * q.m[8]) * q.hz;
    const float above = d - slabs.up[i], below = -d - slabs.down[i];
    const float most = (above > below ? above : below) - half - q.radius;
    gap[i] = most > gap[i] ? most : gap[i];
  }
}

PALMAR_WIDE void ball_gaps(const WideNode& node, const SlabBall& ball, float* __restrict gap) {
  const SlabBall b = ball;
  for (int i = 0; i < kWide; ++i) {
    const float dx = node.x[i] - b.x, dy = node.y[i] - b.y, dz = node.z[i] - b.z;
    const float square = dx * dx + dy * dy + dz * dz;
    const float round = __builtin_sqrtf(square) - b.radius;
    const float d = b.nx * dx + b.ny * dy + b.nz * dz;
    const float off = square - d * d;
    const float above = d - b.up, below = -d - b.down;
    const float along = above > below ? above : below;
    const float beside = __builtin_sqrtf(off > 0.0f ? off : 0.0f) - b.across;
    // The positive parts without a branch.
    const float a = 0.5f * (along + __builtin_fabsf(along)), s = 0.5f * (beside + __builtin_fabsf(beside));
    const float flat = __builtin_sqrtf(a * a + s * s) - b.sphere_radius;
    gap[i] = (flat > round ? flat : round) - node.r[i];
  }
}

PALMAR_WIDE void pair_gaps(const WideNode& node, const WideFrame& frame, const WideNode& others, int count,
                           float* __restrict gap, float* __restrict least) {
  const WideFrame f = frame;
  float x[kWide], y[kWide], z[kWide], r[kWide];
  for (int i = 0; i < kWide; ++i) {
    const float ox = node.x[i] - f.px, oy = node.y[i] - f.py, oz = node.z[i] - f.pz;
    x[i] = f.m[0] * ox + f.m[1] * oy + f.m[2] * oz;
    y[i] = f.m[3] * ox + f.m[4] * oy + f.m[5] * oz;
    z[i] = f.m[6] * ox + f.m[7] * oy + f.m[8] * oz;
    r[i] = node.r[i] + f.rounding;
    least[i] = std::numeric_limits<float>::infinity();
  }
  for (int k = 0; k < count; ++k) {
    const float cx = others.x[k], cy = others.y[k], cz = others.z[k], cr = others.r[k];
    float* const row = gap + kWide * k;
    for (int i = 0; i < kWide; ++i) {
      const float dx = x[i] - cx, dy = y[i] - cy, dz = z[i] - cz;
      const float g = __builtin_sqrtf(dx * dx + dy * dy + dz * dz) - (r[i] + cr);
      row[i] = g;
      least[i] = g < least[i] ? g : least[i];
    }
  }
}

double query_rounding(const Vec3& center, double size) {
  return 16.0 * std::numeric_limits<float>::epsilon() * (center.cwiseAbs().maxCoeff() + size);
}

SphereQuery capsule_query(const Vec3& c1, const Vec3& c2, double r1, double r2, double margin) {
  const Vec3 along = c2 - c1;
  const double length = along.norm();
  const Vec3 u = length > 0 ? Vec3(along / length) : Vec3(1, 0, 0);
  const double sin_phi = length > 0 ? (r1 - r2) / length : 0.0;
  const double tan_phi = sin_phi / std::sqrt(std::max(1e-12, 1.0 - sin_phi * sin_phi));
  // The distance off the axis, the root of a difference of squares, keeps fewer digits the thinner the capsule is.
  const double thin = std::max(std::min(r1, r2), 1e-3 * length);
  const double size = length + std::max(r1, r2) + (length > 0 ? length * length / thin : 0.0);
  return {float(c1.x()),
          float(c1.y()),
          float(c1.z()),
          float(u.x()),
          float(u.y()),
          float(u.z()),
          float(length),
          float(r1),
          float(sin_phi),
          float(tan_phi),
          float(margin + query_rounding(c1, size))};
}

SphereQuery ball_query(const Vec3& center, double radius, double margin) {
  return capsule_query(center, center, radius, radius, margin);
}

WideTree::WideTree(const std::vector<Sphere>& spheres) {
  std::vector<std::uint32_t> order(spheres.size());
  std::iota(order.begin(), order.end(), 0u);
  double extent = 0;
  for (const Sphere& s : spheres) extent = std::max(extent, s.center.cwiseAbs().maxCoeff() + s.radius);
  // Coordinates and a handful of sums and one root in float: 16 units in the last place of the largest number is ample.
  slack_ = 16.0 * extent * std::numeric_limits<float>::epsilon();
  Sphere bound;
  root_ = build(order, 0, order.size(), spheres, bound, 1);
}

std::int32_t WideTree::build(std::vector<std::uint32_t>& order, std::size_t begin, std::size_t end,
                             const std::vector<Sphere>& spheres, Sphere& bound, int depth) {
  depth_ = std::max(depth_, depth);
  // As few parts as let every node below be full: a leaf node that holds two spheres costs as much as one with sixteen.
  std::size_t below = 1;
  while (below * kWide < end - begin) below *= kWide;
  const int parts = int((end - begin + below - 1) / below);
  std::array<std::size_t, kWide + 1> cut;
  cut[0] = begin;
  cut[parts] = end;
  // Halves along the longest side, sizes in proportion to the parts that each half is cut into.
  const auto halve = [&](const auto& self, int first, int last) -> void {
    if (last - first < 2) return;
    const int half = first + (last - first) / 2;
    const std::size_t b = cut[first], e = cut[last];
    const std::size_t middle = b + (e - b) * std::size_t(half - first) / std::size_t(last - first);
    Vec3 low = spheres[order[b]].center, high = low;
    for (std::size_t i = b; i < e; ++i) {
      low = low.cwiseMin(spheres[order[i]].center);
      high = high.cwiseMax(spheres[order[i]].center);
    }
    int axis;
    (high - low).maxCoeff(&axis);
    std::nth_element(order.begin() + b, order.begin() + middle, order.begin() + e,
                     [&](std::uint32_t i, std::uint32_t j) {
                       const double ci = spheres[i].center[axis], cj = spheres[j].center[axis];
                       return ci < cj || (ci == cj && i < j);
                     });
    cut[half] = middle;
    self(self, first, half);
    self(self, half, last);
  };
  halve(halve, 0, parts);

  const std::int32_t index = std::int32_t(nodes_.size());
  nodes_.emplace_back();
  slabs_at_.push_back(-1);
  WideNode node;
  WideSlabs slabs;
  for (int p = 0; p < kWide; ++p) {
    slabs.nx[p] = slabs.ny[p] = slabs.nz[p] = 0;
    slabs.across[p] = slabs.radius[p] = 0;
    slabs.up[p] = slabs.down[p] = std::numeric_limits<float>::infinity();
  }
  std::array<Sphere, kWide> part;
  part.fill({Vec3::Zero(), 0});
  int used = 0;
  for (int p = 0; p < parts; ++p) {
    if (cut[p] == cut[p + 1]) continue;
    std::int32_t child;
    if (cut[p + 1] - cut[p] == 1) {
      child = ~std::int32_t(order[cut[p]]);
      part[used] = spheres[order[cut[p]]];
    } else {
      child = build(order, cut[p], cut[p + 1], spheres, part[used], depth + 1);
      set_slab(slabs, used, part[used].center, &order[cut[p]], cut[p + 1] - cut[p], spheres, slack_);
    }
    node.x[used] = float(part[used].center.x());
    node.y[used] = float(part[used].center.y());
    node.z[used] = float(part[used].center.z());
    node.r[used] = float(part[used].radius + slack_);
    node.child[used] = child;
    ++used;
  }
  bound = bound_of(part.data(), used);
  for (int p = used; p < kWide; ++p) {
    node.x[p] = node.y[p] = node.z[p] = 0;
    node.r[p] = -std::numeric_limits<float>::infinity();
    node.child[p] = 0;
  }
  nodes_[index] = node;
  if (std::any_of(node.child, node.child + used, [](std::int32_t child) { return child >= 0; })) {
    slabs_at_[index] = std::int32_t(slabs_.size());
    slabs_.push_back(slabs);
  }
  return index;
}

template <class Query>
int WideTree::find_any(const Query& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const {
  std::int32_t stack[kMaxStack];
  int height = 0, count = 0;
  stack[height++] = root_;
  alignas(64) float gap[kWide];
  while (height > 0) {
    const WideNode& node = nodes_[stack[--height]];
    ++visited;
    node_gaps(node, query, gap);
    for (int i = 0; i < kWide; ++i) {
      if (gap[i] > 0.0f) continue;
      const std::int32_t child = node.child[i];
      if (child >= 0) {
        stack[height++] = child;
      } else {
        if (count == capacity) return capacity + 1;
        out[count++] = std::uint32_t(~child);
      }
    }
  }
  return count;
}

int WideTree::find(const SphereQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const {
  return find_any(query, out, capacity, visited);
}

int WideTree::find(const BoxQuery& query, std::uint32_t* out, int capacity, std::uint32_t& visited) const {
  return find_any(query, out, capacity, visited);
}

}  // namespace palmar
