"""Where a device's palm frame is in the hand's."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace
from palmar.model import HandModel
from palmar.traces.kinematics import Array, rotate
from palmar.traces.recording import Recording

Pose = tuple[Array, Array]  # (3,) metres, (4,) w x y z

TRUSTED = 0.5  # frames of less weight do not count for what is constant, as long as enough are left
ENOUGH = 10
THUMB_WEIGHT = 0.2  # of its first joint among the five for where the palm is: it moves against the palm


def palm_from_knuckles(recording: Recording, hand: HandModel) -> Pose:
    """Where the device's palm frame is in the hand's: the recorded knuckles laid onto the hand's, the thumb's less."""
    assert recording.knuckle_m is not None
    return rigid_between(np.median(recording.knuckle_m[trusted_frames(recording)], axis=0), hand.joint_m[:, 0])


def rigid_between(points: Array, onto: Array) -> Pose:
    """The motion that lays five knuckles onto five others, least squares."""
    weight = np.array([THUMB_WEIGHT, 1.0, 1.0, 1.0, 1.0])
    middle, onto_middle = np.average(points, axis=0, weights=weight), np.average(onto, axis=0, weights=weight)
    turn, _ = Rotation.align_vectors(onto - onto_middle, points - middle, weights=weight)
    return to_frame(turn.as_matrix(), onto_middle - turn.apply(middle))


def trusted_frames(recording: Recording) -> Array:
    """Frames that count: (n,) bool."""
    seen = recording.palm_seen & (np.isfinite(recording.points_m).all(axis=3).sum(axis=(1, 2)) > 0)
    good = seen & (recording.weight >= TRUSTED)
    good = good if good.sum() >= ENOUGH else seen
    if good.sum() < ENOUGH:
        raise BadTrace("E-TRACE-EMPTY", recording.source, f"{good.sum()} frames show the hand; {ENOUGH} are needed")
    return good


def one_after(second: Pose, first: Pose) -> Pose:
    """The motion that does first, then second."""
    turn = Rotation.from_quat(np.roll(second[1], -1)) * Rotation.from_quat(np.roll(first[1], -1))
    return to_frame(turn.as_matrix(), in_frame(first[0][None], second)[0])


def in_frame(points_m: Array, pose: Pose) -> Array:
    """Points (..., 3) of the device's palm frame in the hand's."""
    return rotate(pose[1], points_m) + pose[0]


def to_frame(rotation: Array, position_m: Array) -> Pose:
    """A pose from a matrix (3, 3) and a place (3,)."""
    quaternion = np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
    return np.asarray(position_m, dtype=np.float64), quaternion * (1.0 if quaternion[0] >= 0 else -1.0)
