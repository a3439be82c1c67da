// A solver moves the graphic hand one step towards the haptic hand. All solvers share this signature and these values.
#pragma once

#include <chrono>
#include <string>
#include <vector>

#include "contacts.h"
#include "curvature.h"
#include "force.h"
#include "hand.h"
#include "object.h"
#include "search.h"

namespace palmar {

struct Settings {
  std::string solver = "progressive";
  int level = -1;                  // of the object's SphereTree; -1 for the leaves
  std::string resample = "pchip";  // of the trace onto the step times: pchip, linear, hold
  double rate_hz = 1000;
  int iterations = 4;           // linearise-solve-verify rounds in one step
  int corrections = 2;          // re-linearisations at a trial pose that sinks in, in one round
  int qp_iterations = 300;      // rows added or dropped in one programme
  int operations = 35000;       // that one step may take, of about 15 ns each (contacts.h)
  int candidates = 2048;        // pairs that one link's list has room for
  double palm_priority = 1;     // how much rather a flexion yields than the palm's position; 1: as the springs have it
  double imposed_priority = 1;  // how much rather the palm's position yields than rotation and abduction; 1: likewise
  double reach_least_m = 2e-4;  // how far around the hand a step looks, at least
  double reach_most_m = 3e-3;   // and at most while anything is within it
  double free_reach_m = 0.1;    // and where nothing is
  double aim_m = 2e-7;          // gap that a linearised row asks for; what is published has gap >= 0
  double curvature = 1;         // share of the contacts' curvature that the programme knows
  double joint_step_rad = 0.0174;  // an angle changes by at most this in a step, or by what the haptic one did if more
  double force_step_n = 0;         // above 0: forces follow the spring's at most so much a step faster than the
                                   // haptic hand's own motion explains
  double release_after_s = 0.5;    // a hand whose haptic one has been free for so long, and
  double release_beyond_m = 0.1;   // its palm farther away than this, is let go around the object
  double object_jump_m = 0.05;     // an object that moves farther in one step has been put there, and does not push
  double fade_s = 0.1;  // forces fade to zero in this time when tracking is lost or a hand let go, and grow back
  std::string filter = "none";     // of the samples: none, one_euro
  double filter_cutoff_hz = 1;     // of one_euro at rest
  double filter_beta = 3;          // Hz by which its cutoff grows for each rad/s, or each 50 mm/s of the palm
  std::string leave_out = "none";  // parts of the hand that touch nothing (links_of)
  double settled_m = 1e-7;         // a step that would move the hand less leaves it, bit for bit
};

// A pair of the last programme's active rows, and its multiplier: what bends the next programme's objective.
struct Pressing {
  int link;
  std::uint32_t object_sphere, palm_sphere;
  double multiplier;
};

// Everything that the next step starts from. Poses are in the object's frame.
struct SolverState {
  Configuration graphic;    // verified: no gap below zero
  HandPlacement placement;  // of graphic
  Configuration haptic;     // of the step before
  PerLink reach{};          // how far around each link the next step looks
  std::array<Pressing, kVariables> pressing;
  int pressing_count = 0;
  std::uint32_t at_limit = 0;  // bit v: the last programme's answer held variable v at its joint limit
  bool resting = false;        // the step moved nothing, and another one with this haptic pose would not either
  std::uint32_t status = 0;    // of that step
  Change velocity{};           // of graphic, where a solver integrates over time
  bool started = false;
};

struct ActiveContact {
  std::int32_t candidate;
  double multiplier;
};

// A pair that has pressed, and its shape at the pose of a round's start.
struct BentPair {
  int link;
  std::uint32_t object_sphere, palm_sphere;
  GapShape shape;
};

// Memory that a step works in, allocated once.
struct Workspace {
  explicit Workspace(const Settings& settings);
  Candidates candidates;
  std::vector<double> gap, trial_gap;  // of the pairs, by number: at the graphic pose, at a pose on trial
  QpRows rows;
  std::vector<double> violation;            // of the rows
  std::vector<std::int32_t> row_candidate;  // pair of each row
  std::vector<std::uint8_t> wanted;         // pairs that get a row however far away, and
  std::vector<std::int32_t> wanted_pair;    // their numbers
  int wanted_count = 0;
  std::array<BentPair, 2 * kVariables> bent;
  int bent_count = 0;
  std::array<ActiveContact, kVariables> active;  // of the last programme that was accepted
  int active_count = 0;
  std::uint32_t operations = 0;       // of this step so far: nodes visited, gaps evaluated, rows made, programmes
  std::uint32_t operations_most = 0;  // that it may take
  std::uint32_t left() const { return operations_most - std::min(operations_most, operations); }
  double search_us = 0, solve_us = 0, verify_us = 0;
};

using Clock = std::chrono::steady_clock;

inline double microseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::micro>(Clock::now() - start).count();
}

struct Scene {
  const HandModel& hand;
  const PalmGroups& palm;
  const CollisionObject& object;
  const Settings& settings;
};

// Moves state.graphic towards `haptic` (object frame, inside the joint limits). Returns status bits. Allocates nothing.
using SolveFunction = std::uint32_t (*)(const Scene&, const Configuration& haptic, SolverState&, Workspace&);

std::uint32_t solve_progressive(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);
std::uint32_t solve_paper(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);
std::uint32_t solve_monolithic(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);
std::uint32_t solve_aggregate(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);
std::uint32_t solve_god_object(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);
std::uint32_t solve_penalty(const Scene& scene, const Configuration& haptic, SolverState& state, Workspace& work);

struct SolverRow {
  const char* name;
  SolveFunction solve;
  const char* what;
};

inline constexpr SolverRow SOLVERS[] = {
    {"progressive", solve_progressive, "down one spring energy; every published pose verified"},
    {"paper", solve_paper, "the published method: palm, then fingers, one linearisation each"},
    {"monolithic", solve_monolithic, "one programme over palm and fingers, one linearisation"},
    {"aggregate", solve_aggregate, "monolithic, the contacts of each region of a link merged into one"},
    {"god_object", solve_god_object, "constrained motion up to the next contact, repeated"},
    {"penalty", solve_penalty, "hand on spring-dampers, contacts as springs, integrated over time"},
};

}  // namespace palmar
