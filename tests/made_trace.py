"""A plain motion that tests of whole verbs replay."""

import numpy as np

from palmar.records import Trace


def make_trace(n=300):
    """A hand that comes down 40 mm onto what is at the origin, fingers half closed."""
    position = np.zeros((n, 3))
    position[:, 2] = np.linspace(0.07, 0.03, n)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Trace(
        header={"device": "test", "hand": "test", "side": "right"},
        time_s=np.arange(n) * 1e-3,
        palm_position_m=position,
        palm_rotation_wxyz=turn,
        flexion_rad=np.tile(np.linspace(0.1, 0.6, n)[:, None, None], (1, 5, 3)),
        abduction_rad=np.zeros((n, 5)),
        tracked=np.ones(n, bool),
        has_object_pose=np.zeros(n, bool),
        object_position_m=np.zeros((n, 3)),
        object_rotation_wxyz=turn,
    )
