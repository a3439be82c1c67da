"""Metrics of the fingertip forces. Formulas: docs/metrics.md.

Magnitude: norm of the five fingertips' forces stacked, 15 numbers. Step of force: per finger, as a vector.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, NotMeasured
from palmar.eval.judge import fingertip_force, fingertips, graphic_poses, haptic_poses

Array = NDArray[np.float64]
FLOOR_N = 0.05  # below it a change in per cent says nothing
SETTLE_STEPS = 10
FADE_S = 0.1  # the default of the setting


def force_variation(case: Case) -> Array:
    """(n,) %: change of the magnitude from the step before, in the hold phase (the paper's V.D); NaN outside."""
    return _variation(case, case.run.fingertip_force_n)


def force_variation_ratio(case: Case) -> Array:
    """(1,) mean force variation by that of the graphic hand frozen at the first pose of the hold."""
    variation = force_variation(case)
    hold = np.flatnonzero(case.in_phase("hold"))
    graphic = graphic_poses(case.run)[np.full(len(hold), hold[0])]
    frozen = np.zeros_like(case.run.fingertip_force_n)
    frozen[hold] = fingertip_force(case.pack.hand, graphic, haptic_poses(case.run)[hold])
    floor = np.nanmean(_variation(case, frozen))
    if floor == 0:
        raise NotMeasured("the input of the hold is constant, so the ratio is 0/0 or without bound")
    return np.array([np.nanmean(variation) / floor])


def _variation(case: Case, force: Array) -> Array:
    hold = case.in_phase("hold")
    both = np.flatnonzero(hold[1:] & hold[:-1]) + 1
    if not len(both):
        raise NotMeasured("no phase named hold of two steps or more")
    magnitude = np.linalg.norm(force.reshape(len(force), -1), axis=1)
    variation = np.full(len(force), np.nan)
    variation[both] = np.abs(magnitude[both] - magnitude[both - 1]) / np.maximum(magnitude[both - 1], FLOOR_N)
    return 100 * variation


def excess_force_step(case: Case) -> Array:
    """(n,) N: largest step of a fingertip's force beyond stiffness times that of the haptic fingertip; NaN at first.

    Where hand and object both move, the haptic fingertip's step is that in the world. Forces of a hand that is lost are
    told to fade, so there only what they grow by counts; while they grow back, what is beyond the pace of that.
    """
    tip = fingertips(case.pack.hand, haptic_poses(case.run))
    allowed = case.pack.hand.palm_stiffness_n_per_m[0] * np.linalg.norm(np.diff(tip, axis=0), axis=2)
    lost, recovering = case.has_status("bad_sample")[1:], case.has_status("recovering")
    back = recovering[1:] | recovering[:-1]  # the last step of the growth has no such status any more
    if back.any():
        spring = fingertip_force(case.pack.hand, graphic_poses(case.run), haptic_poses(case.run))[1:]
        pace = np.diff(case.run.time_s) / case.settings().get("fade_s", FADE_S)
        allowed += np.where(back, pace, 0.0)[:, None] * np.linalg.norm(spring, axis=2)
    grown = np.diff(np.linalg.norm(case.run.fingertip_force_n, axis=2), axis=0)
    changed = np.where(lost[:, None], grown, _force_step(case) - allowed)
    return _from_second_step(np.maximum(0, changed).max(axis=1))


def still_force_step(case: Case) -> Array:
    """(n,) N: largest step of a fingertip's force where the input has been constant for 10 steps; NaN elsewhere."""
    still = case.still_steps > SETTLE_STEPS
    if not still.any():
        raise NotMeasured(f"the input is never constant for more than {SETTLE_STEPS} steps")
    return np.where(still, _from_second_step(_force_step(case).max(axis=1)), np.nan)


def friction_force(case: Case) -> Array:
    """(n,) N: what of the force on the palm no contact's force along its normal explains; NaN without a contact.

    Contacts are without friction, and where a step has converged their forces add up to the palm's.
    """
    run = case.run
    if not run.contact_force_n.any():
        raise NotMeasured("the run states no contact forces")
    step = np.repeat(np.arange(len(run.time_s)), np.diff(run.contact_start))
    pushed = np.zeros((len(run.time_s), 3))
    np.add.at(pushed, step, run.contact_force_n[:, None] * run.contact_normal)
    left = np.linalg.norm(run.palm_force_n - pushed, axis=1)
    return np.where(np.diff(run.contact_start) > 0, left, np.nan)


def _force_step(case: Case) -> Array:
    """(n - 1, 5) N."""
    return np.linalg.norm(np.diff(case.run.fingertip_force_n, axis=0), axis=2)


def _from_second_step(values: Array) -> Array:
    return np.concatenate([[np.nan], values])
