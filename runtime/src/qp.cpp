#include "qp.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "wide.h"

namespace palmar {

namespace {

constexpr int kRowVariables = kPalmVariables + kFingerVariables;
constexpr double kLeastStart = 1e-8;  // of its own length that a row to begin with must have of its own

struct ActiveRow {
  double g[kRowVariables];
  double h[kRowVariables];  // M g
  int finger;
  double b;
  std::int32_t row;  // as in QpResult
};

// violation[i] = b[i] - g[i] . x for rows of one group.
PALMAR_WIDE void group_violations(const double* const* g, const double* b, const double* x, int begin, int end,
                                  int variables, double* violation) {
  for (int i = begin; i < end; ++i) violation[i] = b[i];
  for (int k = 0; k < variables; ++k) {
    const double* gk = g[k];
    const double xk = x[k];
    for (int i = begin; i < end; ++i) violation[i] -= gk[i] * xk;
  }
}

struct Solver {
  Solver(const QpProblem& problem_, const QpRows& rows_, double tolerance_, double* violation_)
      : problem(problem_), rows(rows_), tolerance(tolerance_), violation(violation_) {}

  const QpProblem& problem;
  const QpRows& rows;
  double tolerance;
  double* violation;

  std::array<ActiveRow, kVariables> active;
  int count = 0;
  double s[kVariables][kVariables];  // A H^-1 A' of the active rows (lower part)
  double l[kVariables][kVariables];  // its Cholesky factor, but on the diagonal one over it
  std::array<double, kVariables> u;  // multipliers

  // Fills p.h from p.g.
  void transform(ActiveRow& p) const {
    const Metric& m = problem.metric;
    for (int i = 0; i < kPalmVariables; ++i) {
      p.h[i] = 0;
      for (int k = 0; k <= i; ++k) p.h[i] += m.palm[i][k] * p.g[k];
    }
    double* const finger = p.h + kPalmVariables;
    std::fill_n(finger, kFingerVariables, 0.0);
    if (p.finger < 0) return;
    const double* const g = p.g + kPalmVariables;
    for (int k = 0; k < kFingerVariables; ++k) {
      for (int i = 0; i < kPalmVariables; ++i) p.h[i] += m.across[p.finger][i][k] * g[k];
      for (int i = k; i < kFingerVariables; ++i) finger[i] += m.finger[p.finger][i][k] * g[k];
    }
  }

  double product(const ActiveRow& p, const ActiveRow& q) const {
    const int variables = p.finger >= 0 && p.finger == q.finger ? kRowVariables : kPalmVariables;
    double sum = 0;
    for (int k = 0; k < variables; ++k) sum += p.h[k] * q.h[k];
    return sum;
  }

  double value(const ActiveRow& p, const Change& x) const {
    double sum = 0;
    for (int k = 0; k < kPalmVariables; ++k) sum += p.g[k] * x[k];
    if (p.finger >= 0)
      for (int k = 0; k < kFingerVariables; ++k)
        sum += p.g[kPalmVariables + k] * x[kPalmVariables + kFingerVariables * p.finger + k];
    return sum;
  }

  // z += by M p
  static void add(const ActiveRow& p, double by, Change& z) {
    for (int k = 0; k < kPalmVariables; ++k) z[k] += by * p.h[k];
    if (p.finger < 0) return;
    double* const finger = &z[kPalmVariables + kFingerVariables * p.finger];
    for (int k = 0; k < kFingerVariables; ++k) finger[k] += by * p.h[kPalmVariables + k];
  }

  // x += t H^-1 (n - A' r)
  void move(Change& x, const ActiveRow& n, const double* r, double t) const {
    Change z{};
    add(n, t, z);
    for (int j = 0; j < count; ++j) add(active[j], -t * r[j], z);
    problem.metric.add_transposed(z, x);
  }

  // x from the multipliers alone, then multipliers from what the active rows still lack: two rounds of refinement.
  // Moves add up rounding; weights six decades apart would show it in the fourth digit.
  void refine(Change& x) {
    for (int round = 0; round < 3; ++round) {
      Change z{};
      for (int j = 0; j < count; ++j) add(active[j], u[j], z);
      x = problem.target;
      problem.metric.add_transposed(z, x);
      if (round == 2) break;
      double w[kVariables];
      for (int j = 0; j < count; ++j) {
        double sum = active[j].b - value(active[j], x);
        for (int k = 0; k < j; ++k) sum -= l[j][k] * w[k];
        w[j] = sum * l[j][j];
      }
      for (int j = count; j-- > 0;) {
        for (int k = j + 1; k < count; ++k) w[j] -= l[k][j] * w[k];
        w[j] *= l[j][j];
        u[j] = std::max(0.0, u[j] + w[j]);
      }
    }
  }

