"""A log of WebXR hand tracking (25 joints, poses in the reference space), such as a Quest 3 gives -> Recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.errors import PalmarError
from palmar.traces.columns import read_log, unit_quaternions
from palmar.traces.kinematics import Array
from palmar.traces.recording import JOINT_NAMES, JOINT_POINTS, Recording, in_palm

DEVICE = "webxr"
FINGERS = ("index-finger", "middle-finger", "ring-finger", "pinky-finger")
PARTS = ("phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
# The thumb has no intermediate phalanx; its metacarpal is the first of the three that bend.
CHAINS = [
    ["thumb-metacarpal", "thumb-phalanx-proximal", "thumb-phalanx-distal", "thumb-tip"],
    *[[f"{finger}-{part}" for part in PARTS] for finger in FINGERS],
]
JOINTS = ["wrist", *CHAINS[0], *[f"{finger}-{part}" for finger in FINGERS for part in ("metacarpal", *PARTS)]]
POSITION = {joint: [f"{joint}_p{axis}" for axis in "xyz"] for joint in JOINTS}
ROTATION = {joint: [f"{joint}_q{axis}" for axis in "wxyz"] for joint in JOINTS}
COLUMNS = ["t_s", *[name for joint in JOINTS for name in (*POSITION[joint], *ROTATION[joint])]]
# WebXR: a joint's -z points along the bone away from the wrist, its y out of the back of the hand.
PALM_AXES = np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
SIDES = ("right", "left")


def read_webxr(path: str | Path, *, side: str = "right") -> Recording:
    """Read a log of joint poses: metres, quaternions w x y z, one row a frame. The palm frame is the wrist's.

    side: "right" or "left"; the log does not say. Raises BadTrace as `read_log` does, PalmarError for the side.
    """
    if side not in SIDES:
        raise PalmarError("E-CONF", "side", f"{side!r}; allowed are right, left")
    log = read_log(path, COLUMNS, "t_s", optional=("pinch_value",))
    position, rotation = log.stack(POSITION["wrist"]), unit_quaternions(log, ROTATION["wrist"])
    chains = np.stack([np.stack([log.stack(POSITION[j]) for j in chain], axis=1) for chain in CHAINS], axis=1)
    return recording_of_joints(
        *(DEVICE, Path(path).name, log.sha256, side),
        time_s=log.columns["t_s"],
        wrist_m=position,
        wrist_wxyz=rotation,
        chains_m=chains,
        seen=np.ones(len(position), dtype=bool),
        assumption=f"It is a {side} hand; the log does not say.",
    )


def recording_of_joints(
    device: str,
    source: str,
    sha256: str,
    side: str,
    *,
    time_s: Array,
    wrist_m: Array,
    wrist_wxyz: Array,
    chains_m: Array,
    seen: NDArray[np.bool_],
    assumption: str,
) -> Recording:
    """A hand of OpenXR or WebXR joints, whose palm frame is the wrist's.

    wrist_m (n, 3), wrist_wxyz (n, 4), about of unit length, chains_m (n, 5, 4, 3): world, first joint to tip of each
    finger. seen (n,), one at least: other frames have the palm of the one before, and no points.
    """
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), -1))
    last[last < 0] = int(np.argmax(seen))
    rotation = wrist_wxyz[last] / np.linalg.norm(wrist_wxyz[last], axis=1, keepdims=True)
    flips = np.where((rotation[1:] * rotation[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    rotation *= np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    chains = in_palm(chains_m[last], wrist_m[last], rotation)
    points = chains[:, :, 1:].copy()
    points[~seen] = np.nan
    return Recording(
        device=device,
        source=source,
        sha256=sha256,
        side=side,
        time_s=time_s,
        palm_position_m=wrist_m[last],
        palm_rotation_wxyz=rotation,
        palm_seen=seen,
        palm_axes=PALM_AXES,
        knuckle_m=chains[:, :, 0],
        points_m=points,
        phalanx=JOINT_POINTS,
        point_names=JOINT_NAMES,
        weight=np.ones(len(seen)),
        assumptions=(
            assumption,
            "The palm is rigid with the wrist joint; metacarpals other than the thumb's are taken as part of it.",
            "Only positions of joints are used, not their rotations; a tip is the end of the last phalanx.",
        ),
    )
