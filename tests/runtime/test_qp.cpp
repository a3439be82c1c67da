// Answers of the step's programme judged by the optimality conditions, worked out anew. `test_qp --lines` prints every
// programme and answer as a line of JSON instead, for a comparison with another solver.
#include <cstring>
#include <nlohmann/json.hpp>

#include "check.h"
#include "made_programmes.h"

using namespace palmar;
using made::Programme;

namespace {

constexpr double kTolerance = 1e-9;  // metres, of a row

QpResult solve(const Programme& p, int limit = 2000, const QpStart& start = {}) {
  std::vector<double> scratch(4000);
  QpProblem problem = p.problem;
  ArrowMatrix h = p.bend;
  for (int v = 0; v < kVariables; ++v) h.add_diagonal(v, 1.0 / p.inverse_weight[v]);
  CHECK(Metric::of(h, Change{}, problem.metric));
  return solve_qp(problem, p.rows, kTolerance, limit, scratch.data(), start);
}

bool feasible(const Programme& p, const Change& x) {
  for (int i = 0; i < p.rows.count; ++i)
    if (!(made::row_value(p, i, x) >= p.rows.b[i] - 2 * kTolerance)) return false;
  for (int v = 0; v < kVariables; ++v) {
    const double high = std::min(p.problem.bound[v], p.problem.upper[v]);
    const double low = std::max(-p.problem.bound[v], p.problem.lower[v]);
    if (!(x[v] <= high + 1e-7 && x[v] >= low - 1e-7)) return false;  // 1e-9 m at the 50 mm lever of a bound, and some
  }
  return true;
}

// What is left of H (x - target) = A' u on the variables that no bound holds, over the largest pull of any.
double stationarity(const Programme& p, const QpResult& r) {
  Change pull;
  for (int v = 0; v < kVariables; ++v) {
    pull[v] = 0;
    for (int w = 0; w < kVariables; ++w) pull[v] += made::stiffness(p, v, w) * (r.x[w] - p.problem.target[w]);
  }
  double largest = 1, worst = 0;
  for (double x : pull) largest = std::max(largest, std::abs(x));
  for (int j = 0; j < r.active; ++j) {
    const int row = r.active_row[j];
    if (row < 0) continue;
    for (int k = 0; k < kPalmVariables; ++k) pull[k] -= r.multiplier[j] * p.rows.g[k][row];
    if (p.finger[row] < 0) continue;
    for (int k = 0; k < kFingerVariables; ++k)
      pull[kPalmVariables + kFingerVariables * p.finger[row] + k] -=
          r.multiplier[j] * p.rows.g[kPalmVariables + k][row];
  }
  for (int v = 0; v < kVariables; ++v) {
    const double high = std::min(p.problem.bound[v], p.problem.upper[v]);
    const double low = std::max(-p.problem.bound[v], p.problem.lower[v]);
    if (r.x[v] > high - 1e-6)
      worst = std::max(worst, pull[v]);
    else if (r.x[v] < low + 1e-6)
      worst = std::max(worst, -pull[v]);
    else
      worst = std::max(worst, std::abs(pull[v]));
  }
  return worst / largest;
}

void check_answer(const Programme& p, const QpResult& r, bool has_answer) {
  CHECK((r.status == QpStatus::solved) == has_answer);
  if (!has_answer) {
    CHECK(r.status == QpStatus::infeasible);
    return;
  }
  CHECK(feasible(p, r.x));
  CHECK(stationarity(p, r) <= 1e-6);
  for (int j = 0; j < r.active; ++j) {
    CHECK(r.multiplier[j] >= 0);
    const int row = r.active_row[j];
    if (row >= 0) CHECK_NEAR(made::row_value(p, row, r.x), p.rows.b[row], 1e-7);
  }
}

// Any rows and bounds, also one twice.
QpStart random_start(std::mt19937& rng, const Programme& p) {
  QpStart start;
  start.count = std::uniform_int_distribution<int>(1, kVariables)(rng);
  for (int k = 0; k < start.count; ++k)
    start.row[k] = std::uniform_int_distribution<int>(-2 * kVariables, std::max(p.rows.count - 1, -1))(rng);
  return start;
}

nlohmann::json line(const char* family, const Programme& p, const QpResult& r) {
  nlohmann::json rows = nlohmann::json::array();
  for (int i = 0; i < p.rows.count; ++i) {
    std::vector<double> row(kVariables + 1, 0.0);
    for (int k = 0; k < kPalmVariables; ++k) row[std::size_t(k)] = p.rows.g[k][i];
    if (p.finger[i] >= 0)
      for (int k = 0; k < kFingerVariables; ++k)
        row[std::size_t(kPalmVariables + kFingerVariables * p.finger[i] + k)] = p.rows.g[kPalmVariables + k][i];
    row[kVariables] = p.rows.b[i];
    rows.push_back(row);
  }
  Change low, high;
  for (int v = 0; v < kVariables; ++v) {
    high[v] = std::min(p.problem.bound[v], p.problem.upper[v]);
    low[v] = std::max(-p.problem.bound[v], p.problem.lower[v]);
  }
  std::vector<Change> stiffness(kVariables);
  for (int v = 0; v < kVariables; ++v)
    for (int w = 0; w < kVariables; ++w) stiffness[std::size_t(v)][std::size_t(w)] = made::stiffness(p, v, w);
  double multipliers = 0;
  for (int j = 0; j < r.active; ++j) multipliers += r.multiplier[j];
  const char* status = r.status == QpStatus::solved       ? "solved"
                       : r.status == QpStatus::infeasible ? "infeasible"
                                                          : "limit";
  return {{"family", family},
          {"stiffness", stiffness},
          {"target", p.problem.target},
          {"low", low},
          {"high", high},
          {"rows", rows},
          {"status", status},
          {"x", r.x},
          {"multipliers", multipliers}};
}

}  // namespace

int main(int argc, char** argv) {
  const bool lines = argc > 1 && std::strcmp(argv[1], "--lines") == 0;
  std::mt19937 starts(6);
  int most_iterations = 0;
  for (const made::Family& family : made::families()) {
    std::mt19937 rng(4);
    for (int trial = 0; trial < family.count; ++trial) {
      const Programme p = family.make(rng, trial);
      const QpResult r = solve(p);
      if (lines) {
        std::printf("%s\n", line(family.name, p, r).dump().c_str());
        continue;
      }
      const int before = checks_failed;
      check_answer(p, r, family.has_answer);
      // Where it begins changes the way and not the answer; from what holds the answer there is no way to go.
      QpStart held{r.active_row, r.active};
      if (family.has_answer) {
        const QpResult again = solve(p, 2000, held);
        check_answer(p, again, true);
        most_iterations = std::max(most_iterations, again.iterations);
      }
      for (int k = 0; k < 3; ++k) check_answer(p, solve(p, 2000, random_start(starts, p)), family.has_answer);
      if (checks_failed > before) std::printf("  %s, number %d\n", family.name, trial);
    }
  }
  if (lines) return 0;
  CHECK(most_iterations == 0);

  // A bound of the iterations is kept, whatever it is.
  std::mt19937 rng(5);
  for (int limit : {1, 2, 5, 20}) {
    Programme p = made::blank(rng);
    for (int f = -1; f < kFingers; ++f)
      for (int i = 0; i < 40; ++i) made::add(p, f, made::random_row(rng), -0.01);
    const QpResult r = solve(p, limit);
    CHECK(r.status == QpStatus::iteration_limit && r.iterations <= limit + 1);
  }
  return finish();
}
