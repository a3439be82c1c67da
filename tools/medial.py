"""Candidates for leaf spheres: balls inside a solid that touch its surface, with their exact inside distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar.tools.solid import Solid, is_inside, signed_distance, smooth_normals

Array = NDArray[np.float64]


def medial_balls(solid: Solid, points: Array, face: NDArray[np.int64], slack: float) -> Array:
    """Centres and exact inside distances (k, 4), k <= n, of the largest balls behind surface points (n, 3).

    Shrinking ball (Ma, Bae, Choi 2012): a ball tangent at the point shrinks until the surface enters it by at most
    slack; with slack above 0, dents and facets shallower than that do not stop it.
    """
    return solid.triangles.shoot(points, -smooth_normals(solid, points, face), face, slack, 0.5 * solid.size)


def inside_balls(solid: Solid, centres: Array) -> Array:
    """The centres (n, 3) that lie inside, with their exact inside distance: (k, 4)."""
    signed, _, _ = signed_distance(solid, centres)
    keep = signed < -1e-7 * solid.size
    return np.column_stack([centres, -signed])[keep]


def within(solid: Solid, balls: Array) -> Array:
    """The balls (n, 4) whose centres the winding number says are inside."""
    return balls[is_inside(solid, balls[:, :3])] if len(balls) else balls


def merged_indices(balls: Array, budget: float) -> NDArray[np.int64]:
    """Which balls stay when only one, the largest, is kept of each group that covers much the same.

    A ball of radius R covers a disc of radius sqrt(2 R budget) within the budget; a group is a cell of 0.12 of it.
    """
    # Cells in powers of two, so that balls of like radius share a grid.
    exponent = np.round(np.log2(0.12 * np.sqrt(2 * balls[:, 3] * budget + budget**2)))
    cell = np.floor(balls[:, :3] / np.exp2(exponent)[:, None]).astype(np.int64)
    key = np.column_stack([cell, exponent.astype(np.int64)])
    order = np.lexsort((np.arange(len(balls)), -balls[:, 3]))
    _, first = np.unique(key[order], axis=0, return_index=True)
    return np.sort(order[first])
