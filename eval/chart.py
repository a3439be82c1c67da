"""Speed against accuracy: what replays of the same traces by several solvers over several levels come to.

A cell is one replay, judged and timed; a dot is a solver at a level with a quality over all traces.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case
from palmar.eval.metrics import measure
from palmar.model import AssetPack
from palmar.records import Run

Array = NDArray[np.float64]

DEEP_MM = 1.0  # a hand so far inside the spheres has failed: ten times the depth that the paper states
HELD_MM = 0.1  # that depth
ROUNDING_MM = 1e-9  # of positions of a metre in double precision: no depth
CLOCKS = ("cpu_us", "wall_us", "search_us", "solve_us", "verify_us")
# What is judged of each replay: number -> (metric, stat). The worst trace counts.
NUMBERS = {
    "penetration_mesh_mm": ("penetration_mesh", "max"),
    "penetration_spheres_mm": ("penetration_spheres", "max"),
    "hover_mm": ("hover", "p99"),
    "force_above_20hz_n": ("force_above_20hz", "value"),
    "excess_force_step_n": ("excess_force_step", "max"),
    "palm_offset_mm": ("palm_offset", "mean"),
}
FAILURES = ("wrong_side", "kept_previous", "deep")


@dataclass(frozen=True)
class Cell:
    """One replay: where it stands in the grid, and what came of it."""

    trace: str  # object and trace
    level: int  # spheres, as asked for
    spheres: int  # as there are
    solver: str
    quality: str  # settings beside the defaults; "" if none
    in_use: str  # of a trace that uses part of the hand; "" in the grid
    judged: dict[str, Any]  # of `judge`; empty out of the grid
    times_us: dict[str, Array]  # CLOCKS -> (repeats, n)
    contacts: NDArray[np.int64]  # (n,)

    @property
    def least_us(self) -> Array:
        """(n,) least CPU time of each step over the repeats: what it costs."""
        return self.times_us["cpu_us"].min(axis=0)


@dataclass(frozen=True)
class Dot:
    """A solver at a level with a quality, over all traces."""

    solver: str
    level: int
    quality: str
    spheres: int  # median over the objects
    traces: int
    steps: int
    failed: int
    failures: dict[str, int]
    not_converged: int
    cost_us: dict[str, float]  # p50, p99 of the least times, in steps in which the first solver touches
    tail_us: dict[str, float]  # p99, p99.9, max of all repeats as they came
    wall_us: dict[str, float]
    numbers: dict[str, float | None]


def judge(run: Run, pack: AssetPack, object_name: str) -> dict[str, Any]:
    """The numbers of NUMBERS (None where not measured), and how many steps failed, in what way."""
    only = {"wrong_side", *(metric for metric, _ in NUMBERS.values())}
    rows, series = measure(run, pack, object_name, only=only)
    value = {(row["metric"], row["stat"]): row["value"] for row in rows}
    case = Case(run, pack, object_name)
    flags = {
        "wrong_side": series["wrong_side"] > 0,
        "kept_previous": case.has_status("kept_previous"),
        "deep": series["penetration_spheres"] > DEEP_MM,
    }
    return {
        "numbers": {name: None if value[key] is None else value[key] + 0.0 for name, key in NUMBERS.items()},  # no -0
        "steps": len(run.time_s),
        "failed": int(np.logical_or.reduce(list(flags.values())).sum()),
        "failures": {name: int(flag.sum()) for name, flag in flags.items()},
        "not_converged": int(case.has_status("iteration_limit").sum()),
    }


def dots(cells: Sequence[Cell], first: str) -> list[Dot]:
    """The dots of the grid, by solver, quality and level. Times are of the steps in which `first` touches."""
    grid = [cell for cell in cells if not cell.in_use]
    touching = {
        (cell.trace, cell.level): cell.contacts > 0 for cell in grid if cell.solver == first and not cell.quality
    }
    groups: dict[tuple[str, str, int], list[Cell]] = {}
    for cell in grid:
        groups.setdefault((cell.solver, cell.quality, cell.level), []).append(cell)
    return [_dot(of, touching) for of in groups.values()]


def _dot(cells: list[Cell], touching: dict[tuple[str, int], NDArray[np.bool_]]) -> Dot:
    at = [touching.get((cell.trace, cell.level), cell.contacts > 0) for cell in cells]
    at = [mask if mask.any() else np.ones(len(mask), dtype=bool) for mask in at]

    def pooled(clock: str, least: bool) -> Array:
        parts = [cell.times_us[clock][:, mask] for cell, mask in zip(cells, at, strict=True)]
        return np.concatenate([part.min(axis=0) if least else part.ravel() for part in parts])

    cost, tail, wall = pooled("cpu_us", True), pooled("cpu_us", False), pooled("wall_us", False)
    failures = {name: sum(cell.judged["failures"][name] for cell in cells) for name in FAILURES}
    return Dot(
        solver=cells[0].solver,
        level=cells[0].level,
        quality=cells[0].quality,
        spheres=int(np.median([cell.spheres for cell in cells])),
        traces=len(cells),
        steps=sum(cell.judged["steps"] for cell in cells),
        failed=sum(cell.judged["failed"] for cell in cells),
        failures=failures,
        not_converged=sum(cell.judged["not_converged"] for cell in cells),
        cost_us=_quantiles(cost, 50, 99),
        tail_us=_quantiles(tail, 99, 99.9, 100),
        wall_us=_quantiles(wall, 99, 100),
        numbers={name: _worst(cell.judged["numbers"][name] for cell in cells) for name in NUMBERS},
    )


def _quantiles(values: Array, *wanted: float) -> dict[str, float]:
    return {"max" if q == 100 else f"p{q:g}": float(np.percentile(values, q)) for q in wanted}


def _worst(values: Any) -> float | None:
    return max((value for value in values if value is not None), default=None)


def pareto(found: Sequence[Dot], number: str) -> list[Dot]:
    """The dots, fastest first, that no other is both as fast and as good as; those that failed steps have no part."""
    whole = [dot for dot in found if not dot.failed and dot.numbers[number] is not None]
    line: list[Dot] = []
    for dot in sorted(whole, key=lambda dot: (dot.cost_us["p99"], dot.numbers[number])):
        if not line or dot.numbers[number] < line[-1].numbers[number]:  # type: ignore[operator]
            line.append(dot)
    return line


def lead(found: Sequence[Dot], product: str) -> str:
    """By how much the product's solver leads the others, or where it does not, in one sentence."""
    plain = [dot for dot in found if not dot.quality]
    ours = {dot.level: dot for dot in plain if dot.solver == product}
    theirs = [dot for dot in plain if dot.solver != product and dot.level in ours]
    if not ours:
        return f"{product} was not among the solvers."
    depth = max(_depth(dot) for dot in ours.values())
    failed = sum(dot.failed for dot in ours.values())
    p99 = [dot.cost_us["p99"] for dot in ours.values()]
    replays, steps = sum(dot.traces for dot in ours.values()), sum(dot.steps for dot in ours.values())
    span = f"{min(p99):.0f} to {max(p99):.0f}" if len(p99) > 1 else f"{p99[0]:.0f}"
    inside = f"at most {depth:.3g} mm inside the spheres" if depth else "never inside the spheres"
    said = (
        f"{product} is {inside} and fails {failed or 'none'} of {steps:,} steps in {replays} replays, at {span} us a "
        "step (p99)"
    )
    if not theirs:
        return f"{said}."
    return f"{said}; {_beaten(ours, theirs)}."


