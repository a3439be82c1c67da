"""A recording of positions -> angles of a hand, frame by frame, and how far the hand's points are from those seen."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from palmar.errors import PalmarError
from palmar.model import FINGERS, HandModel
from palmar.profile import Profile
from palmar.records import Trace
from palmar.traces.inverse import FOLLOW_M_PER_RAD, fit_finger
from palmar.traces.kinematics import Array, conjugate, finger_points, joint_points, multiply, rotate
from palmar.traces.palm_frame import Pose, in_frame, palm_from_knuckles
from palmar.traces.recording import Recording

BRIDGE_S = 0.25  # a marker that is away for longer is not bridged: its finger follows the other marker and the coupling
BRIDGED_WEIGHT = 0.1  # of what was seen
LEAST_WEIGHT = 0.01  # of a frame that the device does not trust at all: it still says more than nothing
COUPLE_M_PER_RAD = 0.02  # with markers: DIP is off its coupling by a radian for 2 cm of miss


def solve_recording(recording: Recording, hand: HandModel, profile: Profile | None) -> Trace:
    """The recording as a trace of this hand, with what was assumed, missing and left over in the header.

    hand: already fitted to the profile if there is one. Where the palm and the markers are comes from the profile if it
    was made with this device; else the palm is laid onto the recorded knuckles. Raises PalmarError E-CONF if neither
    is known or the hand is of the other side.
    """
    if hand.about["side"] != recording.side:
        found = f"a {hand.about['side']} hand, but the recording is of a {recording.side} one"
        raise PalmarError("E-CONF", "--hand", f"{found}; give a profile of it: palmar calibrate {recording.source}")
    pose, places, how = _setup(recording, hand, profile)
    flexion, abduction, miss_m = solve_angles(recording, hand, pose, places)
    # Palm in the world = device's frame in the world, after the device's frame in the palm.
    back = conjugate(pose[1])
    rotation = multiply(recording.palm_rotation_wxyz, back)
    position = recording.palm_position_m - rotate(rotation, pose[0])
    count = len(recording.time_s)
    header = {
        "device": recording.device,
        "hand": hand.about["name"],
        "side": recording.side,
        "source": recording.source,
        "source_sha256": recording.sha256,
        "assumptions": json.dumps([*recording.assumptions, *how]),
        "changed": json.dumps(count_missing(recording)),
        "residual_mm": json.dumps(tell_residuals(recording, hand, pose, miss_m)),
    }
    if profile is not None:
        header["profile_sha256"] = profile.sha256
    if count > 1:
        header["rate_hz"] = f"{1.0 / float(np.median(np.diff(recording.time_s))):.6g}"
    return Trace(
        header=header,
        time_s=recording.time_s,
        palm_position_m=position,
        palm_rotation_wxyz=rotation,
        flexion_rad=flexion,
        abduction_rad=abduction,
        tracked=recording.palm_seen,
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )


def _setup(recording: Recording, hand: HandModel, profile: Profile | None) -> tuple[Pose, Array, list[str]]:
    """Palm from the device's palm frame, places of the points on the hand, and sentences on where these are from."""
    known = profile is not None and profile.device == recording.device and profile.palm_from_device is not None
    places = np.stack([joint_points(hand, f) for f in range(5)])
    if recording.markers:
        given = [m.marker_m for m in profile.fingers if m.marker_m is not None] if known and profile else []
        if len(given) != 5:
            needed = f"the profile of the glove that was worn is needed: palmar calibrate {recording.source}"
            raise PalmarError("E-CONF", "--profile", f"markers sit anywhere on a glove; {needed}")
        places = np.stack(given)
    if known and profile and profile.palm_from_device:
        return profile.palm_from_device, places, [f"Lengths, axes and the palm's place are of profile {profile.name}."]
    how = "The palm is laid onto the recorded knuckles."
    if profile is None:
        how += f" Lengths and axes are those of hand {hand.about['name']}, not of the person recorded."
    return palm_from_knuckles(recording, hand), places, [how]


