"""Where the phalanges of a hand model are at given angles. Convention: docs/formats.md, "Hand frame and hand model"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.model import HandModel

Array = NDArray[np.float64]


def turn_finger(hand: HandModel, finger: int, angles_rad: Array) -> tuple[Array, Array]:
    """Rotation and translation of each phalanx of one finger, palm from zero pose.

    angles_rad: (n, 4): abduction, then the three flexions. Returns (n, 3, 3, 3) and (n, 3, 3), metres: a zero-pose
    point x of phalanx k is at rotation[:, k] @ x + translation[:, k].
    """
    centre = hand.joint_m[finger]
    axes = [(hand.abduction_axis[finger], centre[0]), *zip(hand.flexion_axis[finger], centre, strict=True)]
    rotation = np.broadcast_to(np.eye(3), (len(angles_rad), 3, 3))
    translation = np.zeros((len(angles_rad), 3))
    rotations, translations = [], []
    # A turn about a carried axis, done after the others, is the turn about the zero-pose axis done before them.
    for i, (axis, through) in enumerate(axes):
        turn = Rotation.from_rotvec(angles_rad[:, i, None] * axis).as_matrix()
        translation = translation + (rotation @ (through - turn @ through)[..., None])[..., 0]
        rotation = rotation @ turn
        if i > 0:
            rotations.append(rotation)
            translations.append(translation)
    return np.stack(rotations, axis=1), np.stack(translations, axis=1)


def phalanges_in_palm(hand: HandModel, flexion_rad: Array, abduction_rad: Array) -> Array:
    """D and E of every frustum in the palm frame.

    flexion_rad: (n, 5, 3); abduction_rad: (n, 5). Returns (n, 5, 3, 2, 3), metres.
    """
    fingers = []
    for finger in range(5):
        angles_rad = np.concatenate([abduction_rad[:, finger, None], flexion_rad[:, finger]], axis=1)
        rotation, translation = turn_finger(hand, finger, angles_rad)
        fingers.append(np.einsum("nkij,kej->nkei", rotation, hand.phalanx_m[finger]) + translation[:, :, None])
    return np.stack(fingers, axis=1)


def finger_points(
    hand: HandModel,
    finger: int,
    angles_rad: Array,
    points_m: Array | None = None,
    phalanx: Sequence[int] = (0, 1, 2),
) -> Array:
    """Where points that are fixed to phalanges of one finger are, in the palm frame.

    angles_rad: (n, 4): abduction, then the three flexions. points_m: (m, 3) at the zero pose, one on each `phalanx`;
    left out, they are the second joint, the third joint and the tip (E of the last frustum). Returns (n, m, 3), metres.
    """
    points_m = joint_points(hand, finger) if points_m is None else points_m
    rotation, translation = turn_finger(hand, finger, angles_rad)
    on = list(phalanx)
    return np.einsum("nkij,kj->nki", rotation[:, on], points_m) + translation[:, on]


def finger_jacobian(
    hand: HandModel,
    finger: int,
    angles_rad: Array,
    points_m: Array | None = None,
    phalanx: Sequence[int] = (0, 1, 2),
) -> Array:
    """Derivative of `finger_points` by abduction and flexions: (n, m, 3, 4), metres per radian."""
    points_m = joint_points(hand, finger) if points_m is None else points_m
    rotation, translation = turn_finger(hand, finger, angles_rad)
    on = list(phalanx)
    points = np.einsum("nkij,kj->nki", rotation[:, on], points_m) + translation[:, on]
    # A turn leaves its own axis alone, so the pose of phalanx k also carries axis and centre of joint k.
    axis = np.einsum("nkij,kj->nki", rotation, hand.flexion_axis[finger])
    centre = np.einsum("nkij,kj->nki", rotation, hand.joint_m[finger]) + translation
    first = (len(angles_rad), 1, 3)
    axis = np.concatenate([np.broadcast_to(hand.abduction_axis[finger], first), axis], axis=1)
    centre = np.concatenate([np.broadcast_to(hand.joint_m[finger, 0], first), centre], axis=1)
    lever = np.cross(axis[:, None], points[:, :, None] - centre[:, None])  # (n, point, angle, 3)
    moves = np.tri(3, 4, 1)[on]  # a point on phalanx k is turned by abduction and flexions 0 to k
    return np.swapaxes(lever * moves[:, :, None], 2, 3)


def joint_points(hand: HandModel, finger: int) -> Array:
    """Second joint, third joint and tip at the zero pose, (3, 3) metres: on phalanges 0, 1 and 2."""
    return np.stack([hand.joint_m[finger, 1], hand.joint_m[finger, 2], hand.phalanx_m[finger, 2, 1]])


def rotate(rotation_wxyz: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by unit quaternions (..., 4), broadcast against each other."""
    w, u = rotation_wxyz[..., :1], rotation_wxyz[..., 1:]
    return vectors + 2.0 * np.cross(u, np.cross(u, vectors) + w * vectors)


def multiply(a_wxyz: Array, b_wxyz: Array) -> Array:
    """Product of quaternions (..., 4): first b, then a."""
    aw, av = a_wxyz[..., :1], a_wxyz[..., 1:]
    bw, bv = b_wxyz[..., :1], b_wxyz[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdims=True)
    return np.concatenate([w, aw * bv + bw * av + np.cross(av, bv)], axis=-1)


def conjugate(q_wxyz: Array) -> Array:
    """The inverse of unit quaternions (..., 4)."""
    return q_wxyz * np.array([1.0, -1.0, -1.0, -1.0])
