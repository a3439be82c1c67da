"""A recording of positions -> the profile of the hand that was recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace
from palmar.model import FINGERS, HandModel
from palmar.profile import (
    FingerMeasures,
    Profile,
    bone_vectors,
    fit_to_profile,
    hand_breadth,
    hand_length,
    mirror_hand,
    palm_axes,
)
from palmar.traces.finger_shape import JOINTS_SEEN, MARKERS_SEEN, fit_shape
from palmar.traces.inverse import angle_limits
from palmar.traces.kinematics import Array, joint_points
from palmar.traces.palm_frame import (
    ENOUGH,
    Pose,
    in_frame,
    one_after,
    palm_from_knuckles,
    rigid_between,
    to_frame,
    trusted_frames,
)
from palmar.traces.recording import Recording
from palmar.traces.solve import count_missing, solve_angles, tell_residuals

FRAMES = 40  # of the whole recording, as different from each other as can be, for the shape
WIDER_RAD = np.radians(30.0)  # beyond the hand's ranges, for a user who bends farther than most
MARGIN_RAD = np.radians(10.0)  # beyond the angles shown: some seconds do not show the ends of every range
MARKER_HEIGHT_M = 0.005  # of a marker's middle over the skin it sits on
MIDDLE_MARKER = 0.7  # of the first phalanx, from the knuckle
USUAL_FLEXION_RAD = 0.35  # of the knuckles, half way between a flat hand and a loose one


def calibrate_recording(recording: Recording, hand: HandModel, name: str) -> tuple[Profile, dict[str, Any]]:
    """The profile of the recorded hand, and what is left: residuals in mm of every joint or marker and of fingertips.

    hand: where shapes start from; it is mirrored if it is of the other side. Lengths are medians over trusted frames,
    their spread 1.4826 x the median deviation; knuckles, axes and marker places are fitted (`fit_shape`). With markers
    nothing sees a joint: lengths are then the hand's, scaled and bent to fit, and no spread is known.
    Raises BadTrace E-TRACE-EMPTY if too few frames show the hand.
    """
    if hand.about["side"] != recording.side:
        hand = mirror_hand(hand)
    trusted = trusted_frames(recording)
    wide = _widen(hand)
    if recording.markers:
        wide, places, pose, measured = _from_markers(recording, trusted, wide)
    else:
        wide, places, pose, measured = _from_joints(recording, trusted, wide)
    flexion, abduction, miss_m = solve_angles(recording, wide, pose, places)
    for f in range(5):
        angles = np.column_stack([abduction[:, f], flexion[:, f]])[trusted]
        # 1 %: a frame seen wrongly must not make a range.
        shown = np.percentile(angles, [1, 99], axis=0).T + np.array([-MARGIN_RAD, MARGIN_RAD])
        low, high = angle_limits(hand, f)
        limit = np.column_stack([np.minimum(low, shown[:, 0]), np.maximum(high, shown[:, 1])])
        measured[f] = replace(measured[f], abduction_limit_rad=limit[0], flexion_limit_rad=limit[1:])
    lengths = np.stack([np.linalg.norm(bone_vectors(wide, f), axis=1) for f in range(5)])
    profile = replace(
        _size(hand, lengths, wide.joint_m[:, 0]),
        name=name,
        source=f"{recording.source}, sha256 {recording.sha256}",
        fingers=tuple(measured),
        device=recording.device,
        palm_from_device=pose,
    )
    fit_to_profile(hand, profile)  # refuses what is no hand
    counts = {"frames": len(recording.time_s), "trusted": int(trusted.sum())}
    return profile, {**counts, **count_missing(recording), "residual_mm": tell_residuals(recording, wide, pose, miss_m)}


def _widen(hand: HandModel) -> HandModel:
    by = np.array([-WIDER_RAD, WIDER_RAD])
    return replace(
        hand, flexion_limit_rad=hand.flexion_limit_rad + by, abduction_limit_rad=hand.abduction_limit_rad + by
    )


def _from_joints(
    recording: Recording, trusted: Array, hand: HandModel
) -> tuple[HandModel, Array, Pose, list[FingerMeasures]]:
    """Shape of a hand whose joints were seen, the points' places (5, 3, 3), palm from device, and what was measured."""
    assert recording.knuckle_m is not None
    knuckle, points = recording.knuckle_m[trusted], recording.points_m[trusted]
    length = np.linalg.norm(np.diff(np.concatenate([knuckle[:, :, None], points], axis=2), axis=2), axis=3)
    middle = np.median(length, axis=0)
    spread = 1.4826 * np.median(np.abs(length - middle), axis=0)
    hand = fit_to_profile(hand, _size(hand, middle, np.median(knuckle, axis=0)))
    pose = palm_from_knuckles(recording, hand)
    knuckle, points = in_frame(knuckle, pose), in_frame(points, pose)
    frames, place = spread_frames(points), np.median(knuckle, axis=0)
    seen = tuple(FingerMeasures(length_m=middle[f], joint_m=place[f]) for f in range(5))
    hand = fit_to_profile(hand, Profile("start", hand.about["side"], "", fingers=seen))
    places = np.empty((5, 3, 3))
    for f in range(5):
        hand, places[f] = fit_shape(
            hand,
            f,
            points[frames, f],
            firm=JOINTS_SEEN,
            points_m=joint_points(hand, f),
            phalanx=recording.phalanx[f],
            weight=recording.weight[trusted][frames],
        )
    return hand, places, pose, [replace(_measures(hand, f), length_spread_m=spread[f]) for f in range(5)]


