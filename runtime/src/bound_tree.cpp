#include "bound_tree.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <queue>

namespace palmar {
namespace {

constexpr std::int32_t kNone = -1;
constexpr double kEnough = 0.004;  // a round that saves less of the cost is the last
constexpr int kRounds = 12;
constexpr std::size_t kMany = 20'000;  // spheres from which on one round has to do
constexpr int kSteps = 400;            // towards the smallest ball: to a fraction of a percent
// Rounding to float and sums in float move a sphere by at most a few 2^-24 of its place and size.
constexpr double kRounding = 8.0 / (1 << 24);

// The smallest ball around two.
Sphere around(const Sphere& a, const Sphere& b) {
  const Vec3 offset = b.center - a.center;
  const double apart = offset.norm();
  if (apart + b.radius <= a.radius) return a;
  if (apart + a.radius <= b.radius) return b;
  const double radius = 0.5 * (apart + a.radius + b.radius);
  return {a.center + offset * ((radius - a.radius) / apart), radius};
}

// The smallest ball around some, to a fraction of a percent (Badoiu and Clarkson 2003, with balls for points).
Sphere around(const std::vector<Sphere>& balls) {
  if (balls.size() == 2) return around(balls[0], balls[1]);
  Vec3 middle = Vec3::Zero();
  for (const Sphere& ball : balls) middle += ball.center / double(balls.size());
  Sphere best{middle, std::numeric_limits<double>::infinity()};
  for (int step = 2; step < kSteps; ++step) {
    const Sphere* far = nullptr;
    double reach = -1, away = 0;
    for (const Sphere& ball : balls) {
      const double distance = (ball.center - middle).norm();
      if (distance + ball.radius > reach) reach = distance + ball.radius, away = distance, far = &ball;
    }
    if (reach < best.radius) best = {middle, reach};
    if (away == 0) break;
    middle += (far->center - middle) * (reach / away / step);
  }
  return best;
}

// `ball` with a centre that floats hold, grown so that it contains the others in double and in single precision.
Sphere rounded_out(Sphere ball, const std::vector<Sphere>& others) {
  ball.center = ball.center.cast<float>().cast<double>();
  double reach = 0;
  for (const Sphere& other : others) reach = std::max(reach, (other.center - ball.center).norm() + other.radius);
  reach += kRounding * (reach + 2 * ball.center.cwiseAbs().maxCoeff());
  ball.radius = std::nextafter(float(reach), std::numeric_limits<float>::infinity());
  return ball;
}

// A binary tree whose nodes are taken out and put in elsewhere while that lowers the chance that a query meets a node
// (Bittner, Hapala and Havran 2013, for balls), summed. That chance goes as the area in reach of the node's ball.
class Binary {
 public:
  Binary(const std::vector<Sphere>& spheres, double reach) : count_(std::int32_t(spheres.size())), reach_(reach) {
    nodes_.resize(2 * spheres.size() - 1);
    for (std::int32_t k = 0; k < count_; ++k) nodes_[k].ball = spheres[k];
    std::vector<std::int32_t> order(spheres.size());
    std::iota(order.begin(), order.end(), 0);
    next_ = count_;
    root_ = halve(order.data(), order.data() + order.size());
  }

  void improve() {
    const int rounds = std::size_t(count_) < kMany ? kRounds : 1;
    for (int round = 0; round < rounds; ++round) {
      double cost = 0, saved = 0;
      for (std::int32_t k = count_; k < std::int32_t(nodes_.size()); ++k) cost += chance(nodes_[k].ball);
      for (std::int32_t k = 0; k < std::int32_t(nodes_.size()); ++k) saved += reinsert(k);
      if (saved < kEnough * cost) break;
    }
  }

  std::int32_t root() const { return root_; }
  bool is_leaf(std::int32_t k) const { return k < count_; }
  std::array<std::int32_t, 2> children(std::int32_t k) const { return nodes_[k].child; }
  double chance(std::int32_t k) const { return chance(nodes_[k].ball); }
  std::size_t size() const { return nodes_.size(); }

 private:
  struct Node {
    Sphere ball;
    std::int32_t parent = kNone;
    std::array<std::int32_t, 2> child{kNone, kNone};
  };

  double chance(const Sphere& ball) const { return (ball.radius + reach_) * (ball.radius + reach_); }

