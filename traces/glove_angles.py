"""Readings of a glove, shares of its full scale, as angles of a hand, and back; and the readings in a recording."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from palmar._runtime import read_device_bytes
from palmar.coupling import complete_flexion
from palmar.errors import BadTrace
from palmar.model import Array, HandModel
from palmar.profile import Profile
from palmar.records import Trace, read_trace
from palmar.traces.line_buffer import LineBuffer
from palmar.traces.opengloves import LONGEST_LINE, Decoder, Reading, Rejected
from palmar.traces.readings import angles_of

DEVICE = "opengloves"
# What the full scale counts as where a reading has to be an angle: in profiles.
FULL_SCALE_RAD = math.pi / 2
STAGGER_S = 1e-6  # between samples of lines that came together: times of samples have to rise


def angles_from_readings(readings: list[Reading], hand: HandModel, profile: Profile | None) -> tuple[Array, Array]:
    """Flexion (n, 5, 3) and abduction (n, 5), rad.

    With a profile its readings are the ends of each joint; without one 0 is straight and 1 the end of the joint's
    range. Joints that the glove does not send follow the hand's coupling, abductions that it does not send are 0.
    Raises BadTrace E-TRACE-VALUE if a finger has no joint that is read.
    """
    flexion = np.array([reading.flexion for reading in readings]).reshape(-1, 5, 3)
    abduction = np.array([reading.abduction for reading in readings])
    if profile is not None:
        flexion = angles_of(flexion * FULL_SCALE_RAD, hand, profile)
    else:
        flexion = complete_flexion(hand, flexion * hand.flexion_limit_rad[..., 1])
    low, high = hand.abduction_limit_rad.T
    spread = np.where(np.isnan(abduction), 0.0, abduction)
    return flexion, np.clip(np.where(spread < 0, -spread * low, spread * high), low, high)


def readings_from_angles(flexion_rad: Array, abduction_rad: Array, hand: HandModel) -> tuple[Array, Array]:
    """The other way, without a profile: shares (n, 5, 3) of 0 to 1 and (n, 5) of -1 to 1; what lies outside is cut."""
    high = hand.flexion_limit_rad[..., 1]
    flexion = np.clip(flexion_rad / np.where(high > 0, high, 1.0), 0.0, 1.0)
    low, high = hand.abduction_limit_rad.T
    end = np.where(abduction_rad < 0, -low, high)
    return flexion, np.clip(abduction_rad / np.where(end > 0, end, 1.0), -1.0, 1.0)


def read_opengloves(path: str | Path) -> Trace:
    """The readings of a recording of `palmar record`, decoded anew from its bytes, as a trace to calibrate.

    Angles are what the glove said, its full scale counting as 90 degrees; joints that it does not send are 0
    throughout. Times and palm poses are those of the recording. Raises BadTrace.
    """
    path = Path(path)
    recorded = read_trace(path)
    header, chunks = read_device_bytes(str(path))
    if header["device"] != DEVICE or not chunks:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"no raw bytes of {DEVICE}; a file of `palmar record` is needed")
    decoder, lines = Decoder(int(header["full_scale"])), LineBuffer(LONGEST_LINE)
    times: list[float] = []
    readings: list[Reading] = []
    for time_s, content in chunks:
        for line in lines.feed(content):
            try:
                reading = decoder.decode(line) if line else None
            except Rejected:
                continue
            if reading is not None:
                times.append(time_s if not times else max(time_s, times[-1] + STAGGER_S))
                readings.append(reading)
    if not readings:
        raise BadTrace("E-TRACE-EMPTY", str(path), "no line of its raw bytes reads")
    time = np.array(times)
    near = np.clip(np.searchsorted(recorded.time_s, time - STAGGER_S / 2), 0, len(recorded.time_s) - 1)
    flexion = np.nan_to_num([reading.flexion for reading in readings]).reshape(-1, 5, 3) * FULL_SCALE_RAD
    header = dict(header)
    header["assumptions"] = json.dumps(
        ["Decoded anew from the raw bytes of a recording; the glove's full scale counts as 90 degrees."]
    )
    return replace(
        recorded,
        header=header | {"source": path.name},
        time_s=time,
        palm_position_m=recorded.palm_position_m[near],
        palm_rotation_wxyz=recorded.palm_rotation_wxyz[near],
        flexion_rad=flexion,
        abduction_rad=recorded.abduction_rad[near],
        tracked=recorded.tracked[near],
        has_object_pose=recorded.has_object_pose[near],
        object_position_m=recorded.object_position_m[near],
        object_rotation_wxyz=recorded.object_rotation_wxyz[near],
    )
