"""Candidates for leaf spheres: balls inside a solid that touch its surface, with their exact inside distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.tools.solid import Solid, signed_distance, smooth_normals

Array = NDArray[np.float64]

_QUICK_ROUNDS = 10
_EXACT_ROUNDS = 4


def medial_balls(
    solid: Solid, points: Array, face: NDArray[np.int64], slack: float, budget: float, surface: tuple[Array, ...]
) -> Array:
    """Centres and exact inside distances (k, 4), k <= n, of large balls behind surface points (n, 3) on faces (n,).

    Shrinking ball (Ma, Bae, Choi 2012): a ball tangent at the point shrinks until the surface enters it by at most
    slack; with slack above 0, dents and facets shallower than that do not stop it. First against the surface samples
    in surface, coarse to fine, then, merged by `budget`, against the mesh itself.
    """
    normals = smooth_normals(solid, points, face)
    radius = np.full(len(points), solid.size)
    for samples in surface:
        tree = cKDTree(samples)
        active = np.arange(len(points))
        for _ in range(_QUICK_ROUNDS):
            distance, nearest = tree.query(points[active] - radius[active, None] * normals[active], eps=0.02)
            entered = distance < radius[active] - slack - 1e-6 * solid.size
            active = active[entered]
            if not len(active):
                break
            radius[active] = _tangent_radius(points[active], normals[active], samples[nearest[entered]], radius[active])
        # Before the finer distance: far inside a round body it is dear, and there most balls are the same.
        balls = np.column_stack([points - radius[:, None] * normals, radius])
        kept = merged_indices(balls, budget / 4)
        points, normals, radius = points[kept], normals[kept], radius[kept]

    centre = balls[kept, :3]
    signed = np.empty(len(points))
    active = np.arange(len(points))
    for _ in range(_EXACT_ROUNDS):
        signed[active], nearest, _ = signed_distance(solid, centre[active])
        # Outside: behind a wall thinner than the slack. Shrink on.
        entered = -signed[active] < radius[active] - slack - 1e-6 * solid.size
        active, nearest = active[entered], nearest[entered]
        if not len(active):
            break
        radius[active] = _tangent_radius(points[active], normals[active], nearest, radius[active])
        centre[active] = points[active] - radius[active, None] * normals[active]
    signed[active] = signed_distance(solid, centre[active])[0] if len(active) else signed[active]
    return np.column_stack([centre, -signed])[signed < -1e-7 * solid.size]


def inside_balls(solid: Solid, centres: Array) -> Array:
    """The centres (n, 3) that lie inside, with their exact inside distance: (k, 4)."""
    signed, _, _ = signed_distance(solid, centres)
    keep = signed < -1e-7 * solid.size
    return np.column_stack([centres, -signed])[keep]


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


def _tangent_radius(point: Array, normal: Array, other: Array, radius: Array) -> Array:
    """Radius of the ball behind `point` that has `other` on its skin; never more than before."""
    chord = point - other
    depth = np.einsum("ij,ij->i", normal, chord)
    fitted = np.einsum("ij,ij->i", chord, chord) / (2 * np.maximum(depth, 1e-300))
    return np.where(depth > 0, np.minimum(fitted, radius), radius * 0.5)
