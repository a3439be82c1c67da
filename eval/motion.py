"""Metrics of how the graphic hand moves beside the haptic hand. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, NotMeasured
from palmar.eval.judge import carried, haptic_poses, shape_in_object

Array = NDArray[np.float64]
EASY_DEG = 1.0  # a joint may always turn so far in a step: a 60 degree flexion in 100 ms peaks near 1.1 degree a ms
CATCH_UP_S = 0.1  # 100 degrees at the 1 degree a step that a finger may swing
ROUNDING = 1e-6  # mm, degrees: a lag below it is rounding between the object's frame and the world
RECOVERY = "recovery"  # phases of this name may have larger steps


def joint_step_excess(case: Case) -> Array:
    """(n,) degrees: largest step of a graphic joint beyond that of the haptic joint or 1 degree; NaN in recovery."""
    excess = _joint_step_excess(case)
    excess[case.in_phase(RECOVERY)] = np.nan
    return excess


def joint_step_excess_in_recovery(case: Case) -> Array:
    """(n,) degrees: the same inside phases named recovery, NaN outside."""
    recovery = case.in_phase(RECOVERY)
    if not recovery.any():
        raise NotMeasured(f"no phase named {RECOVERY}")
    return np.where(recovery, _joint_step_excess(case), np.nan)


def _joint_step_excess(case: Case) -> Array:
    run = case.run
    graphic = np.abs(np.diff(_joints_deg(run.flexion_rad, run.abduction_rad), axis=0))
    haptic = np.abs(np.diff(_joints_deg(run.haptic_flexion_rad, run.haptic_abduction_rad), axis=0))
    excess = np.maximum(0, graphic - np.maximum(haptic, EASY_DEG))
    return np.concatenate([[np.nan], excess.max(axis=1)])


def _joints_deg(flexion: Array, abduction: Array) -> Array:
    return np.degrees(np.hstack([flexion.reshape(len(flexion), 15), abduction]))


def free_lag_joints(case: Case) -> Array:
    """(n,) degrees: largest difference of a graphic and a haptic joint in free steps, NaN in others."""
    run = case.run
    graphic = _joints_deg(run.flexion_rad, run.abduction_rad)
    haptic = _joints_deg(run.haptic_flexion_rad, run.haptic_abduction_rad)
    return _in_free_steps(case, np.abs(graphic - haptic).max(axis=1))


def free_lag_palm(case: Case) -> Array:
    """(n,) mm: distance of graphic and haptic palm in free steps, NaN in others."""
    return _in_free_steps(case, palm_offset(case))


def _in_free_steps(case: Case, lag: Array) -> Array:
    return np.where(_free(case), np.where(lag < ROUNDING, 0, lag), np.nan)


def _free(case: Case) -> NDArray[np.bool_]:
    """Steps with nothing in the way: the graphic hand of the step before is nearer to the haptic hand than to a sphere.

    Distance to the haptic hand is the farthest that any point has to go. Only steps that end CATCH_UP_S of such steps
    count: a finger let go by an object may swing back at a rate instead of jumping. A sample that was refused or cut at
    a joint limit does not count.
    """
    haptic = shape_in_object(case.pack.hand, haptic_poses(case.run), case.run)
    farthest = np.hstack(carried(case.shape[:-1], haptic[1:])).max(axis=1)
    free = np.concatenate([[False], farthest < case.sphere_gap_m[:-1]]) & ~case.has_status("bad_sample", "limit")
    last_held = np.maximum.accumulate(np.where(free, -np.inf, case.run.time_s))
    free &= case.run.time_s - last_held >= CATCH_UP_S
    if not free.any():
        raise NotMeasured("no step with nothing near the hand for long enough")
    return free


def palm_offset(case: Case) -> Array:
    """(n,) mm: distance of graphic and haptic palm."""
    return 1e3 * np.linalg.norm(case.run.palm_position_m - case.run.haptic_palm_position_m, axis=1)


def frozen_steps(case: Case) -> Array:
    """(n,) 1 where the pose of the step before was published because no better one could be verified, else 0."""
    return case.has_status("kept_previous").astype(np.float64)


def longest_freeze_ms(case: Case) -> Array:
    """(1,) ms: longest stretch of such steps, at the run's own step times."""
    frozen = case.has_status("kept_previous")
    times = case.run.time_s
    if not frozen.any():
        return np.zeros(1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], frozen.astype(int), [0]])))
    starts, ends = edges[::2], edges[1::2]
    step = np.median(np.diff(times)) if len(times) > 1 else 1e-3
    return np.array([1e3 * (times[ends - 1] - times[starts] + step).max()])
