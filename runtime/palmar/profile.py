"""A user's profile: what was measured of one person's hand and of the device it wore, and a hand made to fit it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from palmar.errors import BadPack
from palmar.model import FINGERS, JOINTS, Array, HandModel

PROFILE_SCHEMA = "palmar.profile/1"
SMALLEST, LARGEST = 0.5, 2.0  # of a length over the hand's own: farther off it is in another unit


@dataclass(frozen=True)
class FingerMeasures:
    """One finger; None is what was not measured. Places and axes are in the palm frame at the zero pose."""

    length_m: Array | None = None  # (3,) from joint to joint, and from the last joint to the end of the axis
    length_spread_m: Array | None = None  # (3,) how far single frames were from it, one standard deviation
    width_m: Array | None = None  # (4,) across the three joints and the tip
    joint_m: Array | None = None  # (3,) the first joint
    flexion_axis: Array | None = None  # (3, 3)
    abduction_axis: Array | None = None  # (3,)
    flexion_limit_rad: Array | None = None  # (3, 2)
    abduction_limit_rad: Array | None = None  # (2,)
    reading_rad: Array | None = None  # (3, 2) what the device said of each joint in an open hand and in a fist
    marker_m: Array | None = None  # (m, 3) places of the device's markers


@dataclass(frozen=True)
class Profile:
    """What was measured of a person. Format: docs/calibration.md."""

    name: str
    side: str
    source: str
    hand: str = ""  # name of the hand that it was made with
    hand_length_m: float | None = None  # wrist to the middle fingertip
    hand_breadth_m: float | None = None  # across the palm
    fingers: tuple[FingerMeasures, ...] = (FingerMeasures(),) * 5
    device: str = ""  # that reading_rad, marker_m and palm_from_device are of
    palm_from_device: tuple[Array, Array] | None = None  # (3,) metres and (4,) w x y z of the device's palm frame
    sha256: str = ""


def fit_to_profile(hand: HandModel, profile: Profile) -> HandModel:
    """The hand with the profile's measures; what was not measured is scaled with the hand's length and breadth.

    Lengths of the palm scale so that wrist, palm, middle finger and its tip make up the hand's length; breadth,
    thickness and radii scale with the breadth; the palm follows knuckles whose place was measured. A hand of the other
    side is mirrored first. Raises BadPack E-CONF if a measure does not fit a hand.
    """
    if profile.side != hand.about["side"]:
        hand = mirror_hand(hand)
    where = f"profile {profile.name}"
    breadth = _ratio(where, "hand_breadth_m", profile.hand_breadth_m, hand_breadth(hand))
    given = [_grown(f"{where}, {FINGERS[f]}", hand, f, measures) for f, measures in enumerate(profile.fingers)]
    scale = _palm_scale(where, hand, profile, breadth)
    joint, phalanx = np.empty_like(hand.joint_m), np.empty_like(hand.phalanx_m)
    radius = np.empty_like(hand.phalanx_radius_m)
    for f, measures in enumerate(profile.fingers):
        part = f"{where}, {FINGERS[f]}"
        width = measures.width_m
        radius[f] = hand.phalanx_radius_m[f] * breadth if width is None else np.stack([width[:3], width[1:]], 1) / 2
        start = scale @ hand.joint_m[f, 0] if measures.joint_m is None else measures.joint_m
        own = bone_vectors(hand, f)
        grown = given[f]
        grow = np.full(3, _along(hand, scale)) if grown is None else grown
        for k in range(3):
            joint[f, k] = start
            phalanx[f, k] = start + grow[k] * (hand.phalanx_m[f, k] - hand.joint_m[f, k])
            start = start + grow[k] * own[k]
            length = np.linalg.norm(phalanx[f, k, 1] - phalanx[f, k, 0])
            if not length > abs(radius[f, k, 0] - radius[f, k, 1]):
                text = f"{length:.4g} m between radii {radius[f, k, 0]:.4g} and {radius[f, k, 1]:.4g} m"
                raise BadPack("E-CONF", part, f"{JOINTS[k]} phalanx of {text}; it must be longer than they differ")
    return HandModel(
        palm_spheres_m=_palm(hand, scale, breadth, joint[:, 0]),
        joint_m=joint,
        flexion_axis=_own_or_hands(profile, hand, "flexion_axis"),
        abduction_axis=_own_or_hands(profile, hand, "abduction_axis"),
        phalanx_m=phalanx,
        phalanx_radius_m=radius,
        flexion_limit_rad=_own_or_hands(profile, hand, "flexion_limit_rad"),
        abduction_limit_rad=_own_or_hands(profile, hand, "abduction_limit_rad"),
        joint_stiffness_n_m_per_rad=hand.joint_stiffness_n_m_per_rad,
        palm_stiffness_n_per_m=hand.palm_stiffness_n_per_m,
        palm_rotation_stiffness_n_m_per_rad=hand.palm_rotation_stiffness_n_m_per_rad,
        flexion_coupling=hand.flexion_coupling,
        about={
            "name": profile.name,
            "side": profile.side,
            "source": f"{hand.about.get('name', 'hand')}, fitted to profile {profile.name}: {profile.source}",
            "sha256": hashlib.sha256(f"{hand.about.get('sha256', '')} {profile.sha256}".encode()).hexdigest(),
            "profile_sha256": profile.sha256,
        },
    )


def other_hand_warning(hand: HandModel, profile: Profile) -> str:
    """What to say if a profile is applied to another hand than it was made with; "" if it is the same or unknown.

    hand: before the profile is applied to it.
    """
    name = str(hand.about.get("name", ""))
    if not profile.hand or name == profile.hand:
        return ""
    return f"profile {profile.name} was made with hand {profile.hand!r}, not {name!r}; its ranges are of that --hand"


def bone_vectors(hand: HandModel, finger: int) -> Array:
    """From joint to joint, and from the last joint to the end of the axis, (3, 3) metres."""
    return np.diff(np.vstack([hand.joint_m[finger], hand.phalanx_m[finger, 2, 1]]), axis=0)


def palm_axes(hand: HandModel) -> Array:
    """Columns palmar, distal and radial, in the palm frame (3, 3), whatever the hand's own axes are.

    Distal is where the middle finger points; palmar is where its tip moves when it flexes; radial is across both.
    """
    distal = hand.phalanx_m[2, 0, 1] - hand.phalanx_m[2, 0, 0]
    distal = distal / np.linalg.norm(distal)
    palmar = np.cross(hand.flexion_axis[2, 0], distal)
    palmar = palmar / np.linalg.norm(palmar)
    return np.column_stack([palmar, distal, np.cross(palmar, distal)])


def hand_length(hand: HandModel) -> float:
    """From the wrist, the palm frame's origin, to the middle fingertip, metres."""
    tip = hand.phalanx_m[2, 2, 1] + hand.phalanx_radius_m[2, 2, 1] * palm_axes(hand)[:, 1]
    return float(tip @ palm_axes(hand)[:, 1])