def _beaten(ours: dict[int, Dot], theirs: list[Dot]) -> str:
    """Where the other solvers stand: those that hold by how much time, and how the rest fail."""
    parts = []
    by_solver: dict[str, list[Dot]] = {}
    for dot in theirs:
        by_solver.setdefault(dot.solver, []).append(dot)
    for solver, of in by_solver.items():
        ratio = np.exp(np.mean([np.log(dot.cost_us["p99"] / ours[dot.level].cost_us["p99"]) for dot in of]))
        pace = f"{ratio:.1f} times its time" if ratio >= 1 else f"{1 / ratio:.1f} times as fast"
        failed, deepest = sum(dot.failed for dot in of), max(_depth(dot) for dot in of)
        if failed or deepest > HELD_MM:
            parts.append((1, f"{solver} fails {failed:,} steps, {deepest:.2g} mm deep ({pace})"))
        else:
            parts.append((0, f"{solver} holds 0.1 mm, {deepest:.2g} mm deep, at {pace}"))
    worse = sum(_leads(ours[dot.level], dot) for dot in theirs)
    better = sum(_leads(dot, ours[dot.level]) for dot in theirs)
    count = f"of the {len(theirs)} dots of other solvers {worse} are both slower and no shallower, {better} the reverse"
    return "; ".join([text for _, text in sorted(parts)] + [count])