  std::int32_t halve(std::int32_t* first, std::int32_t* last) {
    if (last - first == 1) return *first;
    Vec3 low = nodes_[*first].ball.center, high = low;
    for (auto at = first; at != last; ++at) {
      low = low.cwiseMin(nodes_[*at].ball.center);
      high = high.cwiseMax(nodes_[*at].ball.center);
    }
    int axis = 0;
    (high - low).maxCoeff(&axis);
    std::int32_t* half = first + (last - first) / 2;
    std::nth_element(first, half, last, [&](std::int32_t i, std::int32_t j) {
      return std::pair(nodes_[i].ball.center[axis], i) < std::pair(nodes_[j].ball.center[axis], j);
    });
    const std::int32_t node = next_++;
    nodes_[node].child = {halve(first, half), halve(half, last)};
    for (const std::int32_t child : nodes_[node].child) nodes_[child].parent = node;
    nodes_[node].ball = around(nodes_[nodes_[node].child[0]].ball, nodes_[nodes_[node].child[1]].ball);
    return node;
  }

  // The balls from a node up to the root anew; returns by how much the cost grows.
  double refit(std::int32_t k) {
    double grown = 0;
    for (; k != kNone; k = nodes_[k].parent) {
      Node& node = nodes_[k];
      const Sphere ball = around(nodes_[node.child[0]].ball, nodes_[node.child[1]].ball);
      grown += chance(ball) - chance(node.ball);
      node.ball = ball;
    }
    return grown;
  }

  void replace(std::int32_t parent, std::int32_t old, std::int32_t fresh) {
    nodes_[fresh].parent = parent;
    if (parent == kNone)
      root_ = fresh;
    else
      nodes_[parent].child[nodes_[parent].child[1] == old] = fresh;
  }

  // Takes `joint` and one child of it out; its other child takes its place.
  double take_out(std::int32_t joint, std::int32_t stays) {
    const double saved = -chance(nodes_[joint].ball);
    const std::int32_t parent = nodes_[joint].parent;
    replace(parent, joint, stays);
    return saved + refit(parent);
  }

  // Puts `joint` in the place of `beside`, which becomes its child again next to `node`.
  double put_in(std::int32_t joint, std::int32_t node, std::int32_t beside) {
    replace(nodes_[beside].parent, beside, joint);
    nodes_[joint].child = {beside, node};
    nodes_[beside].parent = nodes_[node].parent = joint;
    nodes_[joint].ball = around(nodes_[beside].ball, nodes_[node].ball);
    return chance(nodes_[joint].ball) + refit(nodes_[joint].parent);
  }

  // Where the node would cost least, by the balls as they are.
  std::int32_t best_place(std::int32_t k) const {
    using Open = std::pair<double, std::int32_t>;
    std::priority_queue<Open, std::vector<Open>, std::greater<>> open;
    open.push({0, root_});
    const double own = chance(nodes_[k].ball);
    double least = std::numeric_limits<double>::infinity();
    std::int32_t best = root_;
    while (!open.empty()) {
      const auto [induced, at] = open.top();
      open.pop();
      if (induced + own >= least) break;
      const double joint = chance(around(nodes_[at].ball, nodes_[k].ball));
      if (induced + joint < least) least = induced + joint, best = at;
      if (is_leaf(at)) continue;
      const double below = induced + joint - chance(nodes_[at].ball);
      if (below + own < least)
        for (const std::int32_t child : nodes_[at].child) open.push({below, child});
    }
    return best;
  }

  // Returns by how much the cost falls.
  double reinsert(std::int32_t k) {
    const std::int32_t joint = nodes_[k].parent;
    if (joint == kNone || nodes_[joint].parent == kNone) return 0;
    const std::int32_t sibling = nodes_[joint].child[nodes_[joint].child[0] == k];
    double grown = take_out(joint, sibling);
    const std::int32_t place = best_place(k);
    grown += put_in(joint, k, place);
    if (grown < -1e-12 * chance(nodes_[root_].ball)) return -grown;
    take_out(joint, place);
    put_in(joint, k, sibling);
    return 0;
  }

