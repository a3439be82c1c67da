// The step's quadratic programme: an objective in which fingers meet only through the palm, rows that touch the palm
// and at most one finger, bounds.
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

// A symmetric matrix over all variables in which the palm's meet every finger's and no two fingers' meet. Of palm and
// finger only the lower triangles are read.
struct ArrowMatrix {
  double palm[kPalmVariables][kPalmVariables] = {};
  double finger[kFingers][kFingerVariables][kFingerVariables] = {};
  double across[kFingers][kPalmVariables][kFingerVariables] = {};

  static ArrowMatrix diagonal(const Change& d);
  void add_diagonal(int variable, double value);
};

// The objective's matrix H as a factor of its inverse: H^-1 = M' M, where a finger's part of M y depends on that
// finger's part of y alone. So a row that touches the palm and one finger still does once M has been laid on it.
struct Metric {
  double palm[kPalmVariables][kPalmVariables] = {};  // lower triangular
  double finger[kFingers][kFingerVariables][kFingerVariables] = {};
  double across[kFingers][kPalmVariables][kFingerVariables] = {};

  // Of a diagonal H. A variable of inverse weight 0 stays where it is.
  void set_diagonal(int variable, double inverse_weight);

  // Of a matrix whose pivots are all above `least`, variable by variable; false, and nothing said, of another one.
  static bool of(const ArrowMatrix& h, const Change& least, Metric& out);

  void add_transposed(const Change& z, Change& x) const;  // x += M' z
  Change inverse_times(const Change& y) const;            // H^-1 y
};

struct QpProblem {
  Metric metric;
  Change target;        // unconstrained minimum
  Change bound;         // |x_i| <= bound_i
  Change lower, upper;  // joint limits on x
};

// Rows and bounds (as in QpResult) that are likely to hold the answer: where the search begins. They do not change it.
struct QpStart {
  std::array<std::int32_t, kVariables> row;
  int count = 0;
};

enum class QpStatus { solved, iteration_limit, infeasible };

struct QpResult {
  QpStatus status = QpStatus::solved;
  Change x{};
  int active = 0;
  // Index of a row, or -1 - (2 variable + side) for a bound: side 0 the lower, 1 the upper one.
  std::array<std::int32_t, kVariables> active_row;
  std::array<double, kVariables> multiplier;  // in the objective's units per unit of the row
  int iterations = 0;
};

// minimise (x - target)' H (x - target) / 2  subject to the rows and bounds.
//
// Goldfarb and Idnani's dual active-set method ("A numerically stable dual method for solving strictly convex quadratic
// programs", 1983), in range-space form: H is an arrow, so the matrix of active rows S = A H^-1 A' costs ten products
// an entry, and only its Cholesky factor is kept. `violation` is scratch of rows.capacity. Rows are met to `tolerance`.
QpResult solve_qp(const QpProblem& problem, const QpRows& rows, double tolerance, int iteration_limit,
                  double* violation, const QpStart& start = {});

}  // namespace palmar
