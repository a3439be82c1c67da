"""From a closed mesh to levels of spheres: the leaves within an error, or the best for a count.

Let d(c) be the distance from a point c inside to the surface. The ball (c, d(c) + eps) sticks out by at most eps, and
with g(s, c) = |s - c| - d(c) >= 0 the surface point s lies max(0, min over c of g - eps) outside the union. So centres
are chosen, few of them, that make G, the 99th percentile over s of min g, small; eps = G / 2 then shares it evenly
between protrusion and gap. With eps = 0 nothing sticks out; to cover everything, eps = G and the balls that the
uncovered rest needs least of grow until every triangle, cut in pieces, lies in balls.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.model import Bounds
from palmar.tools.finish import MODES as MODES
from palmar.tools.finish import finish
from palmar.tools.fit import CAP, Progress, thinned, within_count, within_error
from palmar.tools.hierarchy import bounds_over, in_tree_order
from palmar.tools.medial import within
from palmar.tools.region import NO_REGIONS, Regions
from palmar.tools.solid import make_solid
from palmar.tools.target import EXCESS, Target, make_target, zone_errors

Array = NDArray[np.float64]

_SHRINK = 4  # spheres of a level for each one of the level above
_ZONE_SAMPLES = 30_000


def build_levels(
    vertices_m: Array,
    faces: NDArray[np.integer],
    *,
    error_m: float | None,
    spheres: int | None,
    mode: str = "balanced",
    regions: Regions = NO_REGIONS,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[list[Array], list[Bounds], dict[str, Any]]:
    """Levels of spheres (n_k, 4), coarse to fine, the bounds over each, and what was asked and reached.

    Each level above the leaves is fitted to the mesh as they are, with a quarter of the spheres of the one below.
    vertices_m (v, 3), faces (f, 3): closed, outward, in metres. Exactly one of error_m and spheres (the least error
    with at most so many leaves). mode, of every level: "balanced": least error both ways; within error_m, protrusion
    is at most that anywhere and gap at the 99th percentile. "inside": no protrusion beyond 1 um; gap at the 99th
    percentile within error_m. "outside": no point of the surface uncovered; protrusion at the 99th percentile within
    error_m. regions: where only a share of the error is allowed, each by itself.
    progress(text, fraction) is told what goes on. Same input and seed, same bytes.
    Raises BadMesh where the error needs more than 200,000 leaves, or the mesh has no inside.
    """
    assert (error_m is None) != (spheres is None), "give error_m or spheres"
    assert mode in MODES, mode
    tell = progress or (lambda text, fraction: None)
    target = make_target(make_solid(vertices_m, faces), regions)
    if error_m is not None:
        if not error_m > 0:
            raise BadMesh("E-MESH-ERROR", "error", f"{error_m * 1e3:g} mm; an error above 0 is needed")
        balls = within_error(target, error_m, mode, seed, tell)
    else:
        assert spheres is not None
        if not 1 <= spheres <= CAP:
            raise BadMesh("E-MESH-SPHERES", "spheres", f"{spheres} spheres; 1 to {CAP} are possible")
        balls = within_count(target, spheres, mode, seed, tell)

    leaves, parameters = finish(target, balls, mode, seed)
    levels = [*_levels_above(target, balls, mode, seed, tell), leaves]
    tell("search trees", 0.97)
    ordered = [in_tree_order(level) for level in levels]
    tell("done", 1.0)
    asked: dict[str, Any] = {"error_mm": error_m * 1e3} if error_m is not None else {"spheres": spheres}
    about = {**asked, "mode": mode, "seed": seed, **parameters}
    if target.patches:
        error_m = error_m or parameters["balanced_p99_mm"] / 1e3 * (1 if EXCESS[mode] == 0.5 else 2)
        about["regions"] = zone_errors(target, leaves, error_m, _ZONE_SAMPLES, seed + 50)
    return [level for level, _ in ordered], [bounds for _, bounds in ordered], about


def levels_over(
    vertices_m: Array, faces: NDArray[np.integer], leaves: Array, seed: int = 0, progress: Progress | None = None
) -> tuple[list[Array], list[Bounds]]:
    """Levels as of `build_levels` and their bounds for leaves (n, 4) from elsewhere, which stay as they are.

    Raises BadMesh.
    """
    target = make_target(make_solid(vertices_m, faces), NO_REGIONS)
    inner = within(target.solid, leaves)
    above = _levels_above(target, inner, "balanced", seed, progress or (lambda text, fraction: None))
    levels = [*above, leaves]
    return levels, [bounds_over(level) for level in levels]


def _levels_above(target: Target, balls: Array, mode: str, seed: int, tell: Progress) -> list[Array]:
    """Levels of spheres (n_k, 4), coarse to fine, each with a quarter of the next one's count.

    balls (n, 4): centres inside the solid, those of the level below.
    """
    levels: list[Array] = []
    while len(balls) > 1:
        tell("levels", 0.95)
        balls = thinned(target, balls, -(-len(balls) // _SHRINK), mode, seed + 40 + len(levels))
        if len(balls):
            levels.insert(0, finish(target, balls, mode, seed)[0])
    return levels