def _leads(a: Dot, b: Dot) -> bool:
    """Whether a is faster than b, no deeper in the spheres, and fails no more steps."""
    return a.cost_us["p99"] < b.cost_us["p99"] and _depth(a) <= _depth(b) and a.failed <= b.failed


def _depth(dot: Dot) -> float:
    depth = dot.numbers["penetration_spheres_mm"] or 0.0
    return 0.0 if depth < ROUNDING_MM else depth


def by_contacts(cells: Sequence[Cell]) -> dict[str, list[dict[str, float]]]:
    """Of each solver the cost of a step against its contacts, in bins that grow by half: p50, p99, steps of a bin."""
    edges = np.unique(np.round(1.5 ** np.arange(0, 20)).astype(int))
    curves = {}
    for solver, of in _by(cells, lambda cell: cell.solver).items():
        contacts = np.concatenate([cell.contacts for cell in of])
        cost = np.concatenate([cell.least_us for cell in of])
        rows = []
        for low, high in pairwise(edges):
            inside = cost[(contacts >= low) & (contacts < high)]
            if len(inside) >= 20:  # fewer have no percentile to speak of
                rows.append(
                    {"contacts": float(np.sqrt(low * (high - 1))), "steps": len(inside)} | _quantiles(inside, 50, 99)
                )
        curves[solver] = rows
    return curves


def by_fingers(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Of each solver and part of the hand in use: mean detection, response and total of steps in contact, us.

    Detection is the search, response what solves and verifies, both by the steady clock; total is CPU time.
    """
    rows = []
    for cell in cells:
        if not cell.in_use:
            continue
        at = cell.contacts > 0
        mean = {clock: float(cell.times_us[clock].min(axis=0)[at].mean()) if at.any() else 0.0 for clock in CLOCKS}
        rows.append(
            {
                "solver": cell.solver,
                "in_use": cell.in_use,
                "steps": int(at.sum()),
                "contacts": float(cell.contacts[at].mean()) if at.any() else 0.0,
                "detection_us": mean["search_us"],
                "response_us": mean["solve_us"] + mean["verify_us"],
                "total_us": mean["cpu_us"],
            }
        )
    return rows


def _by(cells: Sequence[Cell], key: Callable[[Cell], str]) -> dict[str, list[Cell]]:
    """The plain cells of the grid by a key."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        if not cell.in_use and not cell.quality:
            groups.setdefault(key(cell), []).append(cell)
    return groups


def chart_csv(found: Sequence[Dot]) -> str:
    """The dots as a table, one row each; units in the header."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    times = [("cost", "p50"), ("cost", "p99"), ("tail", "p99"), ("tail", "p99.9"), ("tail", "max"), ("wall", "p99")]
    table.writerow(
        ["solver", "quality", "level", "spheres", "traces", "steps", "failed_steps"]
        + [f"failed_{name}" for name in FAILURES]
        + ["not_converged_steps"]
        + [f"step_{kind}_{stat}_us" for kind, stat in times]
        + list(NUMBERS)
    )
    for dot in found:
        of_kind = {"cost": dot.cost_us, "tail": dot.tail_us, "wall": dot.wall_us}
        table.writerow(
            [dot.solver, dot.quality, dot.level, dot.spheres, dot.traces, dot.steps, dot.failed]
            + [dot.failures[name] for name in FAILURES]
            + [dot.not_converged]
            + [f"{of_kind[kind][stat]:.4g}" for kind, stat in times]
            + ["" if dot.numbers[name] is None else f"{dot.numbers[name]:.6g}" for name in NUMBERS]
        )
    return out.getvalue()
