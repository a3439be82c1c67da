// Quadratic programmes by family: random ones, the degenerate ones that are known to break solvers, and ones taken from
// a hand at an object. Each has an answer unless its family says otherwise.
#pragma once

#include <functional>
#include <random>

#include "made_hand.h"
#include "made_objects.h"
#include "qp.h"
#include "search.h"

namespace palmar::made {

struct Programme {
  QpProblem problem;
  Change inverse_weight;  // the inverse of the objective's diagonal,
  ArrowMatrix bend;       // and what its matrix is besides
  QpRows rows{4000};
  std::vector<int> finger;  // of each row
};

struct Family {
  const char* name;
  int count;
  bool has_answer;
  std::function<Programme(std::mt19937&, int)> make;  // the numbered member
};

using Row = std::array<double, kPalmVariables + kFingerVariables>;

inline double signed_unit(std::mt19937& rng) { return std::uniform_real_distribution<double>(-1, 1)(rng); }

inline Row random_row(std::mt19937& rng) {
  Row g;
  for (double& x : g) x = signed_unit(rng);
  return g;
}

inline Programme blank(std::mt19937& rng) {
  Programme p;
  p.inverse_weight.fill(1.0);
  p.problem.bound.fill(1e9);
  p.problem.lower.fill(-1e9);
  p.problem.upper.fill(1e9);
  for (double& t : p.problem.target) t = signed_unit(rng);
  return p;
}

// Rows must be given finger by finger, -1 first.
inline void add(Programme& p, int finger, const Row& g, double b) {
  for (int k = 0; k < kPalmVariables + kFingerVariables; ++k)
    p.rows.g[k][p.rows.count] = k < kPalmVariables || finger >= 0 ? g[k] : 0.0;
  p.rows.b[p.rows.count++] = b;
  p.finger.push_back(finger);
  for (int group = finger + 2; group <= kFingers + 1; ++group) p.rows.group_start[group] = p.rows.count;
}

inline double row_value(const Programme& p, int row, const Change& x) {
  double sum = 0;
  for (int k = 0; k < kPalmVariables; ++k) sum += p.rows.g[k][row] * x[k];
  if (p.finger[row] >= 0)
    for (int k = 0; k < kFingerVariables; ++k)
      sum += p.rows.g[kPalmVariables + k][row] * x[kPalmVariables + kFingerVariables * p.finger[row] + k];
  return sum;
}

// Rows that zero satisfies, as in a step; weights over six decades; bounds that bite in a third.
inline Programme random_programme(std::mt19937& rng, int trial) {
  Programme p = blank(rng);
  for (double& w : p.inverse_weight) w = std::pow(10.0, 3 * signed_unit(rng));
  p.problem.bound.fill(trial % 3 == 0 ? 0.3 : 1e9);
  for (int f = -1; f < kFingers; ++f)
    for (int i = 0; i < 12; ++i) add(p, f, random_row(rng), -0.2 * std::abs(signed_unit(rng)));
  return p;
}

// As random_programme, with an objective that joins palm and fingers: half convex, half barely.
inline Programme bent_objective(std::mt19937& rng, int trial) {
  Programme p = random_programme(rng, trial);
  for (double& w : p.inverse_weight) w = std::pow(10.0, signed_unit(rng));
  for (int n = 0; n < 12; ++n) {
    const int f = int(rng() % kFingers);
    const Row g = random_row(rng);
    const double by = trial % 2 ? 3.0 : 30.0;
    for (int a = 0; a < kPalmVariables; ++a) {
      for (int b = 0; b < kPalmVariables; ++b) p.bend.palm[a][b] += by * g[a] * g[b];
      for (int b = 0; b < kFingerVariables; ++b) p.bend.across[f][a][b] += by * g[a] * g[kPalmVariables + b];
    }
    for (int a = 0; a < kFingerVariables; ++a)
      for (int b = 0; b < kFingerVariables; ++b)
        p.bend.finger[f][a][b] += by * g[kPalmVariables + a] * g[kPalmVariables + b];
  }
  return p;
}

// The objective's matrix, entry by entry.
inline double stiffness(const Programme& p, int a, int b) {
  if (a > b) std::swap(a, b);
  const auto finger = [](int v) { return (v - kPalmVariables) / kFingerVariables; };
  const auto own = [](int v) { return (v - kPalmVariables) % kFingerVariables; };
  const double diagonal = a == b ? 1.0 / p.inverse_weight[a] : 0.0;
  if (b < kPalmVariables) return diagonal + p.bend.palm[a][b];
  if (a < kPalmVariables) return p.bend.across[finger(b)][a][own(b)];
  return finger(a) == finger(b) ? diagonal + p.bend.finger[finger(a)][own(a)][own(b)] : 0.0;
}

// Weights 1 to 10^6 and nothing else that is hard (C7).
inline Programme spread_weights(std::mt19937& rng, int trial) {
  Programme p = blank(rng);
  for (double& w : p.inverse_weight) w = (trial + rng()) % 2 ? 1.0 : 1e-6;
  for (int f = -1; f < kFingers; ++f)
    for (int i = 0; i < 6; ++i) add(p, f, random_row(rng), -0.2 * std::abs(signed_unit(rng)));
  return p;
}

// The same normal forty times (C1).
inline Programme duplicates(std::mt19937& rng, int) {
  Programme p = blank(rng);
  for (int f = -1; f < kFingers; ++f)
    for (int i = 0; i < 6; ++i) {
      const Row g = random_row(rng);
      for (int copy = 0; copy < 40; ++copy) add(p, f, g, -0.1);
    }
  return p;
}

// Normals that differ by a hair, 1e-9, 1e-6 or 1e-3 (C2).
inline Programme near_parallel(std::mt19937& rng, int trial) {
  const double hair = std::pow(10.0, -9 + 3 * (trial % 3));
  Programme p = blank(rng);
  for (int f = -1; f < kFingers; ++f) {
    const Row g = random_row(rng);
    for (int copy = 0; copy < 20; ++copy) {
      Row near = g;
      for (double& x : near) x += hair * signed_unit(rng);
      add(p, f, near, -0.1);
    }
  }
  return p;
}

// 250 normals through zero leave the palm, or a finger, nowhere to go (C3).
inline Programme collapsed_cone(std::mt19937& rng, int trial) {
  Programme p = blank(rng);
  const int finger = trial % 6 - 1;
  for (int i = 0; i < 250; ++i) {
    Row g = random_row(rng);
    if (finger >= 0) std::fill_n(g.begin(), kPalmVariables, 0.0);
    add(p, finger, g, 0.0);
  }
  return p;
}

// Walls around: forty normals in a plane leave a disc of a millimetre down to a nanometre (C6).
inline Programme ring(std::mt19937& rng, int trial) {
  Programme p = blank(rng);
  const double room = std::pow(10.0, -3 - trial % 7);
  for (int i = 0; i < 40; ++i) {
    Row g{};
    g[0] = std::cos(2 * M_PI * i / 40), g[1] = std::sin(2 * M_PI * i / 40);
    add(p, -1, g, -room);
  }
  return p;
}

// Two walls face to face with room between them (C4).
inline Programme wedge(std::mt19937& rng, double room) {
  Programme p = blank(rng);
  Row g = random_row(rng);
  add(p, -1, g, 0.0);
  for (double& x : g) x = -x;
  add(p, -1, g, -room);
  return p;
}

inline Programme open_wedge(std::mt19937& rng, int trial) {
  constexpr double rooms[] = {1e-3, 1e-6, 1e-9, 1e-12, 0};
  return wedge(rng, rooms[trial % 5]);
}

// Closed by a micrometre and more: a thousand tolerances.
inline Programme closed_wedge(std::mt19937& rng, int trial) { return wedge(rng, trial % 2 ? -1e-6 : -1e-3); }

// As many rows as variables, and more, through one point: every vertex degenerate.
inline Programme full_vertex(std::mt19937& rng, int) {
  Programme p = blank(rng);
  Change vertex;
  for (double& x : vertex) x = 0.1 * signed_unit(rng);
  for (int f = -1; f < kFingers; ++f)
    for (int i = 0; i < 10; ++i) {
      add(p, f, random_row(rng), 0);
      p.rows.b[p.rows.count - 1] = row_value(p, p.rows.count - 1, vertex);
    }
  return p;
}

// A hand that just touches an object, with the step's weights and bounds: hundreds of nearly alike rows in metres.
inline Programme of_a_hand(std::mt19937& rng, int trial) {
  static const HandModel model = hand();
  static const PalmGroups groups(model);
  static const CollisionObject objects[] = {CollisionObject(object("ball", 3000)),
                                            CollisionObject(object("ears", 3000)),
                                            CollisionObject(object("cup", 30000))};
  const CollisionObject& near = objects[trial % 3];
  static Candidates candidates(8192);
  static std::vector<double> gap(std::size_t(candidates.size()));
  constexpr double margin = 0.003;
  PerLink limit;
  limit.fill(margin);
  // The lists of a hand at q; the smallest gap.
  const auto look = [&](const HandPlacement& at) {
    std::uint32_t visited = 0;
    candidates.forget();  // of another object or place
    for (int link = 0; link < kLinks; ++link) gather_link(model, groups, near, at, link, margin, candidates, visited);
    return evaluate_gaps(model, candidates, at, gap.data());
  };
  for (;;) {
    Configuration q = random_configuration(rng, 0.02);
    // Out along one way until nothing sinks in.
    const Vec3 way = Vec3(signed_unit(rng), signed_unit(rng), signed_unit(rng)).normalized();
    for (double out = 0.3; out > 1e-6; out *= 0.5) {
      const auto free = [&] { return look(place_hand(model, q)) >= 0; };
      if (!free()) q.position += out * way;
      q.position -= 0.5 * out * way;
      if (!free()) q.position += 0.5 * out * way;
    }
    const HandPlacement at = place_hand(model, q);
    if (look(at) < 0 || candidates.total() < 5) continue;
    Programme p = blank(rng);
    std::vector<std::int32_t> candidate(4000);
    if (!linearise(candidates, at, gap.data(), limit, nullptr, 1e-6, false, p.rows, candidate.data())) continue;
    for (int f = -1; f < kFingers; ++f) p.finger.resize(std::size_t(p.rows.group_start[f + 2]), f);
    for (int v = 0; v < kVariables; ++v) {
      const bool palm = v < kPalmVariables, abduction = !palm && (v - kPalmVariables) % kFingerVariables == 0;
      p.inverse_weight[v] = palm ? 1e-6 : abduction ? 2e-5 : 2.0;
      p.problem.target[v] *= v < 3 ? 0.02 : 0.5;
      p.problem.bound[v] = v < 3 ? margin : margin / 0.1;
    }
    return p;
  }
}

inline const std::vector<Family>& families() {
  static const std::vector<Family> all = {
      {"random", 300, true, random_programme},
      {"bent objective", 200, true, bent_objective},
      {"duplicates", 50, true, duplicates},
      {"near parallel", 60, true, near_parallel},
      {"collapsed cone", 24, true, collapsed_cone},
      {"ring", 28, true, ring},
      {"open wedge", 50, true, open_wedge},
      {"closed wedge", 40, false, closed_wedge},
      {"full vertex", 60, true, full_vertex},
      {"spread weights", 60, true, spread_weights},
      {"hand", 90, true, of_a_hand},
  };
  return all;
}

}  // namespace palmar::made
