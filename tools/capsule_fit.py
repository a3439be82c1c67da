"""Tapered capsules fitted to the skin of a finger over several poses at once.

A skin point should lie on the surface of the finger's three capsules together with the palm: its signed gap to that
union is what is made small. Each point counts by its area; gaps outside and inside count alike. The joints carry the
capsules from pose to pose, so a capsule that fits the straight finger and not the bent one pays for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

MIN_RADIUS_M, MAX_RADIUS_M = 0.002, 0.03
REACH_M = 0.02  # that an end may move from where the search starts
STEEPEST = 0.9  # of |r1 - r2| to the length: beyond 1 one ball would hold the other
# Gaps count with this power before they are squared: the few large ones weigh more than in least squares.
POWER = 2.0
MM = 1e3


@dataclass(frozen=True)
class FingerSkin:
    """Skin points of one finger at one pose."""

    local_m: Array  # (3, n, 3) the points in the zero pose of each of the three phalanges
    other_gap_m: Array  # (n,) signed gap to what else of the hand covers them
    weight: Array  # (n,) root of each point's area


def capsule_gap(ends: Array, radii: Array, points: Array) -> tuple[Array, Array]:
    """Signed gap (n,) of points (n, 3) to a tapered capsule, ends (2, 3), radii (2,), and t on its axis, 0 to 1."""
    axis = ends[1] - ends[0]
    length = max(float(np.linalg.norm(axis)), 1e-9)
    axis = axis / length
    offset = points - ends[0]
    along = offset @ axis
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along * along, 0))
    slope = float(np.clip((radii[0] - radii[1]) / length, -STEEPEST, STEEPEST))
    at = np.clip(along - across * slope / np.sqrt(1 - slope * slope), 0, length) / length
    return np.hypot(along - at * length, across) - (radii[0] + at * (radii[1] - radii[0])), at


def fit_finger(poses: list[FingerSkin], shares: list[float], start: Array) -> Array:
    """Three capsules (3, 8): ends c1, c2 and radii r1, r2 of each at the zero pose, metres. start: (3, 8) likewise.

    shares: what a gap at each pose counts.
    """
    low = start - np.array([REACH_M] * 6 + [1.0] * 2)
    high = start + np.array([REACH_M] * 6 + [1.0] * 2)
    low[:, 6:], high[:, 6:] = MIN_RADIUS_M, MAX_RADIUS_M
    begin = np.clip(start, low + 1e-6, high - 1e-6)
    found = least_squares(
        lambda flat: _residuals(poses, shares, flat.reshape(3, 8)),
        begin.ravel(),
        jac=lambda flat: _slopes(poses, shares, flat.reshape(3, 8)),
        bounds=(low.ravel(), high.ravel()),
        x_scale=1e-3,
        ftol=1e-6,
        max_nfev=60,
    )
    return found.x.reshape(3, 8)


def finger_gaps(pose: FingerSkin, capsules: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Signed gap (n,) to capsules (3, 8) and all else, which phalanx is nearest or -1, and the place on its axis."""
    gap = pose.other_gap_m.copy()
    owner, place = np.full(len(gap), -1), np.zeros(len(gap))
    for j in range(3):
        own, at = capsule_gap(capsules[j, :6].reshape(2, 3), capsules[j, 6:], pose.local_m[j])
        nearer = own < gap
        gap[nearer], owner[nearer], place[nearer] = own[nearer], j, at[nearer]
    return gap, owner, place


def _residuals(poses: list[FingerSkin], shares: list[float], capsules: Array) -> Array:
    """Weighted powers of the signed gaps, all poses in a row (m,)."""
    values = []
    for pose, share in zip(poses, shares, strict=True):
        gap = share * MM * finger_gaps(pose, capsules)[0]
        values.append(pose.weight * np.sign(gap) * np.abs(gap) ** POWER)
    return np.concatenate(values)


def _slopes(poses: list[FingerSkin], shares: list[float], capsules: Array) -> Array:
    """Derivatives (m, 24) of the residuals by the capsules' numbers."""
    slopes = []
    for pose, share in zip(poses, shares, strict=True):
        gap, owner, place = finger_gaps(pose, capsules)
        slope = np.zeros((len(gap), 3, 8))
        for j in range(3):
            mine = np.flatnonzero(owner == j)
            t = place[mine, None]
            from_axis = pose.local_m[j, mine] - (1 - t) * capsules[j, :3] - t * capsules[j, 3:6]
            normal = from_axis / np.maximum(np.linalg.norm(from_axis, axis=1), 1e-9)[:, None]
            slope[mine, j] = np.hstack([-(1 - t) * normal, -t * normal, t - 1, -t])
        steep = pose.weight * POWER * np.abs(share * MM * gap) ** (POWER - 1) * share * MM
        slopes.append(steep[:, None] * slope.reshape(len(gap), 24))
    return np.concatenate(slopes)
