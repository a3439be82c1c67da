"""Logs of positions as devices write them, of a hand and angles that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.model import FINGERS
from palmar.profile import FingerMeasures, Profile, fit_to_profile, mirror_hand
from palmar.tools.hand_file import default_hand
from palmar.traces import leap, optical_glove, webxr
from palmar.traces.calibrate import usual_places
from palmar.traces.kinematics import finger_points

FRAMES = 120
RATE_HZ = 90.0


def made_hand(side: str = "right"):
    """A hand of other proportions than the default one, with axes that are not parallel."""
    generator = np.random.default_rng(5)
    start = default_hand() if side == "right" else mirror_hand(default_hand())
    fingers = []
    for f in range(5):
        own = np.linalg.norm(np.diff(np.vstack([start.joint_m[f], start.phalanx_m[f, 2, 1]]), axis=0), axis=1)
        tilt = Rotation.from_rotvec(generator.normal(0, 0.05, (3, 3)))
        fingers.append(
            FingerMeasures(
                length_m=own * generator.uniform(0.93, 1.1, 3),
                joint_m=start.joint_m[f, 0] + generator.normal(0, 0.001, 3),
                flexion_axis=tilt.apply(start.flexion_axis[f]),
            )
        )
    return fit_to_profile(start, Profile("made", side, "test", fingers=tuple(fingers)))


def made_angles(count: int = FRAMES):
    """Open, fist, open, with some spreading: (n, 5, 4) abduction and flexions, inside the default hand's ranges."""
    part = np.linspace(0, 1, count)
    close = 0.5 - 0.5 * np.cos(2 * np.pi * part)
    angles = np.empty((count, 5, 4))
    for f in range(5):
        fist = np.array([0.6, 0.7, 0.9]) if f == 0 else np.array([1.3, 1.5, 1.0])
        late = 0.5 - 0.5 * np.cos(2 * np.pi * (part - 0.04 * f))
        angles[:, f, 0] = 0.15 * np.sin(2 * np.pi * part + f)
        angles[:, f, 1:] = 0.05 + np.column_stack([close, late, late]) * fist
        angles[:, f, 3] = angles[:, f, 2] * 0.667 if f else angles[:, f, 3]
    return angles


def made_palm(count: int = FRAMES):
    """Palm positions (n, 3) and rotations in the world."""
    part = np.linspace(0, 1, count)
    position = np.column_stack([0.1 * np.sin(3 * part), 0.2 * part, 0.3 + 0.05 * np.cos(5 * part)])
    return position, Rotation.from_rotvec(np.column_stack([0.4 * part, 0.8 * np.sin(2 * part), 1.0 + part]))


def joints_in_palm(hand, angles):
    """(n, 5, 4, 3): the three joints and the tip."""
    first = np.broadcast_to(hand.joint_m[:, None, 0], (len(angles), 5, 1, 3))
    rest = np.stack([finger_points(hand, f, angles[:, f]) for f in range(5)], axis=1)
    return np.concatenate([first, rest], axis=2)


def markers_in_palm(hand, angles, places):
    return np.stack([finger_points(hand, f, angles[:, f], places[f], (0, 2)) for f in range(5)], axis=1)


def to_world(points, palm):
    position, rotation = palm
    turned = np.einsum("nij,n...j->n...i", rotation.as_matrix(), points)
    return turned + position.reshape(len(position), *[1] * (points.ndim - 2), 3)


def write_log(path: Path, columns, rows) -> Path:
    """rows: a dict of columns by name; what is not given is 0. NaN is an empty field."""
    count = len(rows["t_s"])
    table = np.column_stack([rows.get(name, np.zeros(count)) for name in columns])
    lines = [",".join("" if np.isnan(v) else f"{v:.9f}" for v in row) for row in table]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
    return path


def _put(rows, names, values):
    rows |= dict(zip(names, np.asarray(values).T, strict=True))


def times(count):
    return np.arange(count) / RATE_HZ


def webxr_log(path: Path, hand, angles, noise_m: float = 0.0) -> Path:
    """The device's palm frame is the wrist's: -z to the fingers, y out of the back, off the hand's by a little."""
    count = len(angles)
    position, rotation = made_palm(count)
    device_from_palm = Rotation.from_matrix(np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]))
    world_from_device = rotation * device_from_palm.inv()
    points = to_world(joints_in_palm(hand, angles), (position, rotation))
    points += np.random.default_rng(0).normal(0, noise_m, points.shape)
    rows = {"t_s": times(count)}
    for joint in webxr.JOINTS:
        _put(rows, webxr.ROTATION[joint], np.tile([1.0, 0, 0, 0], (count, 1)))
    _put(rows, webxr.POSITION["wrist"], position + rotation.apply([0.002, 0.001, -0.003]))
    _put(rows, webxr.ROTATION["wrist"], np.roll(world_from_device.as_quat(), 1, axis=1))
    for f, chain in enumerate(webxr.CHAINS):
        for k, joint in enumerate(chain):
            _put(rows, webxr.POSITION[joint], points[:, f, k])
    return write_log(path, webxr.COLUMNS, rows)


def leap_log(path: Path, hand, angles, confidence=None, noise_m: float = 0.0) -> Path:
    count = len(angles)
    position, rotation = made_palm(count)
    points = to_world(joints_in_palm(hand, angles), (position, rotation))
    points += np.random.default_rng(0).normal(0, noise_m, points.shape)
    rows = {
        "t_s": times(count),
        "hand_id": np.full(count, 7.0),
        "is_right": np.full(count, float(hand.about["side"] == "right")),
        "confidence": np.ones(count) if confidence is None else confidence,
    }
    _put(rows, leap.PALM, position + rotation.apply([0.0, 0.06, 0.0]))
    _put(rows, leap.NORMAL, rotation.apply([0.0, 0.0, -1.0]))
    _put(rows, leap.DIRECTION, rotation.apply([0.0, 1.0, 0.0]))
    for f in range(5):
        for k in range(4):
            _put(rows, leap.POINTS[f][k], points[:, f, k])
    return write_log(path, leap.COLUMNS, rows)


def optical_log(path: Path, hand, angles, missing=()) -> Path:
    """missing: (finger, marker, first frame, end) that were not seen."""
    count = len(angles)
    palm = made_palm(count)
    back = np.array([[0.0, 0.085, 0.02], [-0.025, 0.045, 0.02], [0.02, 0.045, 0.02]])
    markers = to_world(markers_in_palm(hand, angles, usual_places(hand)), palm)
    for f, m, start, end in missing:
        markers[start:end, f, m] = np.nan
    rows = {"t_s": times(count)}
    for names, place in zip(optical_glove.BACK, back, strict=True):
        _put(rows, names, to_world(np.tile(place, (count, 1))[:, None], palm)[:, 0])
    for f in range(len(FINGERS)):
        for m in range(2):
            _put(rows, optical_glove.POINTS[f][m], markers[:, f, m])
    return write_log(path, optical_glove.COLUMNS, rows)
