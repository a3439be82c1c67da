"""What figures and page draw: the curves of one run as panels of lines over time, thinned without losing a peak."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.recompute import Recomputed
from palmar.model import FINGERS, AssetPack
from palmar.records import STATUS, Run

Array = NDArray[np.float64]

MOST_POINTS = 12_000  # of one panel, all lines together; 12 s of a single line at 1 kHz are drawn whole
DEPTHS = {"penetration_mesh": "deepest in the mesh", "penetration_spheres": "deepest in the spheres"}
# Bits of a step's status that are plain facts about the input, not trouble of the solver.
INPUT_BITS = ("bad_sample", "limit")


@dataclass(frozen=True)
class Judged:
    """One run with all that was measured on it: the input of figures and page."""

    name: str
    run: Run
    pack: AssetPack
    object_name: str
    rows: list[dict[str, Any]]  # metric, stat, unit, value, limit, margin_db
    series: dict[
        str, Array
    ]  # metric -> (n,) one number a step, in the metric's unit; NaN where a step was not measured
    verdict: str
    passed: bool
    sources: dict[str, Path]
    recomputed: Recomputed | None = None
    link_depth_mm: Array | None = None  # (n, 16) of the palm and each phalanx in the true mesh


@dataclass(frozen=True)
class Panel:
    """One chart: lines over the same time. `hidden` lines are there but not shown at first."""

    key: str
    title: str
    axis: str  # with the unit
    time_s: Array  # (m,)
    lines: dict[str, Array]  # each (m,)
    hidden: tuple[str, ...] = ()


def strongest_finger(run: Run) -> int:
    """Index of the finger with the highest fingertip force of the run."""
    return int(np.argmax(np.linalg.norm(run.fingertip_force_n, axis=2).max(axis=0)))


def panels(judged: Judged) -> list[Panel]:
    """The paper's figures of one run, from top to bottom (Fig. 12: forces, step time; Fig. 14: force components)."""
    run, series = judged.run, judged.series
    force = np.linalg.norm(run.fingertip_force_n, axis=2)
    finger = strongest_finger(run)
    vector = run.fingertip_force_n[:, finger]
    depths = {
        "into the spheres": series.get("penetration_spheres"),
        "into the true mesh": series.get("penetration_mesh"),
        "hover over the true mesh": series.get("hover"),
    }
    found = [
        Panel(
            "fingertip_force",
            "Fingertip forces",
            "force, N",
            run.time_s,
            {name: force[:, i] for i, name in enumerate(FINGERS)},
        ),
        Panel(
            "step_time",
            "Step time",
            "time of a step, ms",
            run.time_s,
            {"thread CPU time": run.cpu_us * 1e-3, "wall time": run.wall_us * 1e-3},
            hidden=("wall time",),
        ),
        Panel(
            "force_components",
            f"Force components, {FINGERS[finger]}",
            "force, N",
            run.time_s,
            {"x": vector[:, 0], "y": vector[:, 1], "z": vector[:, 2], "magnitude": force[:, finger]},
        ),
        Panel("contacts", "Contacts", "contacts", run.time_s, {"contacts": run.contacts.astype(np.float64)}),
        Panel(
            "palm_offset",
            "Palm offset",
            "offset, mm",
            run.time_s,
            {"graphic to haptic palm": 1e3 * np.linalg.norm(run.palm_position_m - run.haptic_palm_position_m, axis=1)},
        ),
        Panel(
            "penetration",
            "Penetration",
            "depth, mm",
            run.time_s,
            {name: line for name, line in depths.items() if line is not None and np.isfinite(line).any()},
            hidden=("hover over the true mesh",),
        ),
    ]
    return [thin(panel) for panel in found if panel.lines]


def thin(panel: Panel, most_points: int = MOST_POINTS) -> Panel:
    """The panel with about `most_points` numbers at most; the extremes of every line in each time slice stay."""
    count = len(panel.time_s)
    if count * len(panel.lines) <= most_points:
        return panel
    slices = max(1, most_points // (2 * len(panel.lines) ** 2))
    edges = np.linspace(0, count, slices + 1).astype(int)
    keep = {0, count - 1}
    for line in panel.lines.values():
        for start, end in pairwise(edges):
            part = line[start:end]
            if np.isfinite(part).any():
                keep.update((start + int(np.nanargmin(part)), start + int(np.nanargmax(part))))
    at = np.array(sorted(keep))
    lines = {name: line[at] for name, line in panel.lines.items()}
    return Panel(panel.key, panel.title, panel.axis, panel.time_s[at], lines, panel.hidden)


def worst_steps(judged: Judged) -> dict[str, tuple[int, str]]:
    """Named steps worth a look: label -> (step, what happened there with its unit)."""
    run = judged.run
    worst = {}
    for metric, label in DEPTHS.items():
        depth = judged.series.get(metric)
        if depth is not None and np.isfinite(depth).any():
            step = int(np.nanargmax(depth))
            worst[label] = (step, f"{depth[step]:.3g} mm")
    if len(run.time_s) > 1:
        jumps = np.linalg.norm(np.diff(run.fingertip_force_n, axis=0), axis=2).max(axis=1)
        step = int(np.argmax(jumps)) + 1
        worst["largest force jump"] = (step, f"{jumps[step - 1]:.3g} N in one step")
    step = int(np.argmax(run.cpu_us))
    worst["slowest step"] = (step, f"{run.cpu_us[step]:.0f} µs")
    step = int(np.argmax(run.wall_us))
    worst["latest answer"] = (step, f"{run.wall_us[step]:.0f} µs after its sample")
    force = np.linalg.norm(run.fingertip_force_n, axis=2).max(axis=1)
    step = int(np.argmax(force))
    worst["highest force"] = (step, f"{force[step]:.3g} N")
    return worst


def hard_steps(run: Run) -> dict[str, int]:
    """Number of steps by status bit, those with none left out."""
    counts = {name: int(np.count_nonzero(run.status & np.uint32(bit))) for bit, name in STATUS.items()}
    return {name: count for name, count in counts.items() if count}
