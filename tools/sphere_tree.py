"""From a closed mesh to levels of spheres: the leaves within an error, or the best for a count.

Let d(c) be the distance from a point c inside to the surface. The ball (c, d(c) + eps) sticks out by at most eps, and
with g(s, c) = |s - c| - d(c) >= 0 the surface point s lies max(0, min over c of g - eps) outside the union. So centres
are chosen, few of them, that make G, the 99th percentile over s of min g, small; eps = G / 2 then shares it evenly
between protrusion and gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.tools.corners import cover_corners
from palmar.tools.cover import union_gap
from palmar.tools.hierarchy import levels_over as levels_over
from palmar.tools.medial import medial_balls, merged_indices
from palmar.tools.set_cover import Incidence, cover_greedily, find_incidence, ruin_and_recreate
from palmar.tools.solid import Solid, closest_points, make_solid, sample_surface

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

CAP = 200_000
UNCOVERED = 0.01  # the share beyond the 99th percentile
# Finer than this share of the object's size, spheres would copy the facets of a round mesh one by one.
_FINEST = 1e-4
_JUDGED = 60_000  # independent samples
_ALLOWED = 0.975  # of the error: what the 99th percentile varies by between sets of samples
_WORST = 1.6  # times G: what even a corner or an edge should not exceed
_CORNERS = 0.05  # share of a given count that may go to them
_MARGIN = 1.3  # candidates are made with pairs up to this much over the budget
_GREEDY_EXCESS = 1.12  # a greedy cover has so many more balls than it has after improving
_STEPS = (0.6, 0.45, 0.3, 0.3)


def build_levels(
    vertices_m: Array,
    faces: NDArray[np.integer],
    *,
    error_m: float | None,
    spheres: int | None,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[list[Array], list[NDArray[np.int32]], dict[str, Any]]:
    """Levels of spheres (n_k, 4), root first and leaves last, their parents, and what was asked and reached.

    vertices_m (v, 3), faces (f, 3): closed, outward, in metres. Exactly one of error_m (at most this protrusion
    anywhere, at most this gap at the 99th percentile) and spheres (the least error with at most so many leaves).
    progress(text, fraction) is told what goes on. Same input and seed, same bytes.
    Raises BadMesh where the error needs more than 200,000 leaves, or the mesh has no inside.
    """
    assert (error_m is None) != (spheres is None), "give error_m or spheres"
    tell = progress or (lambda text, fraction: None)
    solid = make_solid(vertices_m, faces)
    if error_m is not None:
        if not error_m > 0:
            raise BadMesh("E-MESH-ERROR", "error", f"{error_m * 1e3:g} mm; an error above 0 is needed")
        balls = _within_error(solid, error_m, seed, tell)
    else:
        assert spheres is not None
        if not 1 <= spheres <= CAP:
            raise BadMesh("E-MESH-SPHERES", "spheres", f"{spheres} spheres; 1 to {CAP} are possible")
        balls = _within_count(solid, spheres, seed, tell)

    tell("tree", 0.95)
    reach = _judge(solid, balls, seed)
    eps = reach / 2
    # Facets finer than the floating point of the mesh still need a ball that overlaps its neighbours.
    leaves = balls + np.array([0, 0, 0, max(eps, 1e-9 * solid.size)])
    levels, parents = levels_over(leaves)
    order = np.argsort(parents[-1], kind="stable")  # children of one parent side by side
    levels[-1], parents[-1] = leaves[order], parents[-1][order]
    tell("tree", 1.0)
    asked: dict[str, Any] = {"error_mm": error_m * 1e3} if error_m is not None else {"spheres": spheres}
    return levels, parents, {**asked, "seed": seed, "protrusion_bound_mm": eps * 1e3, "balanced_p99_mm": eps * 1e3}


@dataclass(frozen=True)
class _Candidates:
    """Balls (k, 4) to choose from, the samples they reach within a budget of G, and how many may stay uncovered."""

    balls: Array
    samples: Array
    surface: tuple[Array, Array]
    pairs: Incidence
    budget: float
    spare: int


def _within_error(solid: Solid, error: float, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4) with G <= 2 error on independent samples."""
    budget = 2 * error
    expected = _expected_count(solid, _medial_radii(solid, seed), budget)
    if expected > 4 * CAP:
        raise BadMesh(
            "E-MESH-ERROR",
            "error",
            f"{error * 1e3:g} mm needs about {expected:,.0f} spheres, {CAP:,} are possible; ask for a larger error",
        )
    tell("candidates", 0.05)
    made = _make_candidates(solid, budget, int(min(expected, CAP)), seed)
    target = budget * 0.95  # independent samples find a little more than those that were covered
    tell("cover", 0.25)
    chosen = cover_greedily(made.pairs.within(target), [], made.spare, CAP)
    _refuse_if_short(made, target, chosen, error)
    for turn, step in enumerate(_STEPS):
        tell("improve", 0.3 + 0.15 * turn)
        made = _move(solid, made, chosen, target, step, seed + turn)
        pairs = made.pairs.within(target)
        chosen = cover_greedily(pairs, list(range(len(chosen))), made.spare, CAP)
        chosen = ruin_and_recreate(pairs, chosen, made.spare, 1, _rounds(len(chosen)), seed + turn)
        if turn < 2:
            continue
        # What the corners' balls cover, the others need not.
        balls = _with_corners(solid, made, chosen, budget, seed, CAP)
        reach = _judge(solid, balls, seed)
        target *= np.clip(_ALLOWED * budget / max(reach, 1e-3 * budget), 0.8, 1.05)
    while reach > _ALLOWED * budget:
        target *= 0.995
        chosen = cover_greedily(made.pairs.within(target), chosen, made.spare, CAP)
        _refuse_if_short(made, target, chosen, error)
        balls = _with_corners(solid, made, chosen, budget, seed, CAP)
        reach = _judge(solid, balls, seed)
        target *= min(_ALLOWED * budget / reach, 1.0)
    return balls


