#include <cmath>

#include "qp.h"

namespace palmar {

namespace {

// The inverse of the Cholesky factor of the n x n matrix `a`; false where a pivot is not above `least`.
template <int n>
bool inverse_factor(const double (&a)[n][n], const double* least, double (&out)[n][n]) {
  double l[n][n];
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = a[i][j];
      for (int k = 0; k < j; ++k) sum -= l[i][k] * l[j][k];
      if (i == j && !(sum > least[i])) return false;
      l[i][j] = i == j ? std::sqrt(sum) : sum / l[j][j];
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      double sum = i == j ? 1.0 : 0.0;
      for (int k = j; k < i; ++k) sum -= l[i][k] * out[k][j];
      out[i][j] = i < j ? 0.0 : sum / l[i][i];
    }
  }
  return true;
}

}  // namespace

ArrowMatrix ArrowMatrix::diagonal(const Change& d) {
  ArrowMatrix m;
  for (int v = 0; v < kVariables; ++v) m.add_diagonal(v, d[v]);
  return m;
}

void ArrowMatrix::add_diagonal(int variable, double value) {
  const int f = (variable - kPalmVariables) / kFingerVariables, k = (variable - kPalmVariables) % kFingerVariables;
  (variable < kPalmVariables ? palm[variable][variable] : finger[f][k][k]) += value;
}

void Metric::set_diagonal(int variable, double inverse_weight) {
  const double root = std::sqrt(inverse_weight);
  const int f = (variable - kPalmVariables) / kFingerVariables, k = (variable - kPalmVariables) % kFingerVariables;
  if (variable < kPalmVariables)
    palm[variable][variable] = root;
  else
    finger[f][k][k] = root;
}

// H = [F C'; C P] with the fingers first has the factor [L 0; K L_P], K = C L^-T, L_P L_P' = P - K K'. Its inverse is
// [L^-1 0; -L_P^-1 K L^-1, L_P^-1].
bool Metric::of(const ArrowMatrix& h, const Change& least, Metric& out) {
  double palm[kPalmVariables][kPalmVariables];
  for (int i = 0; i < kPalmVariables; ++i)
    for (int j = 0; j <= i; ++j) palm[i][j] = h.palm[i][j];
  double k_times[kFingers][kPalmVariables][kFingerVariables];  // K L^-1
  for (int f = 0; f < kFingers; ++f) {
    const auto& m = out.finger[f];
    if (!inverse_factor(h.finger[f], &least[kPalmVariables + kFingerVariables * f], out.finger[f])) return false;
    double k[kPalmVariables][kFingerVariables];
    for (int i = 0; i < kPalmVariables; ++i) {
      for (int j = 0; j < kFingerVariables; ++j) {
        k[i][j] = 0;
        for (int c = 0; c <= j; ++c) k[i][j] += h.across[f][i][c] * m[j][c];
      }
      for (int j = 0; j < kFingerVariables; ++j) {
        k_times[f][i][j] = 0;
        for (int c = j; c < kFingerVariables; ++c) k_times[f][i][j] += k[i][c] * m[c][j];
      }
      for (int j = 0; j <= i; ++j)
        for (int c = 0; c < kFingerVariables; ++c) palm[i][j] -= k[i][c] * k[j][c];
    }
  }
  if (!inverse_factor(palm, least.data(), out.palm)) return false;
  for (int f = 0; f < kFingers; ++f) {
    for (int i = 0; i < kPalmVariables; ++i) {
      for (int j = 0; j < kFingerVariables; ++j) {
        out.across[f][i][j] = 0;
        for (int c = 0; c <= i; ++c) out.across[f][i][j] -= out.palm[i][c] * k_times[f][c][j];
      }
    }
  }
  return true;
}

void Metric::add_transposed(const Change& z, Change& x) const {
  for (int k = 0; k < kPalmVariables; ++k)
    for (int i = k; i < kPalmVariables; ++i) x[k] += palm[i][k] * z[i];
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    for (int k = 0; k < kFingerVariables; ++k) {
      double sum = 0;
      for (int i = 0; i < kPalmVariables; ++i) sum += across[f][i][k] * z[i];
      for (int i = k; i < kFingerVariables; ++i) sum += finger[f][i][k] * z[v + i];
      x[v + k] += sum;
    }
  }
}

Change Metric::inverse_times(const Change& y) const {
  Change z{}, x{};
  for (int i = 0; i < kPalmVariables; ++i)
    for (int k = 0; k <= i; ++k) z[i] += palm[i][k] * y[k];
  for (int f = 0; f < kFingers; ++f) {
    const int v = kPalmVariables + kFingerVariables * f;
    for (int k = 0; k < kFingerVariables; ++k) {
      for (int i = 0; i < kPalmVariables; ++i) z[i] += across[f][i][k] * y[v + k];
      for (int i = k; i < kFingerVariables; ++i) z[v + i] += finger[f][i][k] * y[v + k];
    }
  }
  add_transposed(z, x);
  return x;
}

}  // namespace palmar
