"""Inverse kinematics: the angles of a finger from where points on it were seen, least squares inside the limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from palmar.model import HandModel
from palmar.traces.kinematics import Array, finger_jacobian, finger_points, joint_points

# A radian away from where the angles are held counts like so many metres of miss. Without it a curled or a straight
# finger, whose points hardly feel one of the angles, turned three times as fast as the recorded one did.
KEEP_M_PER_RAD = 0.03
# Held to the frame before, an angle that is seen must not be late by more than a hundredth of a degree at 10 rad/s.
FOLLOW_M_PER_RAD = 0.001
FRAMES = 16  # solved at once: fewer pay for calls, more for the size of the matrices
GOOD_M = 0.003  # root of a frame's squared misses; the search is not started anew below it
TOLERANCE = 1e-10  # relative, of cost, step and gradient, at which the search ends


def angle_limits(hand: HandModel, finger: int) -> tuple[Array, Array]:
    """Lowest and highest abduction and flexions of one finger, (4,) each."""
    limit = np.vstack([hand.abduction_limit_rad[finger], hand.flexion_limit_rad[finger]])
    return limit[:, 0], limit[:, 1]


# Small matrices: a second thread of the linear algebra would only wait for the first.
@threadpool_limits.wrap(limits=1)
def fit_finger(
    hand: HandModel,
    finger: int,
    wanted_m: Array,
    *,
    near_rad: Array | None = None,
    keep_m_per_rad: float = KEEP_M_PER_RAD,
    points_m: Array | None = None,
    phalanx: Sequence[int] = (0, 1, 2),
    weight: Array | None = None,
    couple_m_per_rad: float = 0.0,
) -> Array:
    """Angles inside the model's limits that bring points on a finger nearest to where they were seen.

    wanted_m: (n, m, 3) in the palm frame, NaN where a point was not seen; points_m and phalanx as in `finger_points`;
    weight: (n, m), 1 if left out. near_rad: (n, 4), where the angles are held by keep_m_per_rad; left out, they are
    held to the frame before, and each solve starts there. couple_m_per_rad: how hard DIP is held to the hand's coupling
    of it to PIP, for points that do not tell the two apart. Returns (n, 4) radians: abduction, flexions.
    """
    low, high = angle_limits(hand, finger)
    points_m = joint_points(hand, finger) if points_m is None else points_m
    seen = np.isfinite(wanted_m).all(axis=2)
    root = np.sqrt(np.ones(seen.shape) if weight is None else weight) * seen
    wanted_m = np.nan_to_num(wanted_m)
    angles = np.empty((len(wanted_m), 4))
    last = 0.25 * (low + high)
    for start in range(0, len(wanted_m), FRAMES):
        part = slice(start, start + FRAMES)
        near = np.tile(last, (len(wanted_m[part]), 1)) if near_rad is None else near_rad[part]
        linear = _linear_rows(len(near), keep_m_per_rad, couple_m_per_rad, hand.flexion_coupling[finger, 1])
        held = np.concatenate([keep_m_per_rad * near.ravel(), np.zeros(len(linear) - near.size)])
        frames = _Frames(hand, finger, points_m, phalanx, wanted_m[part], root[part], linear, held)
        angles[part] = _solve(frames, np.clip(near, low, high), low, high)
        last = angles[part][-1]
    return angles


class _Frames(NamedTuple):
    """Some frames of one finger as a least-squares problem in their angles, one after the other."""

    hand: HandModel
    finger: int
    points_m: Array
    phalanx: Sequence[int]
    wanted_m: Array
    root: Array
    linear: Array
    held: Array

    def residual(self, x: Array) -> Array:
        points = finger_points(self.hand, self.finger, x.reshape(-1, 4), self.points_m, self.phalanx)
        miss = (points - self.wanted_m) * self.root[..., None]
        return np.concatenate([miss.ravel(), self.linear @ x - self.held])

    def jacobian(self, x: Array) -> Array:
        by_angle = finger_jacobian(self.hand, self.finger, x.reshape(-1, 4), self.points_m, self.phalanx)
        blocks = (by_angle * self.root[..., None, None]).reshape(len(by_angle), -1, 4)
        return np.vstack([on_diagonal(blocks), self.linear])


def _solve(frames: _Frames, near: Array, low: Array, high: Array) -> Array:
    """Angles (n, 4) of the frames, from where they are held; where that ends far from what was seen, started anew."""
    best: Any = None
    for start in (near, np.tile(0.5 * (low + high), (len(near), 1))):
        found = least_squares(
            frames.residual,
            start.ravel(),
            frames.jacobian,
            bounds=(np.tile(low, len(near)), np.tile(high, len(near))),
            method="dogbox",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
        )
        best = found if best is None or found.cost < best.cost else best
        if 2.0 * best.cost < len(near) * GOOD_M**2:
            break
    return best.x.reshape(-1, 4)


def on_diagonal(blocks: Array) -> Array:
    """(n, r, c) as one matrix (n r, n c) with the blocks on its diagonal."""
    n, r, c = blocks.shape
    matrix = np.zeros((n, r, n, c))
    matrix[np.arange(n), :, np.arange(n)] = blocks
    return matrix.reshape(n * r, n * c)


def _linear_rows(count: int, keep: float, couple: float, ratio: float) -> Array:
    """Rows that hold the angles, and below them, if asked, rows that hold DIP to its coupling."""
    rows = [keep * np.eye(4 * count)]
    if couple:
        rows.append(on_diagonal(np.tile(couple * np.array([[[0.0, 0.0, -ratio, 1.0]]]), (count, 1, 1))))
    return np.vstack(rows)
