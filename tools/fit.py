"""Centres inside a solid for the fewest balls within an error, or for the least error of so many: see `sphere_tree`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palmar._runtime import CoverFit
from palmar.errors import BadMesh
from palmar.tools.corners import cover_corners
from palmar.tools.finish import MODES, covering, judge, protrusion_p99
from palmar.tools.medial import medial_balls, within
from palmar.tools.target import EXCESS, Target

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
# Samples a ball, longest step in discs, rounds.
Phase = tuple[float, float, int]

CAP = 200_000
# Finer than this share of the object's size, spheres would copy the facets of a round mesh one by one: that is done
# only for a count that flat sides would need at half of it or less, and never below what single precision holds.
_FINEST, _LEAST = 1e-4, 1e-6
_ALLOWED = 0.99  # of the error: what the 99th percentile varies by between sets of samples
_WORST = 1.9  # times G: what even a corner or an edge should not exceed
_CORNERS = 0.05  # share of a given count that may go to them
_RESERVE = 0.012  # share kept for corners that are left at the end
# Many short rounds first, then ever more samples to trust.
_PHASES: tuple[Phase, ...] = ((60, 0.4, 15), (150, 0.3, 20), (500, 0.2, 12))
_FEW = 12
_TIGHTER = 0.9  # G from one try to add balls to the next
_LEVEL: Phase = (150, 0.4, 14)  # starts from good places and needs no other
_MOST_SAMPLES = 1_500_000
_MOVES = 4  # a ball and round
# Low and high end of what a sample may cost, in G; and how much worse a move may make it, in samples of a ball's share.
_LOW, _HIGH = 0.9, 1.4
_TEMPERATURE = 0.004


def within_count(target: Target, count: int, mode: str, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4), n <= count, with the least G found."""
    balls = _candidates(target, count, seed)
    budget, finest = _budget_for(target, balls, count), _finest(target, balls, count)
    balls = _spread(balls, count, budget, seed)
    corners, total = np.empty((0, 4)), count
    for number, phase in enumerate(_phases(count)):
        last = number == len(_PHASES) - 1
        if last:
            corners = _corners(target, balls, budget, mode, seed + 9, int(_CORNERS * count))
            count -= int(_RESERVE * count)
        fit = target.make_fit(round(phase[0] * count), seed + 20 + number)
        _set_budget(fit, budget, mode)
        fit.set_balls(target.solid.triangles, np.concatenate([corners, balls]), len(corners))
        fit.remove(len(corners) + len(balls) - count)

        def report(part: float, number: int = number) -> None:
            tell("improve", 0.1 + 0.8 * (number + part) / len(_PHASES))

        budget = _improve(fit, count, budget, mode, phase, finest, report)
        balls = fit.balls()
        if last:
            # What moved away from corners since; and what is left of the reserve where most is bare.
            more = _corners(target, balls, budget, mode, seed + 10, total - len(balls))
            balls = _fill(target, fit, np.concatenate([balls, more]), total, budget, mode, finest)
        del fit  # before the next takes its memory
    return within(target.solid, balls)


def _fill(target: Target, fit: CoverFit, balls: Array, total: int, budget: float, mode: str, finest: float) -> Array:
    """The balls and more of them up to a total, where most is bare; fewer if only facets were left to copy."""
    while True:
        balls = within(target.solid, balls)
        if len(balls) == total or budget < finest:
            return balls
        _set_budget(fit, budget, mode)
        fit.set_balls(target.solid.triangles, balls)
        fit.add(total - len(balls), 6)
        balls = fit.balls()
        budget *= _TIGHTER


def thinned(target: Target, balls: Array, count: int, mode: str, seed: int) -> Array:
    """Centres and inside distances (n, 4), n <= count, with the least G found from those of a finer cover."""
    density, step, rounds = _LEVEL
    rounds = round(_fewer(count) * rounds)
    budget = _budget_for(target, balls, count)
    fit = target.make_fit(round(np.clip(density * count, 6_000, _MOST_SAMPLES)), seed)
    _set_budget(fit, budget, mode)
    fit.set_balls(target.solid.triangles, balls)
    fit.remove(len(balls) - count)
    _improve(fit, count, budget, mode, (density, step, rounds), _finest(target, balls, count))
    return within(target.solid, fit.balls())