def hand_breadth(hand: HandModel) -> float:
    """Across the palm's spheres, metres."""
    across = hand.palm_spheres_m[:, :3] @ palm_axes(hand)[:, 2]
    return float((across + hand.palm_spheres_m[:, 3]).max() - (across - hand.palm_spheres_m[:, 3]).min())


def mirror_hand(hand: HandModel) -> HandModel:
    """The hand of the other side, mirrored across the palm."""
    across = palm_axes(hand)[:, 2]
    mirror = np.eye(3) - 2 * np.outer(across, across)
    # A mirrored turn about a mirrored axis goes the other way round, so the axis is turned over.
    return replace(
        hand,
        palm_spheres_m=np.column_stack([hand.palm_spheres_m[:, :3] @ mirror, hand.palm_spheres_m[:, 3]]),
        joint_m=hand.joint_m @ mirror,
        phalanx_m=hand.phalanx_m @ mirror,
        flexion_axis=-hand.flexion_axis @ mirror,
        abduction_axis=-hand.abduction_axis @ mirror,
        about={**hand.about, "side": "left" if hand.about["side"] == "right" else "right"},
    )


def _palm_scale(where: str, hand: HandModel, profile: Profile, breadth: float) -> Array:
    """Matrix (3, 3) that scales the palm: along the fingers so that the hand gets its length, across by the breadth."""
    axes = palm_axes(hand)
    middle = profile.fingers[2]
    own = np.linalg.norm(bone_vectors(hand, 2), axis=1)
    tip = hand.phalanx_radius_m[2, 2, 1] * breadth if middle.width_m is None else middle.width_m[3] / 2
    palm = float(hand.joint_m[2, 0] @ axes[:, 1])
    if profile.hand_length_m is None:
        along = breadth if middle.length_m is None else float(middle.length_m.sum() / own.sum())
    elif middle.length_m is None:
        along = (profile.hand_length_m - tip) / (palm + own.sum())
    else:
        along = (profile.hand_length_m - tip - middle.length_m.sum()) / palm
    if not SMALLEST <= along <= LARGEST:
        found = f"leaves {along * palm * 1e3:.4g} mm of palm, the hand has {palm * 1e3:.4g} mm"
        raise BadPack("E-CONF", f"{where}, hand_length_m", f"{found}; {SMALLEST:g} to {LARGEST:g} of it is allowed")
    return axes @ np.diag([breadth, along, breadth]) @ axes.T


