"""An object put in the way of a recorded hand: where a grasp of it closes as the recording does."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace
from palmar.model import HandModel
from palmar.records import Trace
from palmar.traces.kinematics import Array, conjugate, multiply, rotate
from palmar.traces.place import Closing, place_grasp

PRESS_M = 0.0  # the palm touches; it may come nearer and go away as it was recorded
SQUEEZE_M = 0.010  # deepest a finger goes into the object where the recording closes most


def put_object(trace: Trace, hand: HandModel, leaves: Array, name: str) -> Trace:
    """The trace seen from an object that stands where the recorded hand closes on it; it is then at the origin.

    The sample with the least and the one with the most flexion are open hand and fist of the grasp, which is chosen as
    for a scripted one (`place_grasp`). leaves: (n, 4). Raises BadTrace if no sample is tracked, PalmarError if the palm
    meets the object from no side.
    """
    bent = np.where(trace.tracked, trace.flexion_rad[:, 1:].sum(axis=(1, 2)), np.nan)
    if not trace.tracked.any():
        raise BadTrace("E-TRACE-EMPTY", trace.header.get("source", "a trace"), "no sample is tracked")
    opened, closed = int(np.nanargmin(bent)), int(np.nanargmax(bent))
    closing = Closing(
        hand=hand,
        opened_rad=trace.flexion_rad[opened],
        fist_rad=trace.flexion_rad[closed],
        abduction_rad=trace.abduction_rad[closed],
        press_m=PRESS_M,
        squeeze_m=SQUEEZE_M,
    )
    grasp = place_grasp(closing, leaves, np.zeros(2), np.zeros(3))
    # Object from world = object from palm, as the grasp has it, after palm from world, as recorded where it is closed.
    object_from_palm = np.roll(Rotation.from_matrix(grasp.rotation).as_quat(), 1)
    turn = multiply(object_from_palm, conjugate(trace.palm_rotation_wxyz[closed]))
    shift = grasp.position_m - rotate(turn, trace.palm_position_m[closed])
    sentences = json.loads(trace.header.get("assumptions", "[]"))
    sentences.append(
        f"{name} was not there: it is put where the hand closes on it, at {trace.time_s[closed]:.2f} s; the palm is "
        "given in its frame."
    )
    return replace(
        trace,
        header={**trace.header, "object": name, "assumptions": json.dumps(sentences)},
        palm_position_m=rotate(turn, trace.palm_position_m) + shift,
        palm_rotation_wxyz=multiply(turn, trace.palm_rotation_wxyz),
    )