  void factor_from(int first) {
    for (int i = first; i < count; ++i) {
      for (int j = 0; j <= i; ++j) {
        double sum = s[i][j];
        for (int k = 0; k < j; ++k) sum -= l[i][k] * l[j][k];
        l[i][j] = i == j ? 1.0 / std::sqrt(std::max(sum, std::numeric_limits<double>::min())) : sum * l[j][j];
      }
    }
  }

  void drop(int j) {
    for (int i = j + 1; i < count; ++i) {
      active[i - 1] = active[i];
      u[i - 1] = u[i];
      for (int k = 0; k < j; ++k) s[i - 1][k] = s[i][k];
      for (int k = j + 1; k <= i; ++k) s[i - 1][k - 1] = s[i][k];
    }
    --count;
    factor_from(j);
  }

  // Makes those of the rows active that are independent and that the answer to all of them as equations presses: where
  // every multiplier is above zero the dual method may go on from there as if it had come there itself.
  void begin_with(const QpStart& start, Change& x) {
    for (int k = 0; k < start.count && count < kVariables; ++k) {
      const int row = start.row[k];
      ActiveRow& p = active[count];
      p = row >= 0 ? row_at(row, finger_of(row)) : bound_at((-1 - row) / 2, (-1 - row) % 2 == 1);
      double left = s[count][count] = product(p, p);
      const double own = left;
      for (int j = 0; j < count; ++j) {
        double sum = s[count][j] = product(active[j], p);
        for (int i = 0; i < j; ++i) sum -= l[count][i] * l[j][i];
        l[count][j] = sum * l[j][j];
        left -= l[count][j] * l[count][j];
      }
      if (!(left > kLeastStart * own)) continue;
      l[count][count] = 1.0 / std::sqrt(left);
      ++count;
    }
    while (count > 0) {
      for (int j = 0; j < count; ++j) {
        double sum = active[j].b - value(active[j], problem.target);
        for (int k = 0; k < j; ++k) sum -= l[j][k] * u[k];
        u[j] = sum * l[j][j];
      }
      for (int j = count; j-- > 0;) {
        for (int k = j + 1; k < count; ++k) u[j] -= l[k][j] * u[k];
        u[j] *= l[j][j];
      }
      int pulling = 0;
      for (int j = 1; j < count; ++j)
        if (u[j] < u[pulling]) pulling = j;
      if (u[pulling] >= 0) break;
      drop(pulling);
    }
    if (count > 0) refine(x);
  }

  int finger_of(int row) const {
    int group = 0;
    while (row >= rows.group_start[group + 1]) ++group;
    return group - 1;
  }

  ActiveRow row_at(int i, int finger) const {
    ActiveRow p;
    for (int k = 0; k < kRowVariables; ++k) p.g[k] = rows.g[k][i];
    p.finger = finger;
    p.b = rows.b[i];
    p.row = i;
    transform(p);
    return p;
  }

  ActiveRow bound_at(int v, bool upper) const {
    ActiveRow p{};
    p.finger = v < kPalmVariables ? -1 : (v - kPalmVariables) / kFingerVariables;
    const int k = v < kPalmVariables ? v : kPalmVariables + (v - kPalmVariables) % kFingerVariables;
    p.g[k] = upper ? -1.0 : 1.0;
    p.b = upper ? -upper_of(v) : lower_of(v);
    p.row = -1 - (2 * v + (upper ? 1 : 0));
    transform(p);
    return p;
  }

  double upper_of(int v) const { return std::min(problem.bound[v], problem.upper[v]); }
  double lower_of(int v) const { return std::max(-problem.bound[v], problem.lower[v]); }

