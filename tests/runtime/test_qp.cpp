#include "check.h"
#include "made_hand.h"
#include "qp.h"

using namespace palmar;

namespace {

std::mt19937 rng(4);
std::uniform_real_distribution<double> u(-1, 1);

struct Case {
  QpProblem problem;
  QpRows rows{4000};
  std::vector<int> finger;
};

Case blank() {
  Case c;
  c.problem.inverse_weight.fill(1.0);
  c.problem.bound.fill(1e9);
  c.problem.lower.fill(-1e9);
  c.problem.upper.fill(1e9);
  for (double& t : c.problem.target) t = u(rng);
  return c;
}

using Row = std::array<double, 10>;

// Rows must be given finger by finger, -1 first.
void add(Case& c, int finger, const Row& g, double b) {
  for (int k = 0; k < 10; ++k) c.rows.g[k][c.rows.count] = k < 6 || finger >= 0 ? g[k] : 0.0;
  c.rows.b[c.rows.count++] = b;
  c.finger.push_back(finger);
  for (int group = finger + 2; group <= kFingers + 1; ++group) c.rows.group_start[group] = c.rows.count;
}

double value(const Case& c, int row, const Change& x) {
  double sum = 0;
  for (int k = 0; k < 6; ++k) sum += c.rows.g[k][row] * x[k];
  if (c.finger[row] >= 0)
    for (int k = 0; k < 4; ++k) sum += c.rows.g[6 + k][row] * x[6 + 4 * c.finger[row] + k];
  return sum;
}

// Feasible, multipliers not negative, and H (x - target) = A' u on the variables that no bound holds: the answer is the
// optimum, whatever the solver says of itself.
void check_optimal(const Case& c, const QpResult& r, double scale) {
  CHECK(r.status == QpStatus::solved);
  for (int i = 0; i < c.rows.count; ++i) CHECK(value(c, i, r.x) >= c.rows.b[i] - 2e-9 * scale);
  Change pull;
  for (int v = 0; v < kVariables; ++v) pull[v] = (r.x[v] - c.problem.target[v]) / c.problem.inverse_weight[v];
  double most = 1;
  for (double p : pull) most = std::max(most, std::abs(p));
  for (int j = 0; j < r.active; ++j) {
    CHECK(r.multiplier[j] >= 0);
    const int row = r.active_row[j];
    if (row < 0) continue;
    CHECK_NEAR(value(c, row, r.x), c.rows.b[row], 1e-7 * scale);
    for (int k = 0; k < 6; ++k) pull[k] -= r.multiplier[j] * c.rows.g[k][row];
    if (c.finger[row] >= 0)
      for (int k = 0; k < 4; ++k) pull[6 + 4 * c.finger[row] + k] -= r.multiplier[j] * c.rows.g[6 + k][row];
  }
  for (int v = 0; v < kVariables; ++v) {
    const double high = std::min(c.problem.bound[v], c.problem.upper[v]);
    const double low = std::max(-c.problem.bound[v], c.problem.lower[v]);
    CHECK(r.x[v] <= high + 1e-7 && r.x[v] >= low - 1e-7);  // 1e-9 m at the 50 mm lever of a bound, and some
    if (r.x[v] > high - 1e-6)
      CHECK(pull[v] <= 1e-6 * most);
    else if (r.x[v] < low + 1e-6)
      CHECK(pull[v] >= -1e-6 * most);
    else
      CHECK_NEAR(pull[v], 0, 1e-6 * most);
  }
}

QpResult solve(const Case& c) {
  std::vector<double> scratch(4000);
  return solve_qp(c.problem, c.rows, 1e-9, 2000, scratch.data());
}

Row random_row() {
  Row g;
  for (double& x : g) x = u(rng);
  return g;
}

}  // namespace

int main() {
  // Random rows that zero satisfies, as in a step; weights over six decades; bounds that bite.
  for (int trial = 0; trial < 300; ++trial) {
    Case c = blank();
    for (double& w : c.problem.inverse_weight) w = std::pow(10.0, 3 * u(rng));
    c.problem.bound.fill(trial % 3 == 0 ? 0.3 : 1e9);
    for (int f = -1; f < kFingers; ++f)
      for (int i = 0; i < 12; ++i) add(c, f, random_row(), -0.2 * std::abs(u(rng)));
    check_optimal(c, solve(c), 1);
  }

  // The same normal forty times.
  for (int trial = 0; trial < 50; ++trial) {
    Case c = blank();
    for (int f = -1; f < kFingers; ++f)
      for (int i = 0; i < 6; ++i) {
        const Row g = random_row();
        for (int copy = 0; copy < 40; ++copy) add(c, f, g, -0.1);
      }
    check_optimal(c, solve(c), 1);
  }

  // Normals that differ by a hair: feasible, and multipliers bounded.
  for (double hair : {1e-9, 1e-6, 1e-3}) {
    for (int trial = 0; trial < 20; ++trial) {
      Case c = blank();
      for (int f = -1; f < kFingers; ++f) {
        const Row g = random_row();
        for (int copy = 0; copy < 20; ++copy) {
          Row near = g;
          for (double& x : near) x += hair * u(rng);
          add(c, f, near, -0.1);
        }
      }
      const QpResult r = solve(c);
      CHECK(r.status == QpStatus::solved);
      for (int i = 0; i < c.rows.count; ++i) CHECK(value(c, i, r.x) >= c.rows.b[i] - 1e-8);
      for (int j = 0; j < r.active; ++j) CHECK(r.multiplier[j] < 1e6);
    }
  }

  // A cone collapsed to a point: 250 normals through zero leave the palm nowhere to go.
  for (int trial = 0; trial < 20; ++trial) {
    Case c = blank();
    for (int i = 0; i < 250; ++i) add(c, -1, random_row(), 0.0);
    const QpResult r = solve(c);
    CHECK(r.status == QpStatus::solved);
    for (int k = 0; k < 6; ++k) CHECK_NEAR(r.x[k], 0, 1e-7);
  }

  // Two walls: a gap of +1e-9 is an answer, of -1 mm is infeasible and said so.
  for (double gap : {1e-3, 1e-9, 0.0, -1e-3}) {
    Case c = blank();
    Row g{};
    g[2] = 1;
    add(c, -1, g, 0.0);
    g[2] = -1;
    add(c, -1, g, -gap);
    const QpResult r = solve(c);
    CHECK((r.status == QpStatus::solved) == (gap >= 0));
  }

  // The iteration limit is kept.
  Case c = blank();
  for (int f = -1; f < kFingers; ++f)
    for (int i = 0; i < 20; ++i) add(c, f, random_row(), -0.01);
  std::vector<double> scratch(4000);
  CHECK(solve_qp(c.problem, c.rows, 1e-9, 1, scratch.data()).status == QpStatus::iteration_limit);
  return finish();
}
