"""Metrics of which pairs are in contact. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, Flags, NotMeasured
from palmar.eval.force import SETTLE_STEPS

Array = NDArray[np.float64]


def contact_toggles(case: Case) -> Array:
    """(n,) 1 where the set of active contacts is another than the step before though the input stood still, else 0.

    NaN where the input has not been constant for 10 steps.
    """
    still = case.still_steps > SETTLE_STEPS
    if not still.any():
        raise NotMeasured(f"the input is never constant for more than {SETTLE_STEPS} steps")
    return np.where(still, changed(case), np.nan)


def contact_toggles_a_second(case: Case) -> Array:
    """(1,) 1/s: their sum by the time that the input stood still."""
    toggles = contact_toggles(case)
    times = case.run.time_s
    still = np.flatnonzero(~np.isnan(toggles))
    return np.array([np.nansum(toggles) / (times[still] - times[still - 1]).sum()])


def changed(case: Case) -> Flags:
    """(n,) steps whose set of active contacts, pairs of hand and object, is not that of the step before.

    Active is a contact with a force above 0; for a solver that states no forces, every contact reported.
    """
    run = case.run
    count = len(run.time_s)
    active = run.contact_force_n > 0
    if not active.any():
        active = np.ones(len(active), dtype=bool)
    step = np.repeat(np.arange(count), np.diff(run.contact_start))[active]
    pair = np.stack([run.contact_link, run.contact_palm_sphere, run.contact_object_sphere]).astype(np.int64)[:, active]
    order = np.lexsort((*pair, step))
    step, pair = step[order], pair[:, order]

    size = np.bincount(step, minlength=count)
    differs = np.concatenate([[False], size[1:] != size[:-1]])
    # Equal sizes: the k-th pair of a step stands `size` places after the k-th of the step before.
    later = np.flatnonzero((step > 0) & ~differs[step])
    other = (pair[:, later] != pair[:, later - size[step[later]]]).any(axis=0)
    differs[step[later[other]]] = True
    return differs
