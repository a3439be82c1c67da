"""Readings of a glove, shares of its full scale, as angles of a hand, and back; and the readings in a recording."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from palmar._runtime import read_device_bytes
from palmar.errors import BadTrace
from palmar.model import FINGERS, Array, HandModel
from palmar.profile import Profile
from palmar.records import Trace, read_trace
from palmar.traces.line_buffer import LineBuffer
from palmar.traces.opengloves import LONGEST_LINE, Decoder, Reading, Rejected
from palmar.traces.readings import is_still

DEVICE = "opengloves"
# What the full scale counts as where a reading has to be an angle: in profiles.
FULL_SCALE_RAD = math.pi / 2
STAGGER_S = 1e-6  # between samples of lines that came together: times of samples have to rise


class AngleMap:
    """Readings as angles of a hand, one at a time: numpy costs five times as much for fifteen numbers.

    With a profile its readings are the ends of each joint, as in `angles_of`; without one 0 is straight and 1 the end
    of the joint's range. Joints that the glove does not send follow the hand's coupling, as in `complete_flexion`;
    abductions that it does not send are 0.
    """

    def __init__(self, hand: HandModel, profile: Profile | None) -> None:
        low, high = hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1]
        slope, start = high, np.zeros((5, 3))
        if profile is not None:
            slope, start = angles_of_share(high, profile)
        self._joints = list(zip(*(a.ravel().tolist() for a in (slope, start, low, high)), strict=True))
        self._clipped = profile is not None
        self._ratio = hand.flexion_coupling.tolist()
        self._abduction = hand.abduction_limit_rad.tolist()

    def angles(self, reading: Reading) -> tuple[list[float], list[float]]:
        """15 flexions and 5 abductions, rad. Raises BadTrace E-TRACE-VALUE if a finger has no joint that is read."""
        flexion: list[float] = []
        for joint, (share, (slope, start, low, high)) in enumerate(zip(reading.flexion, self._joints, strict=True)):
            angle = slope * (share - start)
            flexion.append(min(max(angle, low), high) if self._clipped and angle == angle else angle)
            if joint % 3 == 2:
                self._complete(joint // 3, flexion)
        spread = zip(reading.abduction, self._abduction, strict=True)
        return flexion, [0.0 if x != x else x * high if x >= 0 else -x * low for x, (low, high) in spread]

    def _complete(self, finger: int, flexion: list[float]) -> None:
        """Fill the NaN among the last three angles, which are a finger's, outwards first and then inwards."""
        read = flexion[-3:]
        first, second, third = read
        if first == first and second == second and third == third:
            return
        near, far = self._ratio[finger]
        second = first * near if second != second else second
        third = second * far if third != third else third
        second = third / far if second != second else second
        first = second / near if first != first else first
        if first != first:
            raise BadTrace("E-TRACE-VALUE", f"reading, {FINGERS[finger]}", "no joint of this finger is read")
        for k, angle in enumerate((first, second, third)):
            if read[k] != read[k]:
                _, _, low, high = self._joints[3 * finger + k]
                flexion[k - 3] = min(max(angle, low), high)


def angles_of_share(high: Array, profile: Profile) -> tuple[Array, Array]:
    """Slope and start of `slope (share - start)` by a profile's readings, (5, 3) each; NaN for joints not read."""
    reading = np.stack([r for r in (measures.reading_rad for measures in profile.fingers) if r is not None])
    start, end = reading[..., 0] / FULL_SCALE_RAD, reading[..., 1] / FULL_SCALE_RAD
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = high / (end - start)
    return np.where(is_still(reading), np.nan, slope), start


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
