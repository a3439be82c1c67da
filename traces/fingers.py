"""A grasp with fewer fingers: what a step costs against what of the hand is in use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palmar.model import FINGERS
from palmar.records import Trace

LIFT_M = 0.006  # of a palm that is not in use: past the press of the grasp and the reach of a step

# As the paper's Fig. 15 counts them: what is in use, and whether the palm is.
IN_USE: dict[str, tuple[tuple[str, ...], bool]] = {
    "one finger": (("index",), False),
    "two fingers": (("thumb", "index"), False),
    "five fingers": (FINGERS, False),
    "whole hand": (FINGERS, True),
}


def with_fingers(trace: Trace, fingers: Sequence[str], palm: bool) -> Trace:
    """The trace with every other finger as open as at first and, without the palm, all of it LIFT_M farther off.

    Farther: towards where the palm of the first sample is, seen from that of the sample farthest from it.
    """
    idle = [number for number, name in enumerate(FINGERS) if name not in fingers]
    flexion = trace.flexion_rad.copy()
    flexion[:, idle] = flexion[0, idle]
    position = trace.palm_position_m
    if not palm:
        way = position[0] - position
        farthest = way[np.argmax(np.linalg.norm(way, axis=1))]
        position = position + LIFT_M * farthest / max(float(np.linalg.norm(farthest)), 1e-12)
    return replace(trace, flexion_rad=flexion, palm_position_m=position)
