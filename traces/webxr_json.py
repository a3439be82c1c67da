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
from palmar.traces.recording import JOINT_NAMES, JOINT_POINTS, Recording, in_palm
from palmar.traces.webxr import CHAINS, JOINTS, PALM_AXES, SIDES

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
    last = np.maximum.accumulate(np.where(seen, np.arange(len(rows)), -1))
    last[last < 0] = int(np.argmax(seen))
    numbers = np.stack([rows[k] for k in last])  # type: ignore[misc]
    position, rotation = _joints(numbers, order)
    wrist = _continuous(rotation[:, JOINTS.index("wrist")])
    chains = np.stack([np.stack([position[:, JOINTS.index(j)] for j in chain], axis=1) for chain in CHAINS], axis=1)
    chains = in_palm(chains, position[:, JOINTS.index("wrist")], wrist)
    points = chains[:, :, 1:].copy()
    points[~seen] = np.nan
    return Recording(
        device=DEVICE,
        source=path.name,
        sha256=hashlib.sha256(content).hexdigest(),
        side=side,
        time_s=time_s - time_s[0],
        palm_position_m=position[:, JOINTS.index("wrist")],
        palm_rotation_wxyz=wrist,
        palm_seen=seen,
        palm_axes=PALM_AXES,
        knuckle_m=chains[:, :, 0],
        points_m=points,
        phalanx=JOINT_POINTS,
        point_names=JOINT_NAMES,
        weight=np.ones(len(time_s)),
        assumptions=(
            "Times are those of the browser's callback, from the first frame; numbers are rounded to 1 mm and 0.001.",
            "The palm is rigid with the wrist joint; metacarpals other than the thumb's are taken as part of it.",
            "Only positions of joints are used, not their rotations; a WebXR tip is the end of the last phalanx.",
        ),
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


def _continuous(wxyz: Array) -> Array:
    flips = np.where((wxyz[1:] * wxyz[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return wxyz * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
