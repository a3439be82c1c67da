#include "search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace palmar {

namespace {

constexpr double kNever = 1e6;  // metres: no link goes so far from where its list was made

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

// The box around a group's centres, rounded by its largest radius.
BoxQuery box_of(const PalmGroups::Group& group, const HandPlacement& at) {
  const Vec3 half = 0.5 * (group.high - group.low);
  const Vec3 middle = at.rotation * (0.5 * (group.low + group.high)) + at.position;
  BoxQuery box;
  box.cx = float(middle.x()), box.cy = float(middle.y()), box.cz = float(middle.z());
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) box.m[3 * i + k] = float(at.rotation(k, i));
  box.hx = float(half.x()), box.hy = float(half.y()), box.hz = float(half.z());
  box.radius = float(group.radius + query_rounding(middle, half.norm() + group.radius));
  return box;
}

// Branch and bound, nearest first. Every gap here is a lower bound of the true one, to float rounding, and `limit` the
// least of what was left out so far: what is not nearer than that need not be looked at.
struct Search {
  const WideTree& tree;
  Candidates& out;
  const SearchLimits& limits;
  float limit;
  std::uint32_t operations = 0;
  int pairs = 0, nodes = 0;
  bool stopped = false;  // by the operations

  static bool later(const Candidates::Node& a, const Candidates::Node& b) {
    if (a.gap != b.gap) return a.gap > b.gap;
    return a.group != b.group ? a.group > b.group : a.node > b.node;
  }
  static bool nearer(const Candidates::Near& a, const Candidates::Near& b) {
    if (a.gap != b.gap) return a.gap < b.gap;
    if (a.object_sphere != b.object_sphere) return a.object_sphere < b.object_sphere;
    return a.palm_sphere < b.palm_sphere;
  }

  void add_node(float gap, std::int32_t node, std::uint32_t group) {
    if (nodes == int(out.nodes.size())) {
      limit = std::min(limit, gap);
      return;
    }
    out.nodes[nodes++] = {gap, std::uint32_t(node), group};
    std::push_heap(out.nodes.begin(), out.nodes.begin() + nodes, later);
  }

  // Keeps the `most` nearest pairs; the next one's gap is the limit.
  void keep(int most) {
    std::nth_element(out.near.begin(), out.near.begin() + most, out.near.begin() + pairs, nearer);
    limit = std::min(limit, out.near[most].gap);
    pairs = most;
  }

  void drop_beyond_limit() {
    const auto end = std::remove_if(out.near.begin(), out.near.begin() + pairs,
                                    [&](const Candidates::Near& n) { return n.gap >= limit; });
    pairs = int(end - out.near.begin());
  }

  void make_room() {
    const float least = float(limits.least_margin);
    if (pairs >= 2 * limits.enough && limit > least) {
      std::nth_element(out.near.begin(), out.near.begin() + limits.enough, out.near.begin() + pairs, nearer);
      limit = std::min(limit, std::max(least, out.near[limits.enough].gap));
      drop_beyond_limit();
    }
    if (pairs == int(out.near.size())) keep(out.per_link);
  }

  void add_pair(float gap, std::uint32_t object_sphere, std::uint32_t palm_sphere) {
    if (!(gap < limit)) return;
    out.near[pairs++] = {gap, object_sphere, palm_sphere};
    if (pairs >= 2 * limits.enough || pairs == int(out.near.size())) make_room();
  }

  // Looks into nodes until the rest is farther than the limit, or the operations are used up. `look` gives the gaps of
  // a node's children; `meet` one child's, closer, and adds the pairs of a sphere.
  template <class Look, class Meet>
  void run(const Look& look, const Meet& meet) {
    alignas(64) float gap[kWide];
    while (nodes > 0 && out.nodes[0].gap < limit) {
      if (operations >= limits.operations) {
        stopped = true;
        break;
      }
      const Candidates::Node next = out.nodes[0];
      std::pop_heap(out.nodes.begin(), out.nodes.begin() + nodes--, later);
      const WideNode& node = tree.node(std::int32_t(next.node));
      const WideSlabs* const slabs = tree.slabs(std::int32_t(next.node));
      look(node, slabs, next.group, gap);
      operations += kNodeOperations;
      int hit[kWide], hits = 0;
      for (int i = 0; i < kWide; ++i) {
        hit[hits] = i;
        hits += gap[i] < limit;
      }
      for (int h = 0; h < hits; ++h) {
        const int i = hit[h];
        const float least = meet(node, slabs, i, next.group, gap[i]);
        if (node.child[i] >= 0 && least < limit) add_node(least, node.child[i], next.group);
      }
      operations += std::uint32_t(hits);
    }
  }

  // Up to where everything is known.
  float known() const { return stopped ? std::min(limit, out.nodes[0].gap) : limit; }

  void finish() {
    limit = known();
    if (pairs > out.per_link) keep(out.per_link);
    drop_beyond_limit();
  }
};

bool same_place(const HandPlacement& a, const HandPlacement& b, int link) {
  if (link == 0) return a.position == b.position && a.rotation == b.rotation;
  return a.phalanx[link - 1].c1 == b.phalanx[link - 1].c1 && a.phalanx[link - 1].c2 == b.phalanx[link - 1].c2;
}