def _palm(hand: HandModel, scale: Array, breadth: float, knuckle_m: Array) -> Array:
    """The palm's spheres, scaled, and carried along with the knuckles: fully between these, not at all at the wrist."""
    centre = hand.palm_spheres_m[:, :3] @ scale.T
    before = hand.joint_m[1:, 0] @ scale.T
    axes = palm_axes(hand)
    across, order = centre @ axes[:, 2], np.argsort(before @ axes[:, 2])
    between = [np.interp(across, (before @ axes[:, 2])[order], column[order]) for column in (knuckle_m[1:] - before).T]
    reach = np.interp(across, (before @ axes[:, 2])[order], (before @ axes[:, 1])[order])
    share = np.clip(centre @ axes[:, 1] / reach, 0.0, 1.0)
    return np.column_stack([centre + share[:, None] * np.stack(between, axis=1), hand.palm_spheres_m[:, 3] * breadth])


def _along(hand: HandModel, scale: Array) -> float:
    """What the scale does to a length along the fingers."""
    distal = palm_axes(hand)[:, 1]
    return float(distal @ scale @ distal)


def _grown(where: str, hand: HandModel, finger: int, measures: FingerMeasures) -> Array | None:
    """Measured lengths over the hand's own, (3,)."""
    if measures.length_m is None:
        return None
    own = np.linalg.norm(bone_vectors(hand, finger), axis=1)
    return np.array([_ratio(where, "length_m", *pair) for pair in zip(measures.length_m, own, strict=True)])


def _ratio(where: str, name: str, value: float | None, own: float) -> float:
    if value is None:
        return 1.0
    if not SMALLEST * own <= value <= LARGEST * own:
        found = f"{value:.4g} m, the hand it is applied to has {own:.4g} m"
        raise BadPack("E-CONF", f"{where}, {name}", f"{found}; {SMALLEST:g} to {LARGEST:g} of that is allowed: metres?")
    return float(value / own)


def _own_or_hands(profile: Profile, hand: HandModel, name: str) -> Array:
    """One number of every finger, the profile's where it was measured and else the hand's."""
    own = [getattr(measures, name) for measures in profile.fingers]
    return np.stack([getattr(hand, name)[f] if value is None else value for f, value in enumerate(own)])
