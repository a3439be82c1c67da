"""Optical motion capture of a glove with three markers on its back and two on each finger -> Recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS
from palmar.traces.columns import read_log
from palmar.traces.recording import Recording, frame_of, in_palm

DEVICE = "optical-glove"
# Of the palm frame that is made here: z out of the back, y towards the fingers.
PALM_AXES = np.column_stack([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def _columns(marker: str) -> list[str]:
    return [f"{marker}_{axis}_m" for axis in "xyz"]


BACK = [_columns(f"hand_{place}") for place in ("top", "left", "right")]
POINTS = [[_columns(f"{finger}_{place}") for place in ("middle", "tip")] for finger in FINGERS]
MARKERS = [name for marker in (*BACK, *[m for finger in POINTS for m in finger]) for name in marker]
COLUMNS = ["t_s", *MARKERS]
OBJECT = [name for place in ("top", "left", "right") for name in _columns(f"pillow_{place}")]
# The middle marker sits before the second joint, the tip marker on the last phalanx: seen from how little the distance
# between the two changes while a finger bends.
PHALANX = ((0, 2),) * 5


def read_optical_glove(path: str | Path, *, side: str = "right") -> Recording:
    """Read a log of marker positions, metres; an empty field is a marker that was not seen.

    The palm frame is at the middle of the three back markers: z out of the back, y towards the fingers, across
    `hand_right` - `hand_left`; left and right are as one sees the back of the hand, fingers up. side: "right" or
    "left". Raises BadTrace as `read_log` does, or E-TRACE-EMPTY if the back was never seen.
    """
    if side not in ("right", "left"):
        raise PalmarError("E-CONF", "side", f"{side!r}; allowed are right, left")
    log = read_log(path, COLUMNS, "t_s", optional=OBJECT, may_be_empty=set(MARKERS) | set(OBJECT))
    back = np.stack([log.stack(names) for names in BACK], axis=1)
    seen = np.isfinite(back).all(axis=(1, 2))
    if not seen.any():
        raise BadTrace("E-TRACE-EMPTY", log.where, "no row has all three markers of the back; the palm is not known")
    time_s = log.columns["t_s"]
    # Where the back was not seen the palm is between its neighbours, and the frame is marked as not tracked.
    flat = back.reshape(len(back), 9)
    back = np.stack([np.interp(time_s, time_s[seen], column[seen]) for column in flat.T], axis=1).reshape(-1, 3, 3)
    top, left, right = np.moveaxis(back, 1, 0)
    dorsal = np.cross(left - top, right - top)
    position, rotation = back.mean(axis=1), frame_of(np.cross(dorsal, right - left), dorsal)
    wrong = np.flatnonzero(np.isnan(rotation).any(axis=1))
    if wrong.size:
        raise BadTrace("E-TRACE-VALUE", f"{log.where}:line {wrong[0] + 2}", "the back's markers lie on one line")
    points = np.stack([np.stack([log.stack(m) for m in finger], axis=1) for finger in POINTS], axis=1)
    points[~seen] = np.nan  # seen from a palm that is not known they say nothing of the fingers
    return Recording(
        device=DEVICE,
        source=Path(path).name,
        sha256=log.sha256,
        side=side,
        time_s=time_s,
        palm_position_m=position,
        palm_rotation_wxyz=rotation,
        palm_seen=seen,
        palm_axes=PALM_AXES,
        knuckle_m=None,
        points_m=in_palm(points, position, rotation),
        phalanx=PHALANX,
        point_names=("middle marker", "tip marker"),
        weight=np.ones(len(time_s)),
        assumptions=(
            f"It is a {side} hand; the log does not say.",
            "The three markers of the back move with the palm as one; the middle marker of a finger sits on its first "
            "phalanx, the tip marker on its last.",
            "Two markers do not tell PIP from DIP: DIP is held to the hand's coupling.",
        ),
    )
