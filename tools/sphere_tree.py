"""From a closed mesh to levels of spheres: the leaves within an error, or the best for a count.

Let d(c) be the distance from a point c inside to the surface. The ball (c, d(c) + eps) sticks out by at most eps, and
with g(s, c) = |s - c| - d(c) >= 0 the surface point s lies max(0, min over c of g - eps) outside the union. So centres
are chosen, few of them, that make G, the 99th percentile over s of min g, small; eps = G / 2 then shares it evenly
between protrusion and gap. With eps = 0 nothing sticks out; to cover everything, eps = G and the balls that the
uncovered rest needs least of grow until every triangle, cut in pieces, lies in balls.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar import _runtime
from palmar._runtime import CoverFit
from palmar.errors import BadMesh
from palmar.model import Bounds
from palmar.tools.corners import cover_corners
from palmar.tools.cover import protrusion, union_gap, weighted_quantile
from palmar.tools.hierarchy import bounds_over, in_tree_order
from palmar.tools.medial import medial_balls, within
from palmar.tools.solid import Solid, closest_points, make_solid, sample_surface, smooth_normals

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

CAP = 200_000
# The share of the surface that G holds for; the rest is corners, and dear. Where all is to be covered, the rest grows.
MODES = {"balanced": 0.99, "inside": 0.99, "outside": 0.998}
# Finer than this share of the object's size, spheres would copy the facets of a round mesh one by one.
_FINEST = 1e-4
_JUDGED = 60_000  # independent samples
_ALLOWED = 0.975  # of the error: what the 99th percentile varies by between sets of samples
_PIECE = 0.05  # of G: by how much a ball may grow too far for full cover
_WORST = 1.9  # times G: what even a corner or an edge should not exceed
_CORNERS = 0.05  # share of a given count that may go to them
_RESERVE = 0.012  # share kept for corners that are left at the end
# Samples a ball, longest step in discs, rounds: many short rounds first, then ever more samples to trust.
_PHASES = ((60, 0.4, 15), (150, 0.3, 20), (500, 0.2, 12))
_FEW = 12
# A level above the leaves has a share of the spheres of the one below, starts from those, and needs one phase.
_SHRINK = 4
_LEVEL = (150, 0.4, 14)
_MOST_SAMPLES = 1_500_000
_MOVES = 4  # a ball and round
# Low and high end of what a sample may cost, in G; and how much worse a move may make it, in samples of a ball's share.
_LOW, _HIGH = 0.9, 1.4
_TEMPERATURE = 0.004


def build_levels(
    vertices_m: Array,
    faces: NDArray[np.integer],
    *,
    error_m: float | None,
    spheres: int | None,
    mode: str = "balanced",
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[list[Array], list[Bounds], dict[str, Any]]:
    """Levels of spheres (n_k, 4), coarse to fine, the bounds over each, and what was asked and reached.

    Each level above the leaves is fitted to the mesh as they are, with a quarter of the spheres of the one below.

    vertices_m (v, 3), faces (f, 3): closed, outward, in metres. Exactly one of error_m and spheres (the least error
    with at most so many leaves). mode, of every level: "balanced": least error both ways; within error_m, protrusion is at most that
    anywhere and gap at the 99th percentile. "inside": no protrusion beyond 1 um; gap at the 99th percentile within
    error_m. "outside": no point of the surface uncovered; protrusion at the 99th percentile within error_m.
    progress(text, fraction) is told what goes on. Same input and seed, same bytes.
    Raises BadMesh where the error needs more than 200,000 leaves, or the mesh has no inside.
    """
    assert (error_m is None) != (spheres is None), "give error_m or spheres"
    assert mode in MODES, mode
    tell = progress or (lambda text, fraction: None)
    solid = make_solid(vertices_m, faces)
    if error_m is not None:
        if not error_m > 0:
            raise BadMesh("E-MESH-ERROR", "error", f"{error_m * 1e3:g} mm; an error above 0 is needed")
        balls = _within_error(solid, error_m, mode, seed, tell)
    else:
        assert spheres is not None
        if not 1 <= spheres <= CAP:
            raise BadMesh("E-MESH-SPHERES", "spheres", f"{spheres} spheres; 1 to {CAP} are possible")
        balls = _within_count(solid, spheres, mode, seed, tell)

    leaves, parameters = _finish(solid, balls, mode, seed)
    levels = [*_levels_above(solid, balls, mode, seed, tell), leaves]
    tell("search trees", 0.97)
    ordered = [in_tree_order(level) for level in levels]
    tell("done", 1.0)
    asked: dict[str, Any] = {"error_mm": error_m * 1e3} if error_m is not None else {"spheres": spheres}
    about = {**asked, "mode": mode, "seed": seed, **parameters}
    return [level for level, _ in ordered], [bounds for _, bounds in ordered], about


def levels_over(
    vertices_m: Array, faces: NDArray[np.integer], leaves: Array, seed: int = 0, progress: Progress | None = None
) -> tuple[list[Array], list[Bounds]]:
    """Levels as of `build_levels` and their bounds for leaves (n, 4) from elsewhere, which stay as they are.

    Raises BadMesh.
    """
    solid = make_solid(vertices_m, faces)
    above = _levels_above(solid, within(solid, leaves), "balanced", seed, progress or (lambda text, fraction: None))
    levels = [*above, leaves]
    return levels, [bounds_over(level) for level in levels]


def _levels_above(solid: Solid, balls: Array, mode: str, seed: int, tell: Progress) -> list[Array]:
    """Levels of spheres (n_k, 4), coarse to fine, each with a quarter of the next one's count and the least error found.

    balls (n, 4): centres inside the solid, those of the level below.
    """
    levels: list[Array] = []
    density, step, rounds = _LEVEL
    budget = 0.0
    while len(balls) > 1:
        tell("levels", 0.95)
        count = -(-len(balls) // _SHRINK)
        fit = _make_fit(solid, max(min(density * count, _MOST_SAMPLES), 6_000), seed + 40 + len(levels))
        budget = _SHRINK * budget or _budget_for(solid, balls, count)
        fit.set_budget(_LOW * budget, _HIGH * budget)
        fit.set_balls(solid.triangles, balls)
        fit.remove(len(balls) - count)
        budget = _improve(fit, count, budget, mode, (density, step, rounds), 2 * _FINEST * solid.size)
        balls = within(solid, fit.balls())
        if not len(balls):
            break
        levels.insert(0, _finish(solid, balls, mode, seed)[0])
    return levels


def _finish(solid: Solid, balls: Array, mode: str, seed: int) -> tuple[Array, dict[str, float]]:
    """Leaves (n, 4) from centres and inside distances, and what holds for them."""
    if mode == "balanced":
        eps = _judge(solid, balls, MODES[mode], seed) / 2
        # Facets finer than the floating point of the mesh still need a ball that overlaps its neighbours.
        leaves = balls + np.array([0, 0, 0, max(eps, 1e-9 * solid.size)])
        return leaves, {"protrusion_bound_mm": eps * 1e3, "balanced_p99_mm": eps * 1e3}
    leaves = balls if mode == "inside" else _covering(solid, balls, seed)
    exact, _, _ = closest_points(solid, leaves[:, :3])  # by another search tree than the one that fitted them
    if mode == "inside":
        leaves = np.column_stack([leaves[:, :3], np.minimum(leaves[:, 3], exact)])
    bound = float((leaves[:, 3] - exact).max())
    reach = _judge(solid, leaves, MODES[mode], seed) if mode == "inside" else _protrusion_p99(solid, leaves, seed)
    return leaves, {"protrusion_bound_mm": bound * 1e3, "balanced_p99_mm": reach / 2 * 1e3}


def _covering(solid: Solid, balls: Array, seed: int) -> Array:
    """The balls (n, 4) grown until every point of the surface lies in one."""
    reach = max(_judge(solid, balls, MODES["outside"], seed), 1e-6 * solid.size)
    grown = balls + np.array([0, 0, 0, reach])
    radii = _runtime.radii_to_cover(np.ascontiguousarray(grown), solid.vertices, solid.faces, _PIECE * reach)
    return np.column_stack([balls[:, :3], radii + 1e-9 * solid.size])


def _protrusion_p99(solid: Solid, leaves: Array, seed: int) -> float:
    return weighted_quantile(*protrusion(solid, leaves, _JUDGED // 4, seed + 17), 0.99)


def _within_count(solid: Solid, count: int, mode: str, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4), n <= count, with the least G found."""
    finest = 2 * _FINEST * solid.size
    balls = _candidates(solid, count, seed)
    budget = _budget_for(solid, balls, count)
    balls = _spread(balls, count, budget, seed)
    corners, total = np.empty((0, 4)), count
    for phase, (density, step, rounds) in enumerate(_phases(count)):
        if phase == len(_PHASES) - 1:
            corners = cover_corners(solid, balls, _WORST * budget, seed + 9, int(_CORNERS * count))
            count -= int(_RESERVE * count)
        fit = _make_fit(solid, density * count, seed + 20 + phase)
        fit.set_budget(_LOW * budget, _HIGH * budget)
        fit.set_balls(solid.triangles, np.concatenate([corners, balls]), len(corners))
        fit.remove(len(corners) + len(balls) - count)
        budget = _improve(
            fit,
            count,
            budget,
            mode,
            (density, step, rounds),
            finest,
            lambda part, phase=phase: tell("improve", 0.1 + 0.8 * (phase + part) / len(_PHASES)),  # type: ignore[misc]
        )
        balls = fit.balls()
        if phase == len(_PHASES) - 1:
            # What moved away from corners since; and what is left of the reserve where most is bare.
            more = cover_corners(solid, balls, _WORST * budget, seed + 10, total - len(balls))
            fit.set_balls(solid.triangles, np.concatenate([balls, more]))
            fit.add(total - len(balls) - len(more), 6)
            balls = fit.balls()
        del fit  # before the next takes its memory
    return within(solid, balls)


