"""Where the promise of a lean model ends: traces held out, and those it was tuned on shifted and turned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.eval.tuned import DIFFERENCES, ROUNDING, Held
from palmar.files import sha256_of, stem_of
from palmar.lean import beyond_line
from palmar.model import AssetPack
from palmar.records import Trace, read_trace, write_trace
from palmar.seen import beyond
from palmar.tune_cells import Bench, Model, replay_to, try_answer, try_model

SHIFTS_MM = (5.0, 10.0, 20.0)
TURNS_DEG = (5.0, 10.0, 20.0)
MOST_TRACES = 2  # that are shifted and turned, each another way
MEANT = 3
HELD_OUT = "all held out"
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=np.float64)


def changed_traces(traces: Sequence[Path], made: Path) -> dict[str, list[Path]]:
    """Traces shifted and turned, written once: `shifted 5 mm` -> files. The k-th goes along or about the k-th axis."""
    found: dict[str, list[Path]] = {}
    for number, path in enumerate(traces[:MOST_TRACES]):
        axis = AXES[number % len(AXES)]
        for name, shift_m, turn_rad in _changes():
            out = made / f"{stem_of(path)}-{sha256_of(path)[:8]}-{name.replace(' ', '-')}.mcap"
            if not out.is_file():
                write_trace(out, _changed(read_trace(path), shift_m * axis, Rotation.from_rotvec(turn_rad * axis)))
            found.setdefault(name, []).append(out)
    return found


def _changes() -> list[tuple[str, float, float]]:
    shifts = [(f"shifted {mm:g} mm", mm / 1e3, 0.0) for mm in SHIFTS_MM]
    return shifts + [(f"turned {deg:g} deg", 0.0, float(np.radians(deg))) for deg in TURNS_DEG]


def _changed(trace: Trace, shift_m: np.ndarray, turn: Rotation) -> Trace:
    """The palm moved in the world and turned about its own place."""
    now = Rotation.from_quat(np.roll(trace.palm_rotation_wxyz, -1, axis=1))
    turned = trace.palm_rotation_wxyz
    if turn.magnitude() > 0:
        turned = np.roll((turn * now).as_quat(), 1, axis=1)
        # The sign of a quaternion says nothing, but a resampler wants neighbours on one side.
        flips = np.cumprod(np.sign(np.r_[1.0, np.einsum("ni,ni->n", turned[1:], turned[:-1])]))
        turned = turned * flips[:, None]
    return replace(trace, palm_position_m=trace.palm_position_m + shift_m, palm_rotation_wxyz=turned)


def outside_rows(
    bench: Bench,
    model: Model,
    lean: AssetPack,
    twin: Model,
    groups: dict[str, list[Path]],
    rows: Sequence[Held],
    tell: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """What the lean model does on traces that it was not tuned on, one row for each group.

    name, values (of the group), broken (the limits, without margin, that do not hold), beyond_mm (the farthest that a
    hand touches outside of what was seen), outside: one line for each trace that does. Differences are held beside
    those of the twin on the same traces, and only of MEANT traces or more: of one they say little.
    """
    found = []
    tuned = lean.objects[bench.name].about["tuned"]
    for number, (name, traces) in enumerate(groups.items()):
        tell(f"judging {name}", number / len(groups))
        trial = try_model(bench, model, traces)
        outside, farthest = [], 0.0
        for trace in traces:
            out = bench.folder / f"{stem_of(trace)}.run.mcap"
            run = replay_to(model, trace, bench.name, out)
            out.unlink()
            farthest = max(farthest, float(beyond(run, tuned).max()))
            line = beyond_line(run, lean, bench.name)
            if line and name != HELD_OUT:  # of those each has a row of its own
                outside.append(f"{stem_of(trace)}: {line}")
        values, apart = trial.values, try_answer(bench, twin, traces).values
        over = []
        for row in rows:
            value, limit = values[row.rule.name], row.limit
            if row.allowed is None or limit is None or value is None:
                continue
            if row.rule.metric in DIFFERENCES:
                limit += (apart[row.rule.name] or 0.0) - (row.own or 0.0) if len(traces) >= MEANT else np.inf
            if value > limit + ROUNDING:
                over.append(row.rule.name)
        found.append({"name": name, "values": values, "broken": over, "beyond_mm": 1e3 * farthest, "outside": outside})
    return found
