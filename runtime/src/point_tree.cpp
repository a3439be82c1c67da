#include "point_tree.h"

#include <algorithm>

#include "parallel.h"

namespace palmar {
namespace {

constexpr std::size_t kTasks = 32;  // branches that threads share

}  // namespace

PointTree::PointTree(const std::vector<Vec3>& points, int threads) {
  if (points.empty()) return;
  std::vector<Item> items(points.size());
  for (std::size_t k = 0; k < points.size(); ++k) {
    const Vec3& p = points[k];
    items[k] = {{float(p.x()), float(p.y()), float(p.z())}, std::int32_t(k)};
  }
  const std::int32_t count = std::int32_t(points.size());
  nodes_.resize(std::size_t(descendants(count)) + 1);
  // Level by level until there are branches enough, whose places are known beforehand.
  std::vector<Task> tasks{{0, 0, count, 1}};
  while (!tasks.empty() && tasks.size() < kTasks) {
    std::vector<Task> next(2 * tasks.size());
    in_parallel(threads, tasks.size(), [&](std::size_t k) {
      if (!make(tasks[k], items, &next[2 * k])) next[2 * k].count = next[2 * k + 1].count = 0;
    });
    std::erase_if(next, [](const Task& task) { return task.count == 0; });
    tasks = std::move(next);
  }
  in_parallel(threads, tasks.size(), [&](std::size_t k) { make_all(tasks[k], items); });
  for (std::vector<float>* axis : {&x_, &y_, &z_}) axis->assign(points.size() + kLeaf, 0.0f);
  order_.resize(points.size());
  for (std::size_t at = 0; at < points.size(); ++at) {
    x_[at] = items[at].at[0];
    y_[at] = items[at].at[1];
    z_[at] = items[at].at[2];
    order_[at] = items[at].number;
  }
}

std::vector<std::int32_t> PointTree::parts(std::size_t count) const {
  std::vector<std::int32_t> found;
  if (!nodes_.empty()) found.push_back(0);
  for (bool more = true; more && found.size() < count;) {
    more = false;
    std::vector<std::int32_t> next;
    for (const std::int32_t index : found) {
      const Node& node = nodes_[index];
      if (node.count) {
        next.push_back(index);
        continue;
      }
      next.insert(next.end(), {node.first, node.first + 1});
      more = true;
    }
    found = std::move(next);
  }
  return found;
}

std::int32_t PointTree::descendants(std::int32_t count) {
  return count <= kLeaf ? 0 : 2 + descendants(half(count)) + descendants(count - half(count));
}

bool PointTree::make(const Task& task, std::vector<Item>& items, Task children[2]) {
  const auto begin = items.begin() + task.first, end = begin + task.count;
  Node& node = nodes_[task.node];
  for (int axis = 0; axis < 3; ++axis) {
    node.low[axis] = node.high[axis] = begin->at[axis];
    for (auto item = begin; item != end; ++item) {
      node.low[axis] = std::min(node.low[axis], item->at[axis]);
      node.high[axis] = std::max(node.high[axis], item->at[axis]);
    }
  }
  if (task.count <= kLeaf) {
    node.first = task.first;
    node.count = task.count;
    return false;
  }
  int axis = 0;
  for (int other = 1; other < 3; ++other) {
    if (node.high[other] - node.low[other] > node.high[axis] - node.low[axis]) axis = other;
  }
  const std::int32_t left = half(task.count), right = task.count - left;
  std::nth_element(begin, begin + left, end, [axis](const Item& a, const Item& b) {
    return a.at[axis] != b.at[axis] ? a.at[axis] < b.at[axis] : a.number < b.number;
  });
  node.first = task.below;
  node.count = 0;
  const std::int32_t below = task.below + 2;
  children[0] = {task.below, task.first, left, below};
  children[1] = {task.below + 1, task.first + left, right, below + descendants(left)};
  return true;
}

void PointTree::make_all(const Task& task, std::vector<Item>& items) {
  Task children[2];
  if (!make(task, items, children)) return;
  for (const Task& child : children) make_all(child, items);
}

}  // namespace palmar
