"""Samples as a device delivers them, of a motion that is known."""

import numpy as np

from palmar.records import Trace


def stream(count=50, interval_s=0.01):
    """A moving hand; no number comes twice."""
    part = np.arange(count) / count
    return Trace(
        header={"device": "made", "hand": "made", "side": "right"},
        time_s=interval_s * np.arange(count),
        palm_position_m=np.column_stack([0.3 + 0.1 * part, 0.2 * part, 0.1 + part]),
        palm_rotation_wxyz=np.column_stack([np.cos(part), np.sin(part), 0 * part, 0 * part]),
        flexion_rad=0.2 + part[:, None, None] * np.linspace(0.5, 1.0, 15).reshape(5, 3),
        abduction_rad=0.1 * part[:, None] * np.ones(5),
        tracked=np.ones(count, bool),
        has_object_pose=np.zeros(count, bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )


def assert_same(a, b):
    for name in Trace.__dataclass_fields__:
        if name not in ("header", "lost"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
