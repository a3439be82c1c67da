"""Traces of the paper's figures that no scene file tells: fingers that take hold in turn, and a shaken hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from palmar.errors import PalmarError
from palmar.model import FINGERS
from palmar.records import Trace
from palmar.traces.keyframes import min_jerk
from palmar.traces.kinematics import Array

# What has hold of the object in each state of the paper's Fig. 12.
STATES = (
    ("one finger", ("index",)),
    ("two fingers", ("thumb", "index")),
    ("five fingers", FINGERS),
    ("two fingers", ("thumb", "index")),
    ("one finger", ("index",)),
    ("none", ()),
)
CHANGE_S, REST_S = 0.4, 0.4  # of a state, its fingers closing or opening and then at rest


def in_turn(grasp: Trace) -> Trace:
    """A grasp whose fingers close in the order of STATES and let go in turn; the palm comes and goes as in `grasp`.

    grasp: a trace with the phases approach, close and leave. Raises PalmarError E-CONF if it has none of them.
    """
    at = {phase["name"]: phase for phase in grasp.phases}
    if missing := {"approach", "close", "leave"} - set(at):
        raise PalmarError("E-CONF", "trace", f"has no phase named {sorted(missing)[0]}, which fingers in turn need")
    rate = float(grasp.header["rate_hz"])

    def step(time_s: float) -> int:
        return int(np.searchsorted(grasp.time_s, time_s - 1e-9))

    come, closed = step(at["close"]["start_s"]), step(at["close"]["end_s"])
    go = step(at["leave"]["start_s"])
    opened, fist = grasp.flexion_rad[come], grasp.flexion_rad[closed]
    parts, phases, before = [grasp.flexion_rad[:come]], [("none", come)], np.zeros(5)
    for name, fingers in STATES:
        now = np.array([finger in fingers for finger in FINGERS], dtype=float)
        s = min_jerk(np.clip(np.arange(round((CHANGE_S + REST_S) * rate)) / (CHANGE_S * rate), 0, 1))
        share = before + s[:, None] * (now - before)
        parts.append(opened + share[..., None] * (fist - opened))
        phases.append((name, len(s)))
        before = now
    leave = len(grasp.time_s) - go
    flexion = np.concatenate([*parts, np.broadcast_to(opened, (leave, 5, 3))])
    phases[-1] = (phases[-1][0], phases[-1][1] + leave)
    rows = np.concatenate([np.arange(come), np.full(len(flexion) - come - leave, come), np.arange(go, go + leave)])
    ends = np.cumsum([count for _, count in phases]) / rate
    told = [
        {"name": name, "start_s": float(end - count / rate), "end_s": float(end)}
        for (name, count), end in zip(phases, ends, strict=True)
    ]
    columns = {
        name: getattr(grasp, name)[rows] for name in Trace.__dataclass_fields__ if name not in ("header", "lost")
    }
    columns |= {"time_s": np.arange(len(rows)) / rate, "flexion_rad": flexion}
    return Trace(grasp.header | {"phases": json.dumps(told)}, **columns)


def shaken(trace: Trace, position_m: float, joint_rad: float, seed: int) -> Trace:
    """The trace with white noise of these standard deviations on each coordinate of the palm and each flexion."""
    generator = np.random.default_rng(seed)

    def noise(like: Array, size: float) -> Array:
        return size * generator.standard_normal(like.shape)

    return replace(
        trace,
        palm_position_m=trace.palm_position_m + noise(trace.palm_position_m, position_m),
        flexion_rad=trace.flexion_rad + noise(trace.flexion_rad, joint_rad),
    )