def _within_count(solid: Solid, count: int, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4), n <= count, with the least G found."""
    finest = 2 * _FINEST * solid.size
    radii = _medial_radii(solid, seed)
    low, high = finest, 2 * solid.size
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _expected_count(solid, radii, middle) > count else (low, middle)
    budget = high
    tell("candidates", 0.05)
    made = _make_candidates(solid, budget, count, seed)
    for attempt in range(10):
        if not made.budget / 2 <= budget <= made.budget * _MARGIN:
            made = _make_candidates(solid, budget, count, seed)
        tell("cover", 0.2 + 0.01 * attempt)
        chosen = cover_greedily(made.pairs.within(budget), [], made.spare, 3 * count + 10)
        share = len(chosen) / max(_GREEDY_EXCESS * count, 1)
        if abs(share - 1) < 0.06 or (share <= 1 and (budget == finest or count < 12)):
            break
        # Error falls as 1 / count, but for a body of few balls, which needs as many at any error.
        change = np.clip(share, 0.4, 2.5) if share > 0.1 else 0.0
        budget = max(budget * change ** (1.0 if attempt < 4 else 0.5), finest)

    corners = int(_CORNERS * count)
    total, count = count, count - corners
    for turn, step in enumerate(_STEPS):
        tell("improve", 0.3 + 0.15 * turn)
        made = _move(solid, made, chosen, budget, step, seed + turn)
        chosen = list(range(len(chosen)))
        last = turn == len(_STEPS) - 1
        pairs = made.pairs.within(budget)
        chosen = cover_greedily(pairs, chosen, made.spare, 3 * count + 10)
        chosen = ruin_and_recreate(pairs, chosen, made.spare, count if last else 1, _rounds(len(chosen)), seed + turn)
        if not last and count >= 12:
            budget = max(budget * np.clip(len(chosen) / count, 0.8, 1.25), finest)
    # The last of the count go where the error is largest.
    count = total - len(_with_corners(solid, made, chosen, budget, seed, corners)) + len(chosen)
    if len(chosen) > count:
        chosen = [chosen[k] for k in cover_greedily(pairs.of(chosen), [], 0, count)]
    elif len(chosen) < count and budget > finest:
        chosen = cover_greedily(made.pairs.within(budget * len(chosen) / count), chosen, 0, count)
    return _with_corners(solid, made, chosen, budget, seed, total - len(chosen))


def _with_corners(solid: Solid, made: _Candidates, chosen: list[int], budget: float, seed: int, most: int) -> Array:
    """The chosen balls and at most `most` more for the corners."""
    balls = made.balls[chosen]
    return np.concatenate([balls, cover_corners(solid, balls, _WORST * budget, made.surface, seed + 9, most)])


def _refuse_if_short(made: _Candidates, target: float, chosen: list[int], error: float) -> None:
    """Raise BadMesh if the chosen balls do not cover what they should, or cannot at half of the budget either."""
    uncovered = made.pairs.samples - len(np.unique(made.pairs.within(target).of(chosen).sample))
    if len(chosen) >= CAP or uncovered > 2 * made.spare + 10 or target < error:
        raise BadMesh(
            "E-MESH-ERROR",
            "error",
            f"{error * 1e3:g} mm is not reached with {len(chosen):,} of {CAP:,} spheres; ask for a larger error",
        )


def _make_candidates(solid: Solid, budget: float, count: int, seed: int) -> _Candidates:
    """Candidates and samples in numbers fit for about `count` leaves at G near `budget`."""
    samples, _ = sample_surface(solid, int(np.clip(80 * count, 6_000, max(120_000, 12 * count))), seed + 1)
    surface = (sample_surface(solid, 2_000, seed + 2)[0], sample_surface(solid, 10_000, seed + 3)[0])
    points, face = sample_surface(solid, int(np.clip(8 * count, 600, max(25_000, 2 * count))), seed + 4)
    tried = [medial_balls(solid, points, face, slack, budget, surface) for slack in _slacks(solid, budget)]
    balls = np.concatenate(tried)
    if not len(balls):
        raise BadMesh("E-MESH-EMPTY", "mesh", "no point lies clearly inside; a mesh with a volume is needed")
    balls = balls[merged_indices(balls, budget)]
    pairs = find_incidence(balls, samples, budget * _MARGIN)
    return _Candidates(balls, samples, surface, pairs, budget, int(UNCOVERED * len(samples)))


def _move(solid: Solid, made: _Candidates, chosen: list[int], budget: float, step: float, seed: int) -> _Candidates:
    """The chosen balls, first and in order, and eight medial balls around each, for a finer choice.

    They start at random about `step` discs away (see `merged_indices`).
    """
    rng = np.random.default_rng(seed)
    balls = made.balls[chosen]
    reach = step * np.sqrt(2 * balls[:, 3] * budget + budget**2)
    starts = np.repeat(balls[:, :3], 8, axis=0)
    starts += rng.normal(size=starts.shape) * np.repeat(reach, 8)[:, None] / np.sqrt(3)
    _, points, face = closest_points(solid, starts)
    tight, slack = (
        medial_balls(solid, points[k::2], face[k::2], slack, budget / 4, made.surface)
        for k, slack in enumerate(_slacks(solid, budget))
    )
    balls = np.concatenate([balls, tight, slack])
    # Samples lie along a curve through space: every k-th of them is as even. Round bodies need fewer than expected.
    samples = made.samples[:: max(1, len(made.samples) // max(6_000, 80 * len(chosen)))]
    pairs = find_incidence(balls, samples, budget * 1.05)
    return _Candidates(balls, samples, made.surface, pairs, budget, int(UNCOVERED * len(samples)))


def _slacks(solid: Solid, budget: float) -> tuple[float, float]:
    """What may enter a candidate: tight ones follow the shape, slack ones pass over its facets; covers want both."""
    return max(0.03 * budget, 0.5 * _FINEST * solid.size), 0.4 * budget


def _medial_radii(solid: Solid, seed: int) -> Array:
    """Radii (n,) of the medial balls behind area-uniform points."""
    points, face = sample_surface(solid, 1_500, seed + 5)
    surface = (sample_surface(solid, 4_000, seed + 6)[0],)
    return medial_balls(solid, points, face, 1e-3 * solid.size, 1e-4 * solid.size, surface)[:, 3]


def _expected_count(solid: Solid, radii: Array, budget: float) -> float:
    """Balls for flat sides: each covers a disc of radius^2 2 R G + G^2 on two of them, in a hexagonal covering."""
    return float(solid.areas.sum() / 2 * np.mean(1 / (2.598 * (2 * radii * budget + budget**2))))


def _judge(solid: Solid, balls: Array, seed: int) -> float:
    """G (see above) on samples that the choice has not seen: the worse of two sets."""
    sets = (sample_surface(solid, _JUDGED, seed + k)[0] for k in (7, 8))
    return max(0.0, *(float(np.quantile(union_gap(balls, points), 1 - UNCOVERED)) for points in sets))


def _rounds(count: int) -> int:
    """Rounds of ruin and recreate: two a ball, then fewer, for the time that they take."""
    return 2 * min(count, 1000) + max(0, min(count, 20_000) - 1000)
