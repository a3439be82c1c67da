// What the solvers that are there for comparison share: their programme, its least-violation answer, and publishing.
#pragma once

#include "solver.h"

namespace palmar {

// Diagonal of G (Eq. 1); an abduction counts as its finger's first flexion.
Change stiffness_diagonal(const HandModel& hand);

// What the joint limits leave of each variable from q, never without zero; free for the palm.
void joint_room(const HandModel& hand, const Configuration& q, Change& lower, Change& upper);

// minimise (Q - Q_h)' G (Q - Q_h) / 2 (Eq. 2) in the change from q: joint limits, no bound on the step but one
// that keeps the palm in the room, abductions held (a variable of inverse weight 0 stays where it is).
QpProblem towards(const HandModel& hand, const Configuration& q, const Configuration& haptic);

// Angles brought inside the joint limits.
void clip_to_limits(const HandModel& hand, Configuration& q);

// Pairs of links first .. end - 1 within `margin` of the placement, and their gaps. A margin that finds more than fit
// is quartered, at most three times; false if even that is too much.
bool gather_near(const Scene& scene, const HandPlacement& at, double margin, int first_link, int end_link,
                 Workspace& work);

// Solves the programme with work.rows. If no change meets them all, every row of a finger gives way by one slack s that
// costs far more than anything else: the least violation, whatever the objective. The slack takes the place of the
// finger's abduction, which the programme must hold; rows of the palm share the thumb's. `relaxed` says so.
QpResult solve_least_violation(const Scene& scene, QpProblem problem, Workspace& work, bool& relaxed);

// Adds the programme's active rows to work.active, in newtons.
void remember_active(const Scene& scene, const QpResult& result, Workspace& work);

// Makes q the graphic hand, unverified; the work's candidates become the pairs that touch or overlap there.
// Returns status bits.
std::uint32_t publish_unverified(const Scene& scene, const Configuration& q, SolverState& state, Workspace& work);

}  // namespace palmar