def within_error(target: Target, error: float, mode: str, seed: int, tell: Progress) -> Array:
    """Centres and inside distances (n, 4) that keep the error on independent samples. Raises BadMesh if none do."""
    solid = target.solid
    budget = (2 if mode == "balanced" else 1) * error * _ALLOWED
    expected = _expected_count(target, _candidates(target, 200, seed), budget)
    if expected > 4 * CAP:
        raise _too_fine(error, f"needs about {expected:,.0f} spheres, {CAP:,} are possible")
    count = int(np.clip(0.8 * expected, 1, CAP))
    balls = _spread(_candidates(target, count, seed), count, budget, seed)
    corners = np.empty((0, 4))
    aim = budget
    for number, (density, step, rounds) in enumerate(_phases(count)):
        fit = target.make_fit(round(density * count), seed + 20 + number)
        _set_budget(fit, aim, mode)
        fit.set_balls(solid.triangles, np.concatenate([corners, balls]), len(corners))
        for turn in range(rounds):
            tell("improve", 0.1 + 0.8 * (number + turn / rounds) / len(_PHASES))
            fit.exchange(len(balls) // 2, 6)
            fit.polish(step, _MOVES, _temperature(density, turn, rounds))
            _settle(fit, aim, mode, 0.5 if turn < rounds - 2 else 1.0)
            balls = fit.balls()
        balls = within(solid, balls)
        # What a set of samples of this density flatters by, the next is held to.
        if number == 1:
            balls = balls[len(corners) :]
            corners = _corners(target, balls, budget, mode, seed + 9, CAP)
        aim = budget * 0.99
    if len(balls) <= _FEW:
        # As good as so many can be: one ball for a sphere, in its middle.
        for turn in range(20):
            closer = max(1.02 * fit.quantile(MODES[mode]), 0.1 * _FINEST * solid.size)
            _set_budget(fit, closer, mode)
            fit.polish(0.3 * 0.8**turn, _MOVES, 0.0)
        balls = within(solid, fit.balls())
    for _ in range(60):
        if mode == "outside":
            reach = protrusion_p99(target, covering(target, balls, seed), seed)
        else:
            reach = judge(target, balls, mode, seed)
        if reach <= budget:
            return np.concatenate([balls, _corners(target, balls, budget, mode, seed + 10, CAP - len(balls))])
        if len(balls) >= CAP or aim < budget / 3:
            raise _too_fine(error, f"is not reached with {len(balls):,} of {CAP:,} spheres")
        aim *= max(min(budget / reach, 0.998), 0.96)
        _settle(fit, aim, mode, 0.5)
        fit.exchange(len(balls) // 2, 6)
        fit.polish(0.1, _MOVES, 0.0)
        balls = within(solid, fit.balls())
    raise _too_fine(error, f"is not reached with {len(balls):,} of {CAP:,} spheres")


def _improve(
    fit: CoverFit,
    count: int,
    budget: float,
    mode: str,
    phase: Phase,
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
        _set_budget(fit, budget, mode)
    if budget == finest:
        fit.remove_useless()
    return budget


def _settle(fit: CoverFit, aim: float, mode: str, share: float) -> None:
    """Add or remove balls for G = aim: error falls as 1 / count, and `share` of the way is gone."""
    _set_budget(fit, aim, mode)
    fit.remove_useless()
    count = len(fit.balls())
    wanted = count * (1 + share * (min(fit.quantile(MODES[mode]) / aim, _HIGH) - 1))
    if wanted > count:
        fit.add(min(int(np.ceil(wanted)), CAP) - count, 6)
    elif wanted < count - 1:
        fit.remove(int(count - wanted))


def _set_budget(fit: CoverFit, budget: float, mode: str) -> None:
    fit.set_budget(_LOW * budget, _HIGH * budget, EXCESS[mode] * budget)


def _corners(target: Target, balls: Array, budget: float, mode: str, seed: int, most: int) -> Array:
    return cover_corners(target, balls, _WORST * budget, EXCESS[mode] * budget, seed, most)


def _finest(target: Target, balls: Array, count: int) -> float:
    """G below which no more balls are made of it."""
    size = 2 * target.solid.size
    return float(np.clip(_even_budget(target, balls, count) / 2, _LEAST * size, _FINEST * size))


def _too_fine(error: float, found: str) -> BadMesh:
    return BadMesh("E-MESH-ERROR", "error", f"{error * 1e3:g} mm {found}; ask for a larger error")


def _phases(count: int) -> list[Phase]:
    """Fewer samples a ball and rounds for so many balls, for the time and memory that they take."""
    most = _MOST_SAMPLES // count
    return [
        (max(min(density, most), 6_000 // count), step, max(2, round(_fewer(count) * rounds)))
        for density, step, rounds in _PHASES
    ]


def _fewer(count: int) -> float:
    """Share of the rounds for so many balls."""
    return min(1.0, (2_000 / max(count, 1)) ** 0.45)


def _temperature(density: float, turn: int, rounds: int) -> float:
    """Falls to 0 over the first seven tenths of a phase."""
    return _TEMPERATURE * density * max(0.0, 1 - turn / (0.7 * rounds))


def _candidates(target: Target, count: int, seed: int) -> Array:
    """Medial balls behind samples of the surface, a few for each of `count`. Raises BadMesh if there are none."""
    solid = target.solid
    points, face, _ = target.sample(int(np.clip(8 * count, 1_000, max(25_000, 2 * count))), seed + 4)
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


def _budget_for(target: Target, balls: Array, count: int) -> float:
    """G that so many balls are expected to reach, with room."""
    return 1.3 * max(_even_budget(target, balls, count), _finest(target, balls, count))


def _even_budget(target: Target, balls: Array, count: int) -> float:
    """G at which flat sides need so many balls."""
    low, high = 2 * _LEAST * target.solid.size, 2 * target.solid.size
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _expected_count(target, balls, middle) > count else (low, middle)
    return float(high)


def _expected_count(target: Target, balls: Array, budget: float) -> float:
    """Balls for flat sides: each covers a disc of radius^2 2 R G + G^2 on two of them, in a hexagonal covering."""
    radius = balls[:, 3]
    area = target.solid.areas.sum() * target.crowding
    return float(area / 2 * np.mean(1 / (2.598 * (2 * radius * budget + budget**2))))
