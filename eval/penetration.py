"""Metrics of where the graphic hand is: inside, hovering, on the wrong side. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, NotMeasured
from palmar.eval.far_side import far_side_of, on_far_side
from palmar.eval.judge import gap_to_mesh, wrong_side

Array = NDArray[np.float64]


def penetration_spheres(case: Case) -> Array:
    """(n,) mm: deepest overlap of the exact graphic hand with the spheres of the run's level."""
    return 1e3 * np.maximum(0, -case.sphere_gap_m)


def penetration_mesh(case: Case) -> Array:
    """(n,) mm: deepest that the exact graphic hand is inside the true mesh."""
    return 1e3 * np.maximum(0, -np.hstack(case.mesh_gap_m).min(axis=1))


def penetration_mesh_limit(case: Case) -> float | None:
    """mm: 0.1 and the declared gap, since a hand outside all spheres may be that far inside the mesh."""
    declared = case.model_error.get("gap_mm", {}).get("max")
    return None if declared is None else 0.1 + declared


def hover(case: Case) -> Array:
    """(n, 15) mm: for each phalanx that reports contact its gap to the true mesh, 0 if it touches; else NaN."""
    if not case.phalanx_contact.any():
        raise NotMeasured("no phalanx reports contact")
    return 1e3 * np.maximum(0, gap_to_mesh(case.shape, case.mesh, case.phalanx_contact, tolerance_m=1e-6))


def wrong_side_steps(case: Case) -> Array:
    """(n,) 1 where a link's axis is inside the true mesh, went through it since the step before, or is where the scene
    says that it must never be; else 0."""
    crossed = wrong_side(case.shape, case.mesh, *case.mesh_gap_m)
    return (crossed | on_far_side(case.shape, far_side_of(case.run))).astype(np.float64)