  // The row that x breaks most, if by more than the tolerance. Ties go to the lowest index.
  bool most_violated(const Change& x, ActiveRow& worst) const {
    double most = tolerance;
    int row = -1, finger = -1;
    const double* g[kRowVariables];
    for (int k = 0; k < kRowVariables; ++k) g[k] = rows.g[k].data();
    double point[kRowVariables];
    std::copy_n(x.begin(), kPalmVariables, point);
    for (int group = 0; group <= kFingers; ++group) {
      const int begin = rows.group_start[group], end = rows.group_start[group + 1];
      if (begin == end) continue;
      if (group > 0)
        std::copy_n(x.begin() + kPalmVariables + kFingerVariables * (group - 1), kFingerVariables,
                    point + kPalmVariables);
      group_violations(g, rows.b.data(), point, begin, end, group > 0 ? kRowVariables : kPalmVariables, violation);
      for (int i = begin; i < end; ++i) {
        if (violation[i] > most) {
          most = violation[i];
          row = i;
          finger = group - 1;
        }
      }
    }
    if (row >= 0) {
      worst = row_at(row, finger);
      return true;
    }
    // Bounds only once every row holds: contacts decide most answers, and a bound taken first would be dropped again.
    int bound = -1;
    bool upper = false;
    for (int v = 0; v < kVariables; ++v) {
      // A bound in radians counts as its sweep at 50 mm, so that the tolerance stays in metres.
      const double lever = v < 3 ? 1.0 : 0.05;
      const double over = (x[v] - upper_of(v)) * lever, under = (lower_of(v) - x[v]) * lever;
      if (over > most) most = over, bound = v, upper = true;
      if (under > most) most = under, bound = v, upper = false;
    }
    if (bound >= 0) worst = bound_at(bound, upper);
    return bound >= 0;
  }
};

}  // namespace

QpRows::QpRows(int capacity_) : capacity(capacity_), b(capacity_) {
  for (auto& column : g) column.resize(capacity_);
}

QpResult solve_qp(const QpProblem& problem, const QpRows& rows, double tolerance, int iteration_limit,
                  double* violation, const QpStart& start) {
  Solver solver(problem, rows, tolerance, violation);
  QpResult result;
  result.x = problem.target;
  const auto finish = [&](QpStatus status) {
    result.status = status;
    result.active = solver.count;
    for (int j = 0; j < solver.count; ++j) {
      result.active_row[j] = solver.active[j].row;
      result.multiplier[j] = solver.u[j];
    }
    return result;
  };

  if (start.count > 0) solver.begin_with(start, result.x);
  ActiveRow n;
  bool refined = false;
  for (;;) {
    if (!solver.most_violated(result.x, n)) {
      if (refined || solver.count == 0) break;
      solver.refine(result.x);
      refined = true;
      continue;
    }
    double u_new = 0;
    for (;;) {
      if (++result.iterations > iteration_limit) return finish(QpStatus::iteration_limit);
      // w = L^-1 A H^-1 n and r = L^-T w: how the active multipliers answer to one unit of the new row's.
      const int q = solver.count;
      double column[kVariables], w[kVariables], r[kVariables];
      for (int j = 0; j < q; ++j) column[j] = solver.product(solver.active[j], n);
      const double own = solver.product(n, n);
      double curvature = own;
      for (int j = 0; j < q; ++j) {
        double sum = column[j];
        for (int k = 0; k < j; ++k) sum -= solver.l[j][k] * w[k];
        w[j] = sum * solver.l[j][j];
        curvature -= w[j] * w[j];
      }
      for (int j = q; j-- > 0;) {
        double sum = w[j];
        for (int k = j + 1; k < q; ++k) sum -= solver.l[k][j] * r[k];
        r[j] = sum * solver.l[j][j];
      }
      // Below 1e-12 of its own length the new row is a combination of the active ones: some thousand roundings. Where
      // links are wedged between spheres, rows with 1e-11 are still rows of their own, and without them nothing is
      // feasible.
      const bool dependent = curvature <= 1e-12 * own || q == kVariables;

      double partial = std::numeric_limits<double>::infinity();
      int blocking = -1;
      for (int j = 0; j < q; ++j) {
        if (r[j] > 0 && solver.u[j] / r[j] < partial) {
          partial = solver.u[j] / r[j];
          blocking = j;
        }
      }
      if (dependent && blocking < 0) return finish(QpStatus::infeasible);
      const double full =
          dependent ? std::numeric_limits<double>::infinity() : (n.b - solver.value(n, result.x)) / curvature;
      const double t = std::min(partial, full);
      if (!dependent) solver.move(result.x, n, r, t);
      for (int j = 0; j < q; ++j) solver.u[j] -= t * r[j];
      u_new += t;
      if (full <= partial) {
        solver.active[q] = n;
        solver.u[q] = u_new;
        for (int j = 0; j < q; ++j) {
          solver.s[q][j] = column[j];
          solver.l[q][j] = w[j];
        }
        solver.s[q][q] = own;
        solver.l[q][q] = 1.0 / std::sqrt(curvature);
        ++solver.count;
        break;
      }
      solver.drop(blocking);
    }
  }
  return finish(QpStatus::solved);
}

}  // namespace palmar