// Pairs of palm and object: the tree against each group of the palm's spheres.
void find_palm(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
               Search& search) {
  const Mat3 to_palm = at.rotation.transpose();
  WideFrame frame;
  for (int k = 0; k < 9; ++k) frame.m[k] = float(to_palm(k / 3, k % 3));
  frame.px = float(at.position.x()), frame.py = float(at.position.y()), frame.pz = float(at.position.z());
  // Turned in single precision: twice as many roundings as a query has.
  const double size = object.radius + object.center.cwiseAbs().maxCoeff() + hand.reach;
  frame.rounding = float(2 * query_rounding(at.position, size));

  alignas(64) float pair[kWide * kWide];
  search.run(
      [&](const WideNode& node, const WideSlabs* slabs, std::uint32_t g, float* gap) {
        const PalmGroups::Group& group = palm.groups[g];
        if (slabs == nullptr) {
          // Spheres only: all against the group's sixteen at once.
          pair_gaps(node, frame, group.node, group.count, pair, gap);
          search.operations += 3 * kNodeOperations;
          return;
        }
        const BoxQuery box = box_of(group, at);
        node_gaps(node, box, gap);
        slab_gaps(node, *slabs, box, gap);
      },
      [&](const WideNode& node, const WideSlabs* slabs, int i, std::uint32_t g, float least) {
        const PalmGroups::Group& group = palm.groups[g];
        const float* gap = pair + i;
        int stride = kWide;
        alignas(64) float own[kWide];
        if (slabs != nullptr) {
          // A ball of the tree against the group's sixteen, and its slab.
          const Vec3 c = to_palm * (Vec3(node.x[i], node.y[i], node.z[i]) - at.position);
          const double rounding = query_rounding(c, node.r[i] + hand.reach);
          SlabBall ball{};
          ball.x = float(c.x()), ball.y = float(c.y()), ball.z = float(c.z());
          ball.radius = ball.sphere_radius = float(node.r[i] + rounding);
          if (node.child[i] >= 0) {
            const Vec3 n = to_palm * Vec3(slabs->nx[i], slabs->ny[i], slabs->nz[i]);
            ball.nx = float(n.x()), ball.ny = float(n.y()), ball.nz = float(n.z());
            ball.up = slabs->up[i] - slabs->radius[i], ball.down = slabs->down[i] - slabs->radius[i];
            ball.across = slabs->across[i];
            ball.sphere_radius = float(slabs->radius[i] + rounding);
          }
          ball_gaps(group.node, ball, own);
          search.operations += kNodeOperations;
          least = *std::min_element(own, own + group.count);
          gap = own;
          stride = 1;
        }
        if (node.child[i] < 0)
          for (int k = 0; k < group.count; ++k)
            search.add_pair(gap[stride * k], std::uint32_t(~node.child[i]), group.sphere[k]);
        return least;
      });
}

}  // namespace

PalmGroups::PalmGroups(const HandModel& hand) {
  std::vector<std::uint32_t> order(hand.palm.size());
  std::iota(order.begin(), order.end(), 0u);
  // As WideTree's: a handful of float operations on coordinates no larger than the hand's reach.
  const double slack = 16.0 * hand.reach * std::numeric_limits<float>::epsilon();
  add_groups(hand, order.data(), order.data() + order.size(), slack, groups);
}

void gather_link(const HandModel& hand, const PalmGroups& palm, const CollisionObject& object, const HandPlacement& at,
                 int link, double margin, Candidates& out, std::uint32_t& operations, const SearchLimits& limits) {
  if (hand.left_out >> link & 1) {
    out.put(hand, object, at, link, 0, kNever);
    return;
  }
  const Candidates::Unfinished begun = out.unfinished;
  const bool resumes = begun.link == link && same_place(begun.at, at, link);
  out.unfinished.link = -1;
  if (resumes) margin = begun.margin;
  const float asked = std::nextafter(float(margin), std::numeric_limits<float>::infinity());
  Search search{object.tree, out, limits, asked};
  if (resumes) {
    search.limit = begun.limit, search.pairs = begun.pairs, search.nodes = begun.nodes;
  } else {
    const std::uint32_t roots = link > 0 ? 1 : std::uint32_t(palm.groups.size());
    search.operations += roots;
    for (std::uint32_t g = 0; g < roots; ++g)
      search.add_node(-std::numeric_limits<float>::infinity(), object.tree.root(), g);
  }
  if (link > 0) {
    const Capsule& c = at.phalanx[link - 1];
    const SphereQuery query = capsule_query(c.c1, c.c2, c.r1, c.r2, 0.0);
    search.run(
        [&](const WideNode& node, const WideSlabs* slabs, std::uint32_t, float* gap) {
          node_gaps(node, query, gap);
          if (slabs != nullptr) slab_gaps(node, *slabs, query, gap);
        },
        [&](const WideNode& node, const WideSlabs*, int i, std::uint32_t, float gap) {
          if (node.child[i] < 0) search.add_pair(gap, std::uint32_t(~node.child[i]), UINT32_MAX);
          return gap;
        });
  } else {
    find_palm(hand, palm, object, at, search);
  }
  operations += search.operations;
  if (search.stopped && search.known() <= 0) {
    out.unfinished = {link, at, margin, search.limit, search.pairs, search.nodes};
    return;
  }
  search.finish();
  const double found = search.limit < asked ? double(search.limit) : margin;
  // A search that ended early may know less than the list that was.
  if (found > room_of(hand, out, at, link)) out.put(hand, object, at, link, search.pairs, found);
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
  for (int link = 1; link < kLinks; ++link) {
    const Capsule& c = at.phalanx[link - 1];
    if (hand.left_out >> link & 1) continue;
    if (enters(capsule_query(c.c1, c.c2, c.r1, c.r2, 0.0),
               [&](const Sphere& s) { return capsule_sphere_gap(c, s.center, s.radius).gap; }))
      return false;
  }
  if (hand.left_out & 1) return true;
  for (const PalmGroups::Group& group : palm.groups) {
    if (object.tree.find(box_of(group, at), found.data(), kTouching, visited) == 0) continue;
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

}  // namespace palmar
