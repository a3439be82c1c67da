"""From centres to leaves: the radii of each mode, and what then holds, on samples that no choice has seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palmar import _runtime
from palmar.tools.cover import protrusion, weighted_quantile
from palmar.tools.solid import closest_points
from palmar.tools.target import EXCESS, Target

Array = NDArray[np.float64]

# The share of the surface that G holds for; the rest is corners, and dear. Where all is to be covered, the rest grows.
MODES = {"balanced": 0.99, "inside": 0.99, "outside": 0.998}
_JUDGED = 60_000  # independent samples
_PIECE = 0.05  # of G: by how much a ball may grow too far for full cover


def finish(target: Target, balls: Array, mode: str, seed: int) -> tuple[Array, dict[str, float]]:
    """Spheres (n, 4) from centres and inside distances (n, 4), and what holds for them."""
    if mode == "balanced":
        eps = judge(target, balls, mode, seed) / 2
        # Facets finer than the floating point of the mesh still need a ball that overlaps its neighbours.
        leaves = target.held(balls, eps) + np.array([0, 0, 0, max(eps, 1e-9 * target.solid.size)])
        return leaves, {"protrusion_bound_mm": eps * 1e3, "balanced_p99_mm": eps * 1e3}
    leaves = balls if mode == "inside" else covering(target, balls, seed)
    exact, _, _ = closest_points(target.solid, leaves[:, :3])  # by another search tree than the one that fitted them
    if mode == "inside":
        leaves = np.column_stack([leaves[:, :3], np.minimum(leaves[:, 3], exact)])
    bound = float((leaves[:, 3] - exact).max())
    reach = judge(target, leaves, mode, seed) if mode == "inside" else protrusion_p99(target, leaves, seed)
    return leaves, {"protrusion_bound_mm": bound * 1e3, "balanced_p99_mm": reach / 2 * 1e3}


def covering(target: Target, balls: Array, seed: int) -> Array:
    """The balls (n, 4) grown until every point of the surface lies in one."""
    solid = target.solid
    reach = max(judge(target, balls, "outside", seed), 1e-6 * solid.size)
    grown = target.held(balls, reach) + np.array([0, 0, 0, reach])
    radii = _runtime.radii_to_cover(np.ascontiguousarray(grown), solid.vertices, solid.faces, _PIECE * reach)
    return np.column_stack([balls[:, :3], radii + 1e-9 * solid.size])


def protrusion_p99(target: Target, leaves: Array, seed: int) -> float:
    return weighted_quantile(*protrusion(target.solid, leaves, _JUDGED // 4, seed + 17), 0.99)


def judge(target: Target, balls: Array, mode: str, seed: int) -> float:
    """G (see `target`) of the mode's share of each zone: the worse of two sets of samples."""
    sets = [target.sample(_JUDGED, seed + k) for k in (7, 8)]
    reached = 0.0
    # What the balls count with depends on G where there are zones: half of what it is off is gone with each turn.
    for _ in range(8 if target.patches else 1):
        excess = EXCESS[mode] * reached
        held = target.held(balls, excess)
        reached = 0.0
        for points, _, zone in sets:
            gap = target.gaps(held, points, zone, excess)
            for k in range(len(target.patches) + 1):
                if (zone == k).any():
                    reached = max(reached, float(np.quantile(gap[zone == k], MODES[mode])))
    return reached
