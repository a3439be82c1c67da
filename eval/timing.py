"""Metrics of what a step costs. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, NotMeasured

Array = NDArray[np.float64]


def contacts(case: Case) -> Array:
    """(n,) contact pairs handled."""
    return case.run.contacts.astype(np.float64)


def step_cpu(case: Case) -> Array:
    """(n,) us of thread CPU time."""
    return _measured(case.run.cpu_us)


def step_cpu_in_contact(case: Case) -> Array:
    """(n,) us of thread CPU time in steps with a contact, NaN in others."""
    touching = case.run.contacts > 0
    if not touching.any():
        raise NotMeasured("no step in contact")
    return np.where(touching, step_cpu(case), np.nan)


def step_wall(case: Case) -> Array:
    """(n,) us of wall time."""
    return _measured(case.run.wall_us)


def step_operations(case: Case) -> Array:
    """(n,) operations used."""
    return case.run.operations.astype(np.float64)


def _measured(times_us: Array) -> Array:
    if not np.isfinite(times_us).any():
        raise NotMeasured("the run has no timing")
    return times_us
