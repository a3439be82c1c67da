"""Reference scenario CSV -> Trace: a palm pose, fifteen flexions and a phase number a row; the object stands still."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from palmar.errors import BadTrace
from palmar.model import FINGERS
from palmar.records import Trace
from palmar.traces.columns import Array, Log, read_log, unit_quaternions

POSITION = ["px", "py", "pz"]
ROTATION = ["qw", "qx", "qy", "qz"]
FLEXION = [f"{finger}_{joint}" for finger in FINGERS for joint in (1, 2, 3)]
COLUMNS = ["t", *POSITION, *ROTATION, *FLEXION, "phase"]
PHASES = ("approach", "close", "slide", "hold", "leave")


def read_scenario_csv(path: str | Path) -> Trace:
    """Read a reference scenario; abduction is zero, the object stands still at the origin.

    Raises BadTrace with the line and column (see `palmar.traces.columns.read_log`).
    """
    log = read_log(path, COLUMNS, "t")
    rotation = unit_quaternions(log, ROTATION)
    time_s = log.columns["t"]
    count = len(time_s)
    assumptions = [
        "The columns hold metres, radians, seconds and quaternions w x y z, of the reference hand, a left one.",
        "The log has no abduction: all five are 0.",
        "The object stands still in the frame the palm is given in.",
    ]
    change = float(np.abs(rotation - log.stack(ROTATION)).max())
    header = {
        "device": "scenario-csv",
        "hand": "reference",
        "side": "left",
        "source": Path(path).name,
        "source_sha256": log.sha256,
        "assumptions": json.dumps(assumptions),
        "changed": json.dumps({"quaternions scaled to unit length": count, "largest change of a component": change}),
        "phases": json.dumps(_phases(log, time_s)),
    }
    if count > 1:
        header["rate_hz"] = f"{1.0 / float(np.median(np.diff(time_s))):.6g}"
    return Trace(
        header=header,
        time_s=time_s,
        palm_position_m=log.stack(POSITION),
        palm_rotation_wxyz=rotation,
        flexion_rad=log.stack(FLEXION).reshape(count, 5, 3),
        abduction_rad=np.zeros((count, 5)),
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )


def _phases(log: Log, time_s: Array) -> list[dict[str, str | float]]:
    """Stretches of one phase number: each ends where the next starts, the last at the last sample."""
    phase = log.columns["phase"]
    unknown = np.flatnonzero(~np.isin(phase, range(len(PHASES))))
    if unknown.size:
        i = int(unknown[0])
        names = ", ".join(f"{k} {name}" for k, name in enumerate(PHASES))
        raise BadTrace("E-TRACE-VALUE", f"{log.where}:line {i + 2}, column phase", f"{phase[i]:g}; phases are {names}")
    starts = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist()]
    ends = [*starts[1:], len(phase) - 1]
    return [
        {"name": PHASES[int(phase[start])], "start_s": float(time_s[start]), "end_s": float(time_s[end])}
        for start, end in zip(starts, ends, strict=True)
    ]
