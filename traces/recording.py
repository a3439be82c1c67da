"""A recording of positions: where joints or markers of a hand were, frame by frame, and nothing of its angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.traces.kinematics import Array, conjugate, rotate

JOINT_POINTS = ((0, 1, 2),) * 5  # second joint, third joint and tip: each is fixed to the phalanx before it
JOINT_NAMES = ("joint 2", "joint 3", "tip")


@dataclass(frozen=True)
class Recording:
    """n frames of one hand. Points are in the device's palm frame, which moves with the palm.

    knuckle_m is None if the device does not see the first joints: then points_m are markers, whose places on the hand
    have to be known from a profile.
    """

    device: str
    source: str
    sha256: str
    side: str
    time_s: Array  # (n,)
    palm_position_m: Array  # (n, 3) world from the device's palm frame
    palm_rotation_wxyz: Array  # (n, 4)
    palm_seen: NDArray[np.bool_]  # (n,)
    palm_axes: Array  # (3, 3) columns palmar, distal and across both in the device's palm frame, roughly
    knuckle_m: Array | None  # (n, 5, 3) first joints
    points_m: Array  # (n, 5, m, 3), NaN where not seen
    phalanx: tuple[tuple[int, ...], ...]  # of each finger's m points
    point_names: tuple[str, ...]  # m, the last is at the tip
    weight: Array  # (n,) how far the device trusts the frame, 0 to 1
    assumptions: tuple[str, ...]

    @property
    def markers(self) -> bool:
        return self.knuckle_m is None


def in_palm(points_m: Array, position_m: Array, rotation_wxyz: Array) -> Array:
    """World points (n, ..., 3) in the palm frames (n, 3), (n, 4)."""
    lead = (len(points_m), *[1] * (points_m.ndim - 2))
    back = conjugate(rotation_wxyz).reshape(*lead, 4)
    return rotate(back, points_m - position_m.reshape(*lead, 3))


def frame_of(distal: Array, dorsal: Array) -> Array:
    """Rotation w x y z (n, 4), world from palm, with y along `distal` and z the part of `dorsal` across it.

    Signs are such that neighbours are near each other; NaN where the two span no frame.
    """
    y = distal / np.linalg.norm(distal, axis=1, keepdims=True)
    z = dorsal - (dorsal * y).sum(axis=1, keepdims=True) * y
    size = np.linalg.norm(z, axis=1, keepdims=True)
    spans = size[:, 0] > 0.1 * np.linalg.norm(dorsal, axis=1)
    z = z / np.where(spans[:, None], size, 1.0)
    rotation = np.full((len(y), 4), np.nan)
    matrix = np.stack([np.cross(y, z), y, z], axis=2)[spans]
    if len(matrix):
        rotation[spans] = np.roll(Rotation.from_matrix(matrix).as_quat(), 1, axis=1)
        flips = np.where((rotation[spans][1:] * rotation[spans][:-1]).sum(axis=1) < 0, -1.0, 1.0)
        rotation[spans] *= np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    return rotation
