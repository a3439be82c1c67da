"""What a device that reads angles says in an open hand and in a fist, and angles of a user's hand from it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.coupling import complete_flexion
from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS, JOINTS, Array, HandModel
from palmar.profile import FingerMeasures, Profile
from palmar.records import Trace

OUTLIERS = (2.0, 98.0)  # percentiles taken for the open hand and the fist: a spike of a sensor is no range
UNREAD_RAD = 0.1  # a reading that changes by less between open hand and fist is of no joint
ENOUGH = 10


def calibrate_readings(trace: Trace, name: str) -> tuple[Profile, dict[str, Any]]:
    """The range of every joint's reading over a recording that shows an open hand, a fist and a pinch.

    Raises BadTrace E-TRACE-EMPTY if few samples are tracked or no joint moves.
    """
    flexion = np.nan_to_num(trace.flexion_rad[trace.tracked])  # a joint without a column stands still
    source = trace.header.get("source", "a trace")
    if len(flexion) < ENOUGH:
        raise BadTrace("E-TRACE-EMPTY", source, f"{len(flexion)} tracked samples; {ENOUGH} are needed")
    reading = np.moveaxis(np.percentile(flexion, OUTLIERS, axis=0), 0, -1)  # (5, 3, 2)
    still = is_still(reading)
    for f, finger in enumerate(FINGERS):
        if still[f].all():
            found = f"no joint of the {finger} moves by {UNREAD_RAD:g} rad"
            raise BadTrace("E-TRACE-EMPTY", source, f"{found}; record an open hand, a fist and a pinch")
    profile = Profile(
        name=name,
        side=trace.header["side"],
        source=f"{source}, sha256 {trace.header.get('source_sha256', 'not stored')}",
        fingers=tuple(FingerMeasures(reading_rad=reading[f]) for f in range(5)),
        device=trace.header["device"],
    )
    unread = [f"{FINGERS[f]} {JOINTS[k]}" for f, k in np.argwhere(still)]
    degrees = {finger: np.degrees(reading[f]).round(1).tolist() for f, finger in enumerate(FINGERS)}
    return profile, {"samples": len(flexion), "joints not read": unread, "readings_deg": degrees}


def apply_readings(trace: Trace, hand: HandModel, profile: Profile) -> Trace:
    """The trace as angles of the user's hand, see `angles_of`.

    Raises PalmarError E-CONF if the profile has no readings of this device.
    """
    require_readings(profile, trace.header["device"], trace.header["side"])
    sentences = json.loads(trace.header.get("assumptions", "[]"))
    sentences.append(
        f"Readings are scaled by profile {profile.name}: its open hand is straight, its fist at the end of each "
        "joint's range; joints that are not read follow the hand's coupling."
    )
    header = {
        **trace.header,
        "hand": hand.about["name"],
        "profile_sha256": profile.sha256,
        "assumptions": json.dumps(sentences),
    }
    return replace(trace, header=header, flexion_rad=angles_of(trace.flexion_rad, hand, profile))


def require_readings(profile: Profile, device: str, side: str) -> None:
    """Raise PalmarError E-CONF unless the profile has readings of this device and is of a hand of this side."""
    given = [measures.reading_rad for measures in profile.fingers]
    if profile.device != device or any(reading is None for reading in given):
        has = f"readings of {profile.device}" if profile.device and given[0] is not None else "no readings"
        raise PalmarError("E-CONF", "--profile", f"{profile.name} has {has}; {device} is what the log is of")
    if profile.side != side:
        found = f"{profile.name} is of a {profile.side} hand, the log of a {side} one"
        raise PalmarError("E-CONF", "--profile", found)


def angles_of(flexion_rad: Array, hand: HandModel, profile: Profile) -> Array:
    """Readings (n, 5, 3) as angles: open hand to zero, fist to the end of each joint's range, linear between.

    Joints that the device does not read, or that are NaN, follow the hand's coupling. The profile has to have readings.
    """
    reading = np.stack([r for r in (measures.reading_rad for measures in profile.fingers) if r is not None])
    low, high = hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        closed = (flexion_rad - reading[..., 0]) / (reading[..., 1] - reading[..., 0])
    return complete_flexion(hand, np.where(is_still(reading), np.nan, np.clip(closed * high, low, high)))


def is_still(reading: Array) -> NDArray[np.bool_]:
    return np.abs(reading[..., 1] - reading[..., 0]) < UNREAD_RAD
