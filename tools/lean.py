"""Leaner spheres for an object whose surface is not needed everywhere: fine in a region, coarse elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.model import SphereTree
from palmar.tools.cover import level_errors
from palmar.tools.fit import Progress
from palmar.tools.region import LEAST_SHARE, NO_REGIONS, Regions
from palmar.tools.solid import make_solid, sample_surface
from palmar.tools.sphere_tree import build_levels

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_PER_GUARD = 4  # samples of the surface along a guard distance
_MOST_SAMPLES = 200_000
_SIZES = 1.5  # of a ball by the next smaller
_ALL = 0.98  # of the surface: then there is no rest to leave coarse


def surface_samples(tree: SphereTree, guard_m: float, seed: int) -> Array:
    """Points (m, 3) of the true mesh, spread by area, about a quarter of the guard distance apart."""
    solid = make_solid(tree.vertices_m, tree.faces)
    count = int(np.clip(solid.areas.sum() / (guard_m / _PER_GUARD) ** 2, 2_000, _MOST_SAMPLES))
    return sample_surface(solid, count, seed + 60)[0]


def balls_over(points: Array, reached: Flags, guard_m: float) -> Array:
    """Balls (k, 4) that hold every reached point and its surroundings, and reach at most a guard beyond them.

    The largest first, in few sizes: what looks for the ball that holds a point looks through each size.
    """
    inside, outside = points[reached], points[~reached]
    if not len(inside):
        return np.empty((0, 4))
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    apart = cKDTree(outside).query(inside)[0] if len(outside) else np.full(len(inside), size)
    # Half a guard beyond what is reached, in steps down to a guard.
    steps = np.floor(np.log(np.maximum(apart / guard_m + 0.5, 1)) / np.log(_SIZES))
    radius = guard_m * _SIZES**steps
    tree, bare, balls = cKDTree(inside), np.ones(len(inside), dtype=np.bool_), []
    # Of one size those first that lie deepest, so that few stand at the border.
    for k in np.lexsort((-apart, -radius)):
        if bare[k]:
            # What lies between samples is held too: a ball answers for those it holds with room.
            bare[tree.query_ball_point(inside[k], radius[k] - guard_m / _PER_GUARD)] = False
            balls.append([*inside[k], radius[k]])
    return np.array(balls)


def own_error_mm(tree: SphereTree) -> float:
    """What the leaves were made within, or, where that was not asked for, what they came to."""
    parameters, leaves = tree.about.get("parameters", {}), tree.about["levels"][-1]
    if "error_mm" in parameters:
        return float(parameters["error_mm"])
    if "balanced_p99_mm" in parameters:
        return float(parameters["balanced_p99_mm"])
    return (leaves["gap_mm"]["p99"] + leaves["protrusion_mm"]["p99"]) / 2


def mode_of(tree: SphereTree) -> str:
    return str(tree.about.get("parameters", {}).get("mode", "balanced"))


def lean_tree(
    tree: SphereTree, seen_m: Array, share_seen: float, fine_mm: float, rest_mm: float, seed: int, progress: Progress
) -> SphereTree:
    """The object's tree fitted anew: within fine_mm in the balls seen_m (k, 4), within rest_mm elsewhere.

    In the mode of the tree. share_seen: of the surface, in the balls; where that is nearly all, all is fine. Without
    the figures of its levels, which `measured` adds. Raises BadMesh.
    """
    rest_mm = rest_of(fine_mm, rest_mm)
    regions = NO_REGIONS
    error_mm = fine_mm
    if share_seen < _ALL and rest_mm > fine_mm:
        error_mm = rest_mm
        regions = Regions(seen_m, np.full(len(seen_m), fine_mm / rest_mm)) if len(seen_m) else NO_REGIONS
    levels, bounds, parameters = build_levels(
        tree.vertices_m,
        tree.faces,
        error_m=error_mm / 1e3,
        spheres=None,
        mode=mode_of(tree),
        regions=regions,
        seed=seed,
        progress=progress,
    )
    about = {**tree.about, "method": "tuned", "parameters": parameters}
    about["levels"] = [{"spheres": len(level)} for level in levels]
    return SphereTree(levels, bounds, tree.vertices_m, tree.faces, about)


def rest_of(fine_mm: float, rest_mm: float) -> float:
    """The error of the rest: as asked, but not so coarse that no share of it is fine."""
    return min(max(rest_mm, fine_mm), fine_mm / LEAST_SHARE)


def measured(tree: SphereTree, seed: int) -> SphereTree:
    """The tree with the errors of its levels in its part of the manifest."""
    levels = level_errors(tree.levels, tree.vertices_m, tree.faces, seed)
    return SphereTree(tree.levels, tree.bounds, tree.vertices_m, tree.faces, {**tree.about, "levels": levels})
