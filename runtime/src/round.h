// One round of `progressive`: linearise, solve, verify. Whatever it publishes has been verified here.
#pragma once

#include "solver.h"

namespace palmar {

// How a round ended: whether the pose moved, how far, and which links their lists (not the contacts) stopped.
struct RoundEnd {
  bool moved = false;
  double motion = 0;
  double left = 0;   // an estimate of how far it still is to the best pose, metres
  double slack = 0;  // the largest gap of a pair that presses
  std::array<bool, kLinks> cut{};
  bool any_cut = false;
  bool failed = false;  // there was somewhere to go, and no pose on the way could be verified
};

// How far each angle may be from where the step began: its own rate, or the haptic hand's if that is faster. A finger
// that comes free swings back to the haptic one instead of jumping. Abduction first, then flexions, finger by finger.
using AngleRates = std::array<double, kVariables - kPalmVariables>;

// One step's attempts to better the pose: what its rounds share.
struct Round {
  const Scene& scene;
  const Configuration& haptic;
  SolverState& state;
  Workspace& work;
  Change weight;
  Metric springs;       // of the weights alone
  Configuration begin;  // of the step
  AngleRates rate;

  Change step_bound{};              // of the last programme
  std::uint64_t at_step_bound = 0;  // bit 2 v + side: its answer held variable v at that bound
  int rows_wanted = -1;             // how many rows were wanted when work.rows were made at the round's start, else -1
  Configuration trial{};
  HandPlacement trial_placement{};
  double trial_least = 0;    // its smallest gap
  bool trial_known = false;  // no link has left what its list covers

  // Moves state.graphic to a verified pose that costs less, if it finds one.
  RoundEnd run();

  bool verify(const Configuration& q);
  double excess(const HandPlacement& from, const HandPlacement& to, const PerLink& allowed) const;
  void joint_room(const Configuration& q, Change& lower, Change& upper) const;
  double near_limit(int link, const double* gap) const;
  // The objective that knows how the pressing contacts bend, as its metric and its minimum; false if there is none.
  bool bend(const Change& way, Metric& metric, Change& wish);
  const GapShape& shape_of(const Pressing& p);
  QpResult programme(const HandPlacement& at, const Configuration& q, const double* gap, const Metric& metric,
                     const Change& wish, const PerLink& allowed, const PerLink& near, double aim, bool push_out);
  QpStart held_by(const Change& lower) const;
  bool want_more_rows(const PerLink& near);
  void want_none();
  bool restore(const PerLink& allowed);
  Configuration moved(const Configuration& q, const Change& change, double share) const;
  // What a programme's answer says beside the change: which contacts press, and whether more than they end it.
  struct Contacts {
    bool known;  // all that press now did before
    bool kept;   // all that pressed before, joint limits with them, still do
    bool whole;  // no bound on the length of a step ended it
  };
  Contacts remember_active(const QpResult& result);
  void publish();
};

}  // namespace palmar
