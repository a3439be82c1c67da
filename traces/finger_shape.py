"""The shape of one finger from a recording: where its knuckle is, its axes, its lengths, the places of its markers.

A least-squares problem in the shape and in the angles of some frames together. The shape is held to the hand it starts
from, each number as firmly as its kind is known; robust against frames that were seen wrongly (soft L1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from palmar.model import HandModel
from palmar.profile import bone_vectors
from palmar.traces.inverse import angle_limits, fit_finger, on_diagonal
from palmar.traces.kinematics import Array, finger_jacobian, finger_points, joint_points

NOISE_M = 0.001  # of a point; every miss and every change of the shape is counted in such units
ANGLE_RAD = 3.0  # how far angles are from where they start; only to make every problem have one answer
COUPLE_RAD = 0.05  # how far DIP is from its coupling where the points do not tell
STEP = 1e-5  # of the shape's numbers for differences; angles have their own derivative


class Firmness(NamedTuple):
    """How far the shape may be from where it starts: one standard deviation."""

    knuckle_m: float
    axis_rad: float
    length: float  # relative
    marker_m: float  # 0: the points are joints and move with the lengths


JOINTS_SEEN = Firmness(knuckle_m=0.003, axis_rad=0.25, length=0.02, marker_m=0.0)
MARKERS_SEEN = Firmness(knuckle_m=0.008, axis_rad=0.12, length=0.05, marker_m=0.006)


@threadpool_limits.wrap(limits=1)  # as `fit_finger`
def fit_shape(
    hand: HandModel,
    finger: int,
    wanted_m: Array,
    *,
    firm: Firmness,
    points_m: Array,
    phalanx: Sequence[int],
    weight: Array,
) -> tuple[HandModel, Array]:
    """The hand with this finger's shape fitted to frames (n, m, 3) in the palm frame, and the points' places (m, 3).

    points_m: the places to start from; weight: (n,). Angles stay inside the hand's limits.
    """
    couple = COUPLE_RAD if firm.marker_m else 0.0
    start = fit_finger(
        hand,
        finger,
        wanted_m,
        points_m=points_m,
        phalanx=phalanx,
        weight=np.tile(weight[:, None], (1, len(points_m))),
        keep_m_per_rad=NOISE_M / ANGLE_RAD,
        near_rad=np.tile(0.25 * np.sum(angle_limits(hand, finger), axis=0), (len(wanted_m), 1)),
        couple_m_per_rad=NOISE_M / couple if couple else 0.0,
    )
    sigma = np.array([firm.knuckle_m] * 3 + [firm.axis_rad] * 8 + [firm.length] * 3)
    sigma = np.concatenate([sigma, np.full(points_m.size if firm.marker_m else 0, firm.marker_m)])
    seen = np.isfinite(wanted_m).all(axis=2)
    problem = _Problem(
        hand=hand,
        finger=finger,
        points_m=points_m,
        phalanx=phalanx,
        wanted_m=np.nan_to_num(wanted_m),
        scale=np.sqrt(weight)[:, None, None] * seen[..., None] / NOISE_M,
        sigma=sigma,
        start_rad=start,
        couple=couple,
    )
    low, high = angle_limits(hand, finger)
    inside = np.clip(start, low + 1e-3, high - 1e-3)
    found = least_squares(
        problem.residual,
        np.concatenate([np.zeros(len(sigma)), inside.ravel()]),
        problem.jacobian,
        bounds=(
            np.concatenate([np.full(len(sigma), -6.0), np.tile(low, len(start))]),
            np.concatenate([np.full(len(sigma), 6.0), np.tile(high, len(start))]),
        ),
        loss="soft_l1",
        f_scale=3.0,
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-5,
        max_nfev=40,
    )
    return problem.shape(found.x[: len(sigma)])


class _Problem(NamedTuple):
    """Unknowns: the shape in units of sigma, then four angles a frame."""

    hand: HandModel
    finger: int
    points_m: Array
    phalanx: Sequence[int]
    wanted_m: Array
    scale: Array  # (n, m, 1)
    sigma: Array
    start_rad: Array
    couple: float

    def shape(self, units: Array) -> tuple[HandModel, Array]:
        change = units * self.sigma
        f, hand = self.finger, self.hand
        bones = bone_vectors(hand, f)
        grown = bones * (1.0 + change[11:14, None])
        joint = hand.joint_m[f, 0] + change[:3] + np.vstack([np.zeros(3), np.cumsum(grown, axis=0)])
        axes = np.vstack([hand.abduction_axis[f], hand.flexion_axis[f]])
        axes = np.stack([_tilt(axis, by) for axis, by in zip(axes, change[3:11].reshape(4, 2), strict=True)])
        names = ("joint_m", "phalanx_m", "flexion_axis", "abduction_axis")
        parts: dict[str, Any] = {name: np.array(getattr(hand, name)) for name in names}
        parts["joint_m"][f] = joint[:3]
        # D and E keep their places along the bone.
        for k in range(3):
            parts["phalanx_m"][f, k] = joint[k] + (hand.phalanx_m[f, k] - hand.joint_m[f, k]) * (1.0 + change[11 + k])
        parts["abduction_axis"][f], parts["flexion_axis"][f] = axes[0], axes[1:]
        moved = replace(hand, **parts)
        if len(change) == 14:
            return moved, joint_points(moved, f)
        # A marker moves with the phalanx it sits on.
        carried = self.points_m + (joint[:3] - hand.joint_m[f])[list(self.phalanx)]
        return moved, carried + change[14:].reshape(-1, 3)

    def misses(self, units: Array, angles: Array) -> Array:
        hand, points = self.shape(units)
        return ((finger_points(hand, self.finger, angles, points, self.phalanx) - self.wanted_m) * self.scale).ravel()

    def residual(self, x: Array) -> Array:
        units, angles = x[: len(self.sigma)], x[len(self.sigma) :].reshape(-1, 4)
        rows = [self.misses(units, angles), units, (angles - self.start_rad).ravel() / ANGLE_RAD]
        if self.couple:
            rows.append((angles[:, 3] - self.hand.flexion_coupling[self.finger, 1] * angles[:, 2]) / self.couple)
        return np.concatenate(rows)

    def jacobian(self, x: Array) -> Array:
        units, angles = x[: len(self.sigma)], x[len(self.sigma) :].reshape(-1, 4)
        size, count = len(units), len(angles)
        here = self.misses(units, angles)
        by_shape = np.column_stack([(self.misses(units + STEP * e, angles) - here) / STEP for e in np.eye(size)])
        hand, points = self.shape(units)
        by_angle = finger_jacobian(hand, self.finger, angles, points, self.phalanx) * self.scale[..., None]
        rows = [
            np.hstack([by_shape, on_diagonal(by_angle.reshape(count, -1, 4))]),
            np.hstack([np.eye(size), np.zeros((size, 4 * count))]),
            np.hstack([np.zeros((4 * count, size)), np.eye(4 * count) / ANGLE_RAD]),
        ]
        if self.couple:
            row = np.array([[[0.0, 0.0, -self.hand.flexion_coupling[self.finger, 1], 1.0]]]) / self.couple
            rows.append(np.hstack([np.zeros((count, size)), on_diagonal(np.tile(row, (count, 1, 1)))]))
        return np.vstack(rows)


def _tilt(axis: Array, by_rad: Array) -> Array:
    """A unit axis tilted about two directions across it."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first = first / np.linalg.norm(first)
    return Rotation.from_rotvec(by_rad[0] * first + by_rad[1] * np.cross(axis, first)).apply(axis)
