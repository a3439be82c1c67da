"""A log of a Leap Motion sensor: palm, and the joints of each finger -> Recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palmar.errors import BadTrace
from palmar.model import FINGERS
from palmar.traces.columns import read_log
from palmar.traces.recording import JOINT_NAMES, JOINT_POINTS, Recording, frame_of, in_palm

DEVICE = "leap"
# Of the palm frame that is made here: z out of the back, y towards the fingers.
PALM_AXES = np.column_stack([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
PALM = [f"palm_p{axis}_m" for axis in "xyz"]
NORMAL = [f"palm_n{axis}" for axis in "xyz"]
DIRECTION = [f"palm_d{axis}" for axis in "xyz"]
POINTS = [
    [[f"{finger}_{joint}_{axis}_m" for axis in "xyz"] for joint in ("mcp", "pip", "dip", "tip")] for finger in FINGERS
]
UNUSED = [*[f"palm_v{axis}_mps" for axis in "xyz"], *[f"finger_len_{finger}_mm" for finger in FINGERS]]
COLUMNS = [
    *["t_s", "frame_id", "hand_id", "is_right", "confidence", "pinch_strength", "grab_strength"],
    *[*PALM, *NORMAL, *DIRECTION, *UNUSED[:3]],
    *[name for finger in POINTS for joint in finger for name in joint],
    *UNUSED[3:],
]


def read_leap(path: str | Path) -> Recording:
    """Read a log of one hand: metres, seconds of the device's clock. The palm frame is its centre, normal, direction.

    Raises BadTrace as `read_log` does, and E-TRACE-VALUE for a second hand or axes that span no frame.
    """
    log = read_log(path, COLUMNS, "t_s")
    for name in ("hand_id", "is_right"):
        other = np.flatnonzero(log.columns[name] != log.columns[name][0])
        if other.size:
            i = int(other[0])
            found = f"{log.columns[name][i]:g} after {log.columns[name][0]:g}"
            raise BadTrace("E-TRACE-VALUE", f"{log.where}:line {i + 2}, column {name}", f"{found}; one hand is needed")
    confidence = log.columns["confidence"]
    wrong = np.flatnonzero((confidence < 0) | (confidence > 1))
    if wrong.size:
        i = int(wrong[0])
        raise BadTrace(
            "E-TRACE-VALUE", f"{log.where}:line {i + 2}, column confidence", f"{confidence[i]:g}; 0 to 1 is allowed"
        )
    side = "right" if log.columns["is_right"][0] else "left"
    position, rotation = log.stack(PALM), frame_of(log.stack(DIRECTION), -log.stack(NORMAL))
    wrong = np.flatnonzero(np.isnan(rotation).any(axis=1))
    if wrong.size:
        raise BadTrace(
            "E-TRACE-VALUE",
            f"{log.where}:line {wrong[0] + 2}",
            "palm_n and palm_d span no frame; two directions across each other are needed",
        )
    chains = np.stack([np.stack([log.stack(joint) for joint in finger], axis=1) for finger in POINTS], axis=1)
    chains = in_palm(chains, position, rotation)
    return Recording(
        device=DEVICE,
        source=Path(path).name,
        sha256=log.sha256,
        side=side,
        time_s=log.columns["t_s"],
        palm_position_m=position,
        palm_rotation_wxyz=rotation,
        palm_seen=np.ones(len(position), dtype=bool),
        palm_axes=PALM_AXES,
        knuckle_m=chains[:, :, 0],
        points_m=chains[:, :, 1:],
        phalanx=JOINT_POINTS,
        point_names=JOINT_NAMES,
        weight=confidence,
        assumptions=(
            "The palm frame is the sensor's palm centre, normal and direction.",
            "The thumb's mcp is the base of its metacarpal, which the sensor's hand takes for the first phalanx.",
            "Frames count by the sensor's confidence.",
        ),
    )