def _from_markers(
    recording: Recording, trusted: Array, hand: HandModel
) -> tuple[HandModel, Array, Pose, list[FingerMeasures]]:
    """Shape of a hand that wore markers. Where the palm is comes from where the fitted knuckles are: twice."""
    points = recording.points_m[trusted]
    for f, m in np.argwhere(np.isfinite(points).all(axis=3).sum(axis=0) < ENOUGH):
        found = f"the {FINGERS[f]}'s {recording.point_names[m]} is seen in fewer than {ENOUGH} frames"
        raise BadTrace("E-TRACE-EMPTY", recording.source, f"{found}; every marker has to be seen")
    rotation = palm_axes(hand) @ recording.palm_axes.T
    first = usual_places(hand)
    fingers = slice(1, 5)
    bent = first[fingers, 0] + _usual_bend(hand)[fingers]
    seen = np.nanmedian(points[:, fingers, 0], axis=0) @ rotation.T
    pose = to_frame(rotation, bent.mean(axis=0) - seen.mean(axis=0))
    start = hand
    for last in (False, True):
        hand, places, frames = start, first.copy(), spread_frames(in_frame(points, pose))
        for f in range(5):
            hand, places[f] = fit_shape(
                hand,
                f,
                in_frame(points, pose)[frames, f],
                firm=MARKERS_SEEN,
                points_m=first[f],
                phalanx=recording.phalanx[f],
                weight=recording.weight[trusted][frames],
            )
        if not last:
            pose = one_after(rigid_between(hand.joint_m[:, 0], start.joint_m[:, 0]), pose)
    return hand, places, pose, [replace(_measures(hand, f), marker_m=places[f]) for f in range(5)]


def spread_frames(points_m: Array) -> Array:
    """Frames as different as can be: each next one is farthest from all taken so far. Sorted indices."""
    flat = np.nan_to_num(points_m.reshape(len(points_m), -1))
    taken = [0]
    apart = ((flat - flat[0]) ** 2).sum(axis=1)
    while len(taken) < min(FRAMES, len(flat)):
        taken.append(int(apart.argmax()))
        apart = np.minimum(apart, ((flat - flat[taken[-1]]) ** 2).sum(axis=1))
    return np.unique(taken)


def usual_places(hand: HandModel) -> Array:
    """Where a glove's middle and tip marker sit at the zero pose: on the back of first and last phalanx, (5, 2, 3)."""
    places = np.empty((5, 2, 3))
    for f in range(5):
        bones = bone_vectors(hand, f)
        along = bones[0] / np.linalg.norm(bones[0])
        back = np.cross(along, hand.flexion_axis[f, 0])
        radius = hand.phalanx_radius_m[f, [0, 2], 1] + MARKER_HEIGHT_M
        places[f, 0] = hand.joint_m[f, 0] + MIDDLE_MARKER * bones[0] + radius[0] * back
        places[f, 1] = hand.joint_m[f, 2] + 0.5 * bones[2] + radius[1] * back
    return places


def _usual_bend(hand: HandModel) -> Array:
    """How far the middle markers are from the zero pose at the usual flexion, (5, 3)."""
    lever = usual_places(hand)[:, 0] - hand.joint_m[:, 0]
    turn = Rotation.from_rotvec(USUAL_FLEXION_RAD * hand.flexion_axis[:, 0])
    return turn.apply(lever) - lever


def _measures(hand: HandModel, finger: int) -> FingerMeasures:
    return FingerMeasures(
        length_m=np.linalg.norm(bone_vectors(hand, finger), axis=1),
        joint_m=hand.joint_m[finger, 0],
        flexion_axis=hand.flexion_axis[finger],
        abduction_axis=hand.abduction_axis[finger],
    )


def _size(hand: HandModel, length_m: Array, knuckle_m: Array) -> Profile:
    """Length and breadth of a hand of these segments (5, 3) and first joints (5, 3): the hand's, scaled as they are."""
    own = sum(np.linalg.norm(bone_vectors(hand, f), axis=1).sum() for f in range(5))
    span, own_span = (np.linalg.norm(joint[1] - joint[4]) for joint in (knuckle_m, hand.joint_m[:, 0]))
    return Profile(
        name="recorded",
        side=hand.about["side"],
        source="",
        hand_length_m=float(hand_length(hand) * length_m.sum() / own),
        hand_breadth_m=float(hand_breadth(hand) * span / own_span),
    )
