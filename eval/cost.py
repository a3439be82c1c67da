"""What the solver's answer costs beside that of a converged solution of the same step. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, NotMeasured
from palmar.eval.energy import spring_energy
from palmar.eval.judge import graphic_poses, haptic_poses
from palmar.records import Run

Array = NDArray[np.float64]
FLOOR_J = 5e-4  # of 1 N on a spring of 1 N/mm: shares of less say nothing


def cost_excess(case: Case) -> Array:
    """(n,) %: beyond the reference that started each step where the run did; NaN where there is none."""
    return _excess(case, case.reference.same_start if case.reference else None)


def cost_excess_own(case: Case) -> Array:
    """(n,) %: beyond the reference that followed the same haptic hand on its own way."""
    return _excess(case, case.reference.own_way if case.reference else None)


def _excess(case: Case, reference: Run | None) -> Array:
    """Below 0 where the run is cheaper: a hand that sinks in, or one in a better branch."""
    if reference is None:
        raise NotMeasured("no reference was given")
    run, hand = case.run, case.pack.hand
    if len(reference.time_s) != len(run.time_s):
        raise NotMeasured(f"the reference has {len(reference.time_s)} steps, the run {len(run.time_s)}")
    known = np.isfinite(reference.palm_position_m).all(axis=1) & ~case.has_status("bad_sample")
    if not known.any():
        raise NotMeasured(
            "the reference has no answer: no step has a force, or too many start from a pose that sinks in"
        )
    at = np.flatnonzero(known)
    haptic = haptic_poses(run)[at]
    best = spring_energy(hand, graphic_poses(reference)[at], haptic, abduction=True)
    mine = spring_energy(hand, graphic_poses(run)[at], haptic, abduction=True)
    excess = np.full(len(known), np.nan)
    excess[at] = 100 * (mine - best) / np.maximum(best, FLOOR_J)
    return excess
