// The step's quadratic programme: a diagonal objective, rows that touch the palm and at most one finger, bounds.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "hand.h"

namespace palmar {

// Rows g . x >= b. A row touches the six palm variables and the four of its finger (none for finger < 0). Rows of one
// finger lie together: fingers -1, 0, .. 4 start at group_start[0], [1], .. [5]; group_start[6] is the end.
struct QpRows {
  explicit QpRows(int capacity_);
  int capacity;
  int count = 0;
  std::array<int, kFingers + 2> group_start{};
  std::array<std::vector<double>, kPalmVariables + kFingerVariables>
      g;  // structure of arrays: one vector a coefficient
  std::vector<double> b;
};

struct QpProblem {
  Change inverse_weight;  // 1 / diagonal of the objective's matrix
  Change target;          // unconstrained minimum
  Change bound;           // |x_i| <= bound_i
  Change lower, upper;    // joint limits on x
};

enum class QpStatus { solved, iteration_limit, infeasible };

struct QpResult {
  QpStatus status = QpStatus::solved;
  Change x{};
  int active = 0;
  std::array<std::int32_t, kVariables> active_row;  // index of a row; -1 for a bound
  std::array<double, kVariables> multiplier;        // in the objective's units per unit of the row
  int iterations = 0;
};

// minimise sum_i (x_i - target_i)^2 / (2 inverse_weight_i)  subject to the rows and bounds.
//
// Goldfarb and Idnani's dual active-set method ("A numerically stable dual method for solving strictly convex quadratic
// programs", 1983), in range-space form: with a diagonal objective the matrix of active rows S = A H^-1 A' costs ten
// products an entry, and only its Cholesky factor is kept. `violation` is scratch of rows.capacity. Rows are met to
// `tolerance`.
QpResult solve_qp(const QpProblem& problem, const QpRows& rows, double tolerance, int iteration_limit,
                  double* violation);

}  // namespace palmar
