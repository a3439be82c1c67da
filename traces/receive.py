"""Samples as a device delivers them -> Trace: what is late, double, not a pose or of a clock that leaps, counted.

A trace holds samples whose times rise and whose numbers are a hand's. A device promises neither, so whoever takes its
samples in does this first: logs that are repaired, scenes and traces with faults on purpose.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadTrace
from palmar.model import FINGERS, JOINTS
from palmar.records import Trace
from palmar.traces.kinematics import Array

CLOCK_LEAP_S = 0.5  # device and arrival apart by more from one sample to the next: the clock was set, or wrapped
FARTHEST_M = 1e3  # as the solver: from farther off a number is no place
WIDEST_RAD = 10.0  # no joint turns so far; 1e30 is finite
UNIT_TOLERANCE = 1e-3  # as the trace format
STUCK_S = 2.0
MOVED_RAD = 0.1
NEAR_ZERO_M = 0.02
GAP = 2.5  # of the usual interval
NUMBERS = ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad")


def receive(arrival_s: Array, said: Trace) -> tuple[Trace, dict[str, Any], list[str]]:
    """The trace that a device's samples make, what was changed (what: how many), and sentences of what to know.

    said: samples in the order of arrival, with the device's own times; they may break every rule of a trace.
    arrival_s: (n,) when each came, rising or equal. A sample that is not later than one before is dropped, never put
    back in; one that is no pose (not finite, no rotation, all zeros after a pose) stays as one that is not tracked,
    with the numbers of the last good one. Raises BadTrace E-TRACE-EMPTY if no sample is a pose.
    """
    rows, time_s, counts = _in_time(arrival_s, said.time_s)
    trace = take_rows(said, rows, time_s)
    tracked = trace.tracked
    trace = hold_last_good(trace)
    counts["not a pose"] = int((tracked & ~trace.tracked).sum())
    trace, counts["repeated by a padded stream"] = _unpad(trace)
    counts |= _gaps(trace.time_s)
    return trace, {what: count for what, count in counts.items() if count}, _stuck(trace)


def hold_last_good(trace: Trace) -> Trace:
    """Samples that are no pose as not tracked, and of all that are not tracked the numbers of the last one that is.

    Before the first good sample its numbers stand. Raises BadTrace E-TRACE-EMPTY if there is none.
    """
    good = usable(trace) & trace.tracked
    if not good.any():
        raise BadTrace("E-TRACE-EMPTY", trace.header.get("source", "a trace"), "no sample is a pose of a tracked hand")
    last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
    last[last < 0] = int(np.argmax(good))
    return replace(trace, tracked=good, **{name: getattr(trace, name)[last] for name in NUMBERS})


def take_rows(trace: Trace, rows: NDArray[np.int64], time_s: Array | None = None) -> Trace:
    """Rows of a trace in the order given, with other times if there are any."""
    columns = {
        name: getattr(trace, name)[rows] for name in Trace.__dataclass_fields__ if name not in ("header", "lost")
    }
    return replace(trace, **columns if time_s is None else {**columns, "time_s": time_s})


def usable(trace: Trace) -> NDArray[np.bool_]:
    """Whether each sample can be a pose of a hand, (n,)."""
    count = len(trace.time_s)
    with np.errstate(invalid="ignore", over="ignore"):
        angles = np.hstack([trace.flexion_rad.reshape(count, 15), trace.abduction_rad])
        near = (np.abs(trace.palm_position_m) <= FARTHEST_M).all(axis=1) & (np.abs(angles) <= WIDEST_RAD).all(axis=1)
        turned = np.abs(np.linalg.norm(trace.palm_rotation_wxyz, axis=1) - 1.0) <= UNIT_TOLERANCE
        # Zeros are what a failed read delivers; a hand that came to all zeros by itself was near them before.
        zero = ~trace.palm_position_m.any(axis=1) & ~angles.any(axis=1)
        before = np.maximum.accumulate(np.where(zero, -1, np.arange(count)))
        far = (np.linalg.norm(trace.palm_position_m, axis=1) > NEAR_ZERO_M) | (np.abs(angles).max(axis=1) > MOVED_RAD)
    failed = zero & (before >= 0) & far[before]
    return near & turned & ~failed  # comparisons with what is not finite are false


def _in_time(arrival_s: Array, device_s: Array) -> tuple[NDArray[np.int64], Array, dict[str, Any]]:
    """Rows that are later than all before them, and their times on one clock that never leaps."""
    rows: list[int] = []
    times: list[float] = []
    counts: dict[str, Any] = {"clock set anew": 0, "late or double": 0, "without a time": 0}
    shift = 0.0
    before: tuple[float, float] | None = None
    for row, (arrived, device) in enumerate(zip(arrival_s.tolist(), device_s.tolist(), strict=True)):
        if not np.isfinite(device):
            counts["without a time"] += 1
            continue
        if before is not None:
            leap = (device - before[1]) - (arrived - before[0])
            if abs(leap) > CLOCK_LEAP_S:
                shift -= leap
                counts["clock set anew"] += 1
        before = (arrived, device)
        time = device + shift
        if times and time <= times[-1]:
            counts["late or double"] += 1
            continue
        rows.append(row)
        times.append(time)
    found = np.array(times)
    if times and times[0] < 0:  # a trace has no times below 0
        counts["times moved later, ms"] = round(-1e3 * times[0], 3)
        found -= times[0]
    return np.array(rows, dtype=np.int64), found, counts


def _unpad(trace: Trace) -> tuple[Trace, int]:
    """Without the repeats of a stream in which every reading comes k times, so that a slow glove looks fast.

    Readings that rest repeat too, but not each of them equally often: k is the fewest repeats of any reading between
    the first and the last.
    """
    count = len(trace.time_s)
    numbers = np.hstack([getattr(trace, name).reshape(count, -1) for name in NUMBERS])
    changes = np.flatnonzero((numbers[1:] != numbers[:-1]).any(axis=1)) + 1
    if len(changes) < 4:  # nothing moves often enough to tell
        return trace, 0
    factor = int(np.diff(changes).min())
    if factor < 2:
        return trace, 0
    starts = np.concatenate([[0], changes])
    in_run = np.arange(count) - starts[np.searchsorted(starts, np.arange(count), side="right") - 1]
    # The first reading may have begun before the recording: its run is counted from its end.
    in_run[: changes[0]] -= changes[0] % factor
    kept = np.flatnonzero(in_run % factor == 0)
    return take_rows(trace, kept), count - len(kept)


def _gaps(time_s: Array) -> dict[str, Any]:
    if len(time_s) < 3:
        return {}
    apart = np.diff(time_s)
    gaps = apart[apart > GAP * np.median(apart)]
    return {"gaps": len(gaps), "longest gap, ms": round(1e3 * float(gaps.max()), 1) if len(gaps) else 0}


def _stuck(trace: Trace) -> list[str]:
    """A sentence on joints that move, and say one number for two seconds while another joint moves."""
    found = []
    flexion = trace.flexion_rad.reshape(-1, 15)
    for joint in np.flatnonzero(np.ptp(flexion, axis=0) > MOVED_RAD).tolist():
        edges = [0, *(np.flatnonzero(np.diff(flexion[:, joint])) + 1).tolist(), len(flexion)]
        longest = max(pairwise(edges), key=lambda run: trace.time_s[run[1] - 1] - trace.time_s[run[0]])
        lasts_s = trace.time_s[longest[1] - 1] - trace.time_s[longest[0]]
        moved_rad = np.ptp(flexion[longest[0] : longest[1]], axis=0).max()
        if lasts_s >= STUCK_S and moved_rad > MOVED_RAD:
            found.append(f"{FINGERS[joint // 3]} {JOINTS[joint % 3]} for {lasts_s:.3g} s")
    if not found:
        return []
    return [f"Stuck while other joints move: {', '.join(found)}."]
