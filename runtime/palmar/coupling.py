"""Angles that a device does not read, from those that it does: the linear coupling of a finger's joints."""

from __future__ import annotations

import numpy as np

from palmar.errors import BadTrace
from palmar.model import FINGERS, JOINTS, Array, HandModel


def complete_flexion(hand: HandModel, flexion_rad: Array) -> Array:
    """Fill the joints that a device does not read, NaN, from its finger's nearest joint that it does.

    flexion_rad: (n, 5, 3), MCP PIP DIP. The hand's `flexion_coupling` has PIP per MCP and DIP per PIP; it is followed
    outwards first, then inwards. What is filled stays inside the joint's limits; what was read is left as it is.
    Returns (n, 5, 3). Raises BadTrace E-TRACE-VALUE if a finger has no angle at all.
    """
    filled = np.array(flexion_rad, dtype=np.float64)
    unread = np.isnan(filled)
    empty = np.argwhere(unread.all(axis=2))
    if len(empty):
        at, finger = empty[0]
        raise BadTrace(
            "E-TRACE-VALUE",
            f"sample {at}, {FINGERS[finger]}",
            f"no angle of {', '.join(JOINTS)}; at least one joint of a finger has to be read",
        )
    ratio = hand.flexion_coupling
    for joint in (1, 2):
        outward = filled[:, :, joint - 1] * ratio[:, joint - 1]
        filled[:, :, joint] = np.where(np.isnan(filled[:, :, joint]), outward, filled[:, :, joint])
    for joint in (1, 0):
        inward = filled[:, :, joint + 1] / ratio[:, joint]
        filled[:, :, joint] = np.where(np.isnan(filled[:, :, joint]), inward, filled[:, :, joint])
    inside = np.clip(filled, hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1])
    return np.where(unread, inside, filled)