def solve_angles(recording: Recording, hand: HandModel, pose: Pose, places_m: Array) -> tuple[Array, Array, Array]:
    """Flexion (n, 5, 3), abduction (n, 5), and the miss of every point (n, 5, m), metres, NaN where it was not seen.

    pose: palm from the device's palm frame. places_m: (5, m, 3), the points on the hand at the zero pose.
    """
    seen = in_frame(recording.points_m, pose)
    wanted, weight = bridge(recording.time_s, seen)
    weight = weight * np.maximum(recording.weight, LEAST_WEIGHT)[:, None, None]
    angles, miss = [], []
    for f in range(5):
        found = fit_finger(
            hand,
            f,
            wanted[:, f],
            keep_m_per_rad=FOLLOW_M_PER_RAD,
            points_m=places_m[f],
            phalanx=recording.phalanx[f],
            weight=weight[:, f],
            couple_m_per_rad=COUPLE_M_PER_RAD if recording.markers else 0.0,
        )
        angles.append(found)
        at = finger_points(hand, f, found, places_m[f], recording.phalanx[f])
        miss.append(np.linalg.norm(at - seen[:, f], axis=2))
    stacked = np.stack(angles, axis=1)
    return stacked[:, :, 1:], stacked[:, :, 0], np.stack(miss, axis=1)


def bridge(time_s: Array, points_m: Array) -> tuple[Array, Array]:
    """Points with short gaps filled between their neighbours (pchip), and weights: 1 seen, less bridged, 0 away."""
    points = points_m.copy()
    weight = np.isfinite(points).all(axis=3).astype(np.float64)
    for f, m in np.argwhere(weight.min(axis=0) < 1):
        there = np.flatnonzero(weight[:, f, m])
        if len(there) < 2:
            continue
        away = np.flatnonzero(weight[:, f, m] == 0)
        after = np.searchsorted(there, away)
        inner = (after > 0) & (after < len(there))
        away, after = away[inner], after[inner]
        short = time_s[there[after]] - time_s[there[after - 1]] <= BRIDGE_S
        path = PchipInterpolator(time_s[there], points[there, f, m])
        points[away[short], f, m] = path(time_s[away[short]])
        weight[away[short], f, m] = BRIDGED_WEIGHT
    return points, weight


def count_missing(recording: Recording) -> dict[str, float]:
    """What was not seen and what was done about it."""
    _, weight = bridge(recording.time_s, recording.points_m)
    counts = {
        "points not seen": int((weight < 1).sum()),
        "of these bridged": int(((weight > 0) & (weight < 1)).sum()),
        "frames without the palm": int((~recording.palm_seen).sum()),
    }
    return {what: count for what, count in counts.items() if count}


def tell_residuals(recording: Recording, hand: HandModel, pose: Pose, miss_m: Array) -> dict[str, Any]:
    """Miss in mm of every point and of the fingertips together: p50, p99, max.

    The first joints, where they are seen, say how rigid the palm was: nothing is solved for them.
    """
    fingers: dict[str, Any] = {finger: {} for finger in FINGERS}
    for f, stats in enumerate(fingers.values()):
        if recording.knuckle_m is not None:
            off = in_frame(recording.knuckle_m[:, f], pose) - hand.joint_m[f, 0]
            stats["joint 1"] = _stats(np.linalg.norm(off, axis=1))
        for m, name in enumerate(recording.point_names):
            stats[name] = _stats(miss_m[:, f, m])
    return {**fingers, "fingertips": _stats(miss_m[:, :, -1])}


def _stats(miss_m: Array) -> dict[str, float]:
    seen = miss_m[np.isfinite(miss_m)] * 1e3
    if not seen.size:
        return {}
    p50, p99 = np.percentile(seen, [50, 99])
    return {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "max": round(float(seen.max()), 3)}
