"""What a lean pack was tuned on: the part of the surface that hands came near, and how far a run goes beyond it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.records import Run

Array = NDArray[np.float64]

UNIT_M = 1e-4  # of the numbers in `seen`


def contact_points(run: Run) -> tuple[NDArray[np.int64], Array]:
    """Step (c,) and place (c, 3) of each contact, metres in the object's frame."""
    step = np.repeat(np.arange(len(run.time_s)), np.diff(run.contact_start))
    w, axis = run.object_rotation_wxyz[step, :1], -run.object_rotation_wxyz[step, 1:]
    offset = run.contact_point_m - run.object_position_m[step]
    turn = 2 * np.cross(axis, offset)
    return step, offset + w * turn + np.cross(axis, turn)


def pack_balls(balls_m: Array) -> list[int]:
    """Balls (k, 4) as whole numbers for a manifest, radii rounded up so that nothing is lost."""
    grown = balls_m + np.array([0, 0, 0, UNIT_M])
    return (
        np.column_stack([np.round(grown[:, :3] / UNIT_M), np.ceil(grown[:, 3] / UNIT_M)]).astype(int).ravel().tolist()
    )


def unpack_balls(numbers: list[int]) -> Array:
    return np.array(numbers, dtype=np.float64).reshape(-1, 4) * UNIT_M


def beyond(run: Run, tuned: dict[str, Any]) -> Array:
    """(n,) metres: how far outside of what was seen the farthest contact of each step is; 0 inside or without one."""
    from scipy.spatial import cKDTree

    balls = unpack_balls(tuned["seen"])
    step, points = contact_points(run)
    out = np.zeros(len(run.time_s))
    if len(points):
        away = np.full(len(points), np.inf)
        for radius in np.unique(balls[:, 3]):
            near, _ = cKDTree(balls[balls[:, 3] == radius, :3]).query(points)
            away = np.minimum(away, near - radius)
        np.maximum.at(out, step, np.maximum(away, 0.0))
    return out


def outside_text(run: Run, found: Array) -> str:
    """From when and how far a run is outside, from the answer of `beyond`."""
    first, deepest = int(np.argmax(found > 0)), int(np.argmax(found))
    start, at = (float(run.time_s[k] - run.time_s[0]) for k in (first, deepest))
    share = float((found > 0).mean())
    farthest = f"{1e3 * found[deepest]:.1f} mm outside of what was seen at {at:.2f} s"
    return f"from {start:.2f} s on, {farthest}, {share:.1%} of the steps"