def _improve(
    fit: CoverFit,
    count: int,
    budget: float,
    mode: str,
    phase: tuple[int, float, int],
    finest: float,
    tell: Callable[[float], None] = lambda part: None,
) -> float:
    """Rounds of exchange and polish for `count` balls, while the budget follows the G that is reached; returns it."""
    density, step, rounds = phase
    for turn in range(rounds):
        tell(turn / rounds)
        fit.exchange(count // 2, 6)
        fit.add(count - len(fit.balls()), 6)
        fit.polish(step, _MOVES, _temperature(density, turn, rounds))
        reached = fit.quantile(MODES[mode])
        budget = max(1.02 * reached if reached < 0.999 * _HIGH * budget else _HIGH * budget, finest)
        fit.set_budget(_LOW * budget, _HIGH * budget)
    if budget == finest:
        fit.remove_useless()
    return budget


def _within_error(solid: Solid, error: float, mode: str, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4) that keep the error on independent samples."""
    budget = (2 if mode == "balanced" else 1) * error * _ALLOWED
    expected = _expected_count(solid, _candidates(solid, 200, seed), budget)
    if expected > 4 * CAP:
        raise _too_fine(error, f"needs about {expected:,.0f} spheres, {CAP:,} are possible")
    count = int(np.clip(0.8 * expected, 1, CAP))
    balls = _spread(_candidates(solid, count, seed), count, budget, seed)
    corners = np.empty((0, 4))
    target = budget
    for phase, (density, step, rounds) in enumerate(_phases(count)):
        fit = _make_fit(solid, density * count, seed + 20 + phase)
        fit.set_budget(_LOW * target, _HIGH * target)
        fit.set_balls(solid.triangles, np.concatenate([corners, balls]), len(corners))
        for turn in range(rounds):
            tell("improve", 0.1 + 0.8 * (phase + turn / rounds) / len(_PHASES))
            fit.exchange(len(balls) // 2, 6)
            fit.polish(step, _MOVES, _temperature(density, turn, rounds))
            _settle(fit, target, MODES[mode], 0.5 if turn < rounds - 2 else 1.0)
            balls = fit.balls()
        balls = within(solid, balls)
        # What a set of samples of this density flatters by, the next is held to.
        if phase == 1:
            balls = balls[len(corners) :]
            corners = cover_corners(solid, balls, _WORST * budget, seed + 9, CAP)
        target = budget * 0.99
    if len(balls) <= _FEW:
        # As good as so many can be: one ball for a sphere, in its middle.
        for turn in range(20):
            closer = max(1.02 * fit.quantile(MODES[mode]), 0.1 * _FINEST * solid.size)
            fit.set_budget(_LOW * closer, _HIGH * closer)
            fit.polish(0.3 * 0.8**turn, _MOVES, 0.0)
        balls = within(solid, fit.balls())
    for _ in range(60):
        if mode == "outside":
            reach = _protrusion_p99(solid, _covering(solid, balls, seed), seed)
        else:
            reach = _judge(solid, balls, MODES[mode], seed)
        if reach <= budget:
            return np.concatenate([balls, cover_corners(solid, balls, _WORST * budget, seed + 10, CAP - len(balls))])
        if len(balls) >= CAP or target < budget / 3:
            raise _too_fine(error, f"is not reached with {len(balls):,} of {CAP:,} spheres")
        target *= max(min(budget / reach, 0.998), 0.9)
        fit.set_budget(_LOW * target, _HIGH * target)
        _settle(fit, target, MODES[mode], 1.0)
        fit.polish(0.1, _MOVES, 0.0)
        balls = within(solid, fit.balls())
    raise _too_fine(error, f"is not reached with {len(balls):,} of {CAP:,} spheres")


def _settle(fit: CoverFit, target: float, covered: float, share: float) -> None:
    """Add or remove balls for G = target: error falls as 1 / count, and `share` of the way is gone."""
    fit.set_budget(_LOW * target, _HIGH * target)
    fit.remove_useless()
    count = len(fit.balls())
    wanted = count * (1 + share * (min(fit.quantile(covered) / target, _HIGH) - 1))
    if wanted > count:
        fit.add(min(int(np.ceil(wanted)), CAP) - count, 6)
    elif wanted < count - 1:
        fit.remove(int(count - wanted))


def _too_fine(error: float, found: str) -> BadMesh:
    return BadMesh("E-MESH-ERROR", "error", f"{error * 1e3:g} mm {found}; ask for a larger error")


def _phases(count: int) -> list[tuple[int, float, int]]:
    """Samples a ball, step and rounds; fewer for so many balls, for the time and memory that they take."""
    fewer = min(1.0, (2_000 / max(count, 1)) ** 0.45)
    most = _MOST_SAMPLES // count
    return [
        (max(min(density, most), 6_000 // count), step, max(2, round(fewer * rounds)))
        for density, step, rounds in _PHASES
    ]


def _temperature(density: float, turn: int, rounds: int) -> float:
    """Falls to 0 over the first seven tenths of a phase."""
    return _TEMPERATURE * density * max(0.0, 1 - turn / (0.7 * rounds))


def _make_fit(solid: Solid, samples: int, seed: int) -> CoverFit:
    points, face = sample_surface(solid, samples, seed)
    threads = min(os.cpu_count() or 1, 8)
    return CoverFit(solid.triangles, points, -smooth_normals(solid, points, face), face, seed, threads)


def _candidates(solid: Solid, count: int, seed: int) -> Array:
    """Medial balls behind area-uniform points, a few for each of `count`. Raises BadMesh if there are none."""
    points, face = sample_surface(solid, int(np.clip(8 * count, 1_000, max(25_000, 2 * count))), seed + 4)
    balls = within(solid, medial_balls(solid, points, face, 1e-3 * solid.size))
    if not len(balls):
        raise BadMesh("E-MESH-EMPTY", "mesh", "no point lies clearly inside; a mesh with a volume is needed")
    return balls


def _spread(balls: Array, count: int, budget: float, seed: int) -> Array:
    """At most `count` of the balls at random, the denser the smaller their discs (see `_expected_count`)."""
    weight = 1 / (2 * balls[:, 3] * budget + budget**2)
    picked = np.random.default_rng(seed).choice(
        len(balls), min(count, len(balls)), replace=False, p=weight / weight.sum()
    )
    return balls[picked]


def _budget_for(solid: Solid, balls: Array, count: int) -> float:
    """G that so many balls are expected to reach, with room."""
    low, high = 2 * _FINEST * solid.size, 2 * solid.size
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _expected_count(solid, balls, middle) > count else (low, middle)
    return float(1.3 * high)


def _expected_count(solid: Solid, balls: Array, budget: float) -> float:
    """Balls for flat sides: each covers a disc of radius^2 2 R G + G^2 on two of them, in a hexagonal covering."""
    radius = balls[:, 3]
    return float(solid.areas.sum() / 2 * np.mean(1 / (2.598 * (2 * radius * budget + budget**2))))


def _judge(solid: Solid, balls: Array, share: float, seed: int) -> float:
    """G (see above) on samples that the choice has not seen: the worse of two sets."""
    sets = (sample_surface(solid, _JUDGED, seed + k)[0] for k in (7, 8))
    return max(0.0, *(float(np.quantile(union_gap(balls, points), share)) for points in sets))
