"""A grasp with fewer fingers: what a step costs against what of the hand is in use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palmar.model import FINGERS
from palmar.records import Trace

PHASES = ("approach", "close", "slide")
LIFT_M = 0.006  # of a palm that is not in use: past the press of the grasp and the reach of a step

# As the paper's Fig. 15 counts them: what is in use, and whether the palm is.
IN_USE: dict[str, tuple[tuple[str, ...], bool]] = {
    "one finger": (("index",), False),
    "two fingers": (("thumb", "index"), False),
    "five fingers": (FINGERS, False),
    "whole hand": (FINGERS, True),
}


def with_fingers(trace: Trace, fingers: Sequence[str], palm: bool) -> Trace:
    """A grasp up to the end of its slide, every other finger as open as at first and, without the palm, farther off.

    By LIFT_M towards where the palm of the first sample is, seen from that of the sample farthest from it.
    """
    idle = [number for number, name in enumerate(FINGERS) if name not in fingers]
    flexion = trace.flexion_rad.copy()
    flexion[:, idle] = flexion[0, idle]
    position = trace.palm_position_m
    if not palm:
        way = position[0] - position
        farthest = way[np.argmax(np.linalg.norm(way, axis=1))]
        position = position + LIFT_M * farthest / max(float(np.linalg.norm(farthest)), 1e-12)
    ends = [phase[end] for phase in trace.phases if phase["name"] in PHASES for end in ("start_s", "end_s")]
    at = np.ones(len(position), dtype=bool)
    if ends:
        at = (trace.time_s >= min(ends)) & (trace.time_s < max(ends))
    columns = {name: getattr(trace, name)[at] for name in Trace.__dataclass_fields__ if name not in ("header", "lost")}
    columns |= {"flexion_rad": flexion[at], "palm_position_m": position[at]}
    header = {key: value for key, value in trace.header.items() if key != "phases"}
    return Trace(header, **columns)
