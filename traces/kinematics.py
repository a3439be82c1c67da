"""Where the phalanges of a hand model are at given angles. Convention: docs/formats.md, "Hand frame and hand model"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.model import HandModel

Array = NDArray[np.float64]

# A radian away from the start counts like 3 cm of miss. Without it a curled or a straight finger, whose points hardly
# feel one of the angles, turned three times as fast as the recorded one did.
KEEP_M_PER_RAD = 0.03


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


def finger_points(hand: HandModel, finger: int, angles_rad: Array) -> Array:
    """Second joint, third joint and tip (E of the last frustum) of one finger in the palm frame.

    angles_rad: (n, 4): abduction, then the three flexions. Returns (n, 3, 3), metres.
    """
    rotation, translation = turn_finger(hand, finger, angles_rad)
    return np.einsum("nkij,kj->nki", rotation, _zero_points(hand, finger)) + translation


def finger_jacobian(hand: HandModel, finger: int, angles_rad: Array) -> Array:
    """Derivative of `finger_points` by abduction and flexions: (n, 3, 3, 4), metres per radian."""
    rotation, translation = turn_finger(hand, finger, angles_rad)
    points = np.einsum("nkij,kj->nki", rotation, _zero_points(hand, finger)) + translation
    # A turn leaves its own axis alone, so the pose of phalanx k also carries axis and centre of joint k.
    axis = np.einsum("nkij,kj->nki", rotation, hand.flexion_axis[finger])
    centre = np.einsum("nkij,kj->nki", rotation, hand.joint_m[finger]) + translation
    first = (len(angles_rad), 1, 3)
    axis = np.concatenate([np.broadcast_to(hand.abduction_axis[finger], first), axis], axis=1)
    centre = np.concatenate([np.broadcast_to(hand.joint_m[finger, 0], first), centre], axis=1)
    lever = np.cross(axis[:, None], points[:, :, None] - centre[:, None])  # (n, point, angle, 3)
    moves = np.tri(3, 4, 1)  # point k lies on phalanx k, which abduction and flexions 0 to k turn
    return np.swapaxes(lever * moves[:, :, None], 2, 3)


def fit_finger(hand: HandModel, finger: int, points_m: Array, start_rad: Array) -> Array:
    """Angles inside the model's limits that bring the finger nearest to its wanted points, least squares a frame.

    points_m: (n, 3, 3) wanted second joint, third joint and tip in the palm frame; start_rad: (n, 4), near which the
    angles are held (KEEP_M_PER_RAD). Projected Levenberg-Marquardt, all frames at once. Returns (n, 4) radians.
    """
    limit = np.vstack([hand.abduction_limit_rad[finger], hand.flexion_limit_rad[finger]])
    low, high = limit[:, 0], limit[:, 1]
    count = len(points_m)
    keep = KEEP_M_PER_RAD * np.eye(4)

    def residual(angles: Array) -> Array:
        miss = (finger_points(hand, finger, angles) - points_m).reshape(count, 9)
        return np.concatenate([miss, (angles - start_rad) @ keep], axis=1)

    angles = np.clip(start_rad, low, high)
    error = residual(angles)
    damping = np.full(count, 1e-3)
    for _ in range(30):
        by_points = finger_jacobian(hand, finger, angles).reshape(count, 9, 4)
        jacobian = np.concatenate([by_points, np.broadcast_to(keep, (count, 4, 4))], axis=1)
        gradient = np.einsum("nij,ni->nj", jacobian, error)
        # An angle at its limit that wants to go farther stays out of the step.
        free = ~((angles <= low) & (gradient > 0) | (angles >= high) & (gradient < 0))
        hessian = np.einsum("nij,nik->njk", jacobian, jacobian) * free[:, :, None] * free[:, None, :]
        lever2_m2 = 1e-3  # of the size of the hessian, so that the damping has no unit
        hessian += np.eye(4) * np.where(free, damping[:, None] * lever2_m2, 1.0)[:, :, None]
        move = np.linalg.solve(hessian, -(gradient * free)[..., None])[..., 0]
        proposal = np.clip(angles + move, low, high)
        proposed = residual(proposal)
        better = (proposed**2).sum(1) <= (error**2).sum(1)
        angles = np.where(better[:, None], proposal, angles)
        error = np.where(better[:, None], proposed, error)
        damping = np.clip(damping * np.where(better, 0.1, 10.0), 1e-12, 1e6)
        if np.abs(move).max() < 1e-9:
            break
    return angles


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


def _zero_points(hand: HandModel, finger: int) -> Array:
    return np.stack([hand.joint_m[finger, 1], hand.joint_m[finger, 2], hand.phalanx_m[finger, 2, 1]])