  std::int32_t count_, next_ = 0, root_ = 0;
  double reach_;
  std::vector<Node> nodes_;
};

// Joins binary nodes to nodes of up to kBranches children, so that the expected count of tests is least: each node met
// costs one for each child.
class Joined {
 public:
  explicit Joined(const Binary& tree) : tree_(tree), plans_(tree.size()) { plan(tree.root()); }

  std::vector<std::int32_t> children(std::int32_t node) const {
    std::vector<std::int32_t> found;
    collect(node, plans_[node].count, found);
    return found;
  }

 private:
  struct Plan {
    int count = 0;                           // children of this node
    std::array<double, kBranches + 1> cost;  // least, with so many roots for what is below; 1: itself
    std::array<int, kBranches + 1> left;     // how many of them on the left
  };

  void plan(std::int32_t root) {
    // Children before their parents, without recursion: depth may be large.
    std::vector<std::int32_t> order{root};
    for (std::size_t k = 0; k < order.size(); ++k)
      if (!tree_.is_leaf(order[k]))
        for (const std::int32_t child : tree_.children(order[k])) order.push_back(child);
    for (std::size_t k = order.size(); k-- > 0;) plan_one(order[k]);
  }

  void plan_one(std::int32_t node) {
    Plan& own = plans_[node];
    own.cost.fill(std::numeric_limits<double>::infinity());
    own.left.fill(0);
    if (tree_.is_leaf(node)) {
      own.cost[1] = 0;
      return;
    }
    const auto [left, right] = tree_.children(node);
    for (int i = 1; i < kBranches; ++i) {
      for (int j = 1; i + j <= kBranches; ++j) {
        const double cost = plans_[left].cost[i] + plans_[right].cost[j];
        if (cost < own.cost[i + j]) own.cost[i + j] = cost, own.left[i + j] = i;
      }
    }
    for (int count = 2; count <= kBranches; ++count) {
      const double cost = tree_.chance(node) * count + own.cost[count];
      if (cost < own.cost[1]) own.cost[1] = cost, own.count = count;
    }
  }

  void collect(std::int32_t node, int count, std::vector<std::int32_t>& found) const {
    if (count == 1) {
      found.push_back(node);
      return;
    }
    const auto [left, right] = tree_.children(node);
    collect(left, plans_[node].left[count], found);
    collect(right, count - plans_[node].left[count], found);
  }

  const Binary& tree_;
  std::vector<Plan> plans_;
};

}  // namespace

BoundTree bound_tree(const std::vector<Sphere>& spheres, double reach) {
  BoundTree tree;
  if (spheres.size() == 1) {
    tree.bounds = {rounded_out(spheres[0], spheres)};
    tree.bound_parent = {kNone};
    tree.order = tree.sphere_parent = {0};
    return tree;
  }
  Binary binary(spheres, reach);
  binary.improve();
  const Joined joined(binary);

  // Bounds breadth first, so that siblings stand side by side; spheres depth first, so that whole branches do.
  std::vector<std::int32_t> nodes{binary.root()};
  tree.bound_parent = {kNone};
  std::vector<std::vector<std::int32_t>> own, inner;  // of each bound
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    own.emplace_back();
    inner.emplace_back();
    for (const std::int32_t child : joined.children(nodes[k])) {
      if (binary.is_leaf(child)) {
        own[k].push_back(child);
        continue;
      }
      inner[k].push_back(std::int32_t(nodes.size()));
      nodes.push_back(child);
      tree.bound_parent.push_back(std::int32_t(k));
    }
  }
  std::vector<std::int32_t> open{0};
  while (!open.empty()) {
    const std::int32_t k = open.back();
    open.pop_back();
    tree.order.insert(tree.order.end(), own[k].begin(), own[k].end());
    tree.sphere_parent.insert(tree.sphere_parent.end(), own[k].size(), k);
    open.insert(open.end(), inner[k].rbegin(), inner[k].rend());
  }
  std::vector<std::vector<Sphere>> below(nodes.size());
  for (std::size_t k = 0; k < spheres.size(); ++k) below[tree.sphere_parent[k]].push_back(spheres[tree.order[k]]);
  tree.bounds.resize(nodes.size());
  for (std::size_t k = nodes.size(); k-- > 0;) {
    tree.bounds[k] = rounded_out(around(below[k]), below[k]);
    if (k) below[tree.bound_parent[k]].push_back(tree.bounds[k]);
  }
  return tree;
}

}  // namespace palmar
