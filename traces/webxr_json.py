"""A capture of WebXR input as JSON -> Recording of one hand.

Layout, as `ActionRecorder` of Meta's immersive web emulation runtime logs it: {"schema": [[index, {"handedness",
"hasHand", "jointSequence", ...}], ...], "frames": [[ms, viewer pose of 7 numbers, [index, target ray of 7, grip of 7 if
any, 25 x (position, quaternion x y z w, radius), ...], ...], ...]}. Joints are in the frame of the target ray.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from palmar.errors import BadTrace, PalmarError
from palmar.traces.kinematics import Array, multiply, rotate
from palmar.traces.recording import Recording
from palmar.traces.webxr import CHAINS, JOINTS, SIDES, recording_of_joints

DEVICE = "webxr-json"
RAY, JOINT = 7, 8  # numbers of a pose, and of a joint: position, quaternion, radius
UNIT_TOLERANCE = 5e-3  # numbers are rounded to three decimals


def read_webxr_json(path: str | Path, *, side: str = "right") -> Recording:
    """Read one hand of a capture: metres, seconds from the first frame. The palm frame is the wrist's.

    side: which of the hands. A frame without that hand is not tracked. Raises PalmarError for the side, BadTrace
    E-TRACE-MISSING, E-TRACE-FORMAT, E-TRACE-TIME, E-TRACE-EMPTY.
    """
    if side not in SIDES:
        raise PalmarError("E-CONF", "side", f"{side!r}; allowed are right, left")
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadTrace("E-TRACE-MISSING", str(path), f"{error.strerror}; a capture is needed") from None
    try:
        said = json.loads(content)
        index, about = next((i, a) for i, a in said["schema"] if a["hasHand"] and a["handedness"] == side)
        order = [about["jointSequence"].index(joint) for joint in JOINTS]
        place = 2 if about["hasGrip"] else 1  # of the hand, behind the ray's numbers
        time_s = np.array([frame[0] for frame in said["frames"]], dtype=np.float64) / 1e3
        rows = [_hand_of(frame, index, place) for frame in said["frames"]]
    except StopIteration:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"has no {side} hand") from None
    except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"no capture of WebXR input ({error!r})") from None
    if len(time_s) and not np.isfinite(time_s).all():
        raise BadTrace("E-TRACE-FORMAT", str(path), "a frame has no time")
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if late.size:
        raise BadTrace("E-TRACE-TIME", f"{path}:frame {late[0] + 1}", "its time does not increase")
    seen = np.array([row is not None for row in rows], dtype=bool)
    if not seen.any():
        raise BadTrace("E-TRACE-EMPTY", str(path), f"no frame has the {side} hand")
    numbers = np.stack([rows[int(np.argmax(seen))] if row is None else row for row in rows])  # type: ignore[misc]
    position, rotation = _joints(numbers, order)
    wrist = JOINTS.index("wrist")
    return recording_of_joints(
        *(DEVICE, path.name, hashlib.sha256(content).hexdigest(), side),
        time_s=time_s - time_s[0],
        wrist_m=position[:, wrist],
        wrist_wxyz=rotation[:, wrist],
        chains_m=position[:, np.array([[JOINTS.index(joint) for joint in chain] for chain in CHAINS])],
        seen=seen,
        assumption="Times are those of the browser's callback, from the first frame; numbers are rounded to 1 mm and "
        "0.001.",
    )


def _hand_of(frame: list[Any], index: int, place: int) -> Array | None:
    """The ray's 7 numbers and the 25 x 8 of the joints of one input; None if it is not in the frame."""
    for given in frame[1 + RAY :]:
        if given[0] == index:
            numbers = np.array([*given[1 : 1 + RAY], *given[RAY + place]], dtype=np.float64)
            if numbers.shape != (RAY + JOINT * len(JOINTS),):
                raise ValueError(f"an input of {len(numbers)} numbers; {RAY + JOINT * len(JOINTS)} are needed")
            lengths = np.linalg.norm(np.vstack([numbers[3:7], numbers[RAY:].reshape(-1, JOINT)[:, 3:7]]), axis=1)
            return numbers if (np.abs(lengths - 1.0) <= UNIT_TOLERANCE).all() else None
    return None


def _joints(numbers: Array, order: list[int]) -> tuple[Array, Array]:
    """Positions (n, 25, 3) and rotations (n, 25, 4), w first, of the joints in the reference space."""
    ray = _wxyz(numbers[:, 3:7])[:, None]
    joints = numbers[:, RAY:].reshape(len(numbers), -1, JOINT)[:, order]
    return rotate(ray, joints[..., :3]) + numbers[:, None, :3], multiply(ray, _wxyz(joints[..., 3:7]))


def _wxyz(xyzw: Array) -> Array:
    return np.roll(xyzw / np.linalg.norm(xyzw, axis=-1, keepdims=True), 1, axis=-1)
