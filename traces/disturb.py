"""Faults of sensors, links and clocks put into a trace: what `[[disturbance]]` of a scene says, for any trace.

Each fault works on samples in the order of their arrival; what comes out is taken in by `receive`, as a device's
samples are. Same trace, same faults, same seed: same bytes.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from palmar.errors import BadTrace, PalmarError
from palmar.records import Trace, read_trace, write_trace
from palmar.traces.kinematics import Array, multiply
from palmar.traces.receive import NUMBERS, hold_last_good, receive, take_rows
from palmar.traces.scene_file import Disturbance, Faults, validated

VALUES = {"nan": np.nan, "inf": np.inf, "-inf": -np.inf, "huge": 1e30, "denormal": 5e-324}
BROKEN = {"palm": None, "thumb": [0], "index": [1], "middle": [2], "ring": [3], "little": [4], "fingers": [1, 2, 3, 4]}
ROUNDING_S = 1e-9


@dataclass(frozen=True)
class Stream:
    """Samples with the times at which they arrive, in no order."""

    arrival_s: Array  # (n,)
    said: Trace

    def rows(self, rows: NDArray[Any]) -> Stream:
        return Stream(self.arrival_s[rows], take_rows(self.said, rows))


def disturb(trace: Trace, faults: Sequence[Disturbance], generator: np.random.Generator) -> Trace:
    """The trace as it is received with the faults, one after the other, `sampled` first; unchanged if there are none.

    The header gets a phase `disturbance` for each, and under `changed` what the receiver had to count. Raises BadTrace
    E-TRACE-EMPTY if no sample is left.
    """
    if not faults:
        return trace
    stream = Stream(trace.time_s, hold_last_good(trace))
    # The device samples the motion; whatever happens to its samples happens after that.
    for fault in sorted(faults, key=lambda fault: fault.kind != "sampled"):
        stream = FAULTS[fault.kind](stream, fault, generator)
        if not len(stream.arrival_s):
            raise BadTrace("E-TRACE-EMPTY", f"disturbance {fault.kind}", "leaves no sample")
    stream = stream.rows(np.argsort(stream.arrival_s, kind="stable"))
    received, counts, sentences = receive(stream.arrival_s, stream.said)
    begin_s, end_s = float(trace.time_s[0]), float(trace.time_s[-1])
    phases = trace.phases + [
        {
            "name": "disturbance",
            "start_s": begin_s + fault.at_s,
            "end_s": min(begin_s + fault.at_s + fault.for_s, end_s),
        }
        for fault in faults
    ]
    header = {
        **trace.header,
        "phases": json.dumps(sorted(phases, key=lambda phase: phase["start_s"])),
        "changed": json.dumps(json.loads(trace.header.get("changed", "{}")) | counts),
        "assumptions": json.dumps(json.loads(trace.header.get("assumptions", "[]")) + sentences),
    }
    return replace(received, header=header)


def disturb_file(path: Path, faults: Path, out: Path, seed: int = 0) -> dict[str, Any]:
    """Write a trace with the faults of a TOML file; returns out, samples before and after, and what was counted.

    Raises PalmarError E-CONF for the faults, BadTrace for the trace; then nothing is written.
    """
    try:
        keys = tomllib.loads(faults.read_text())
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PalmarError("E-CONF", str(faults), f"not a TOML file of faults ({error})") from None
    checked = validated(Faults, keys, str(faults))
    trace = read_trace(path)
    if any(trace.lost.values()):
        raise BadTrace("E-TRACE-LOSS", str(path), "is damaged; `palmar recover` makes a sound trace of it first")
    disturbed = disturb(trace, checked.disturbance, np.random.default_rng(seed))
    write_trace(out, disturbed)
    return {
        "out": str(out),
        "faults": [fault.kind for fault in checked.disturbance],
        "samples before": len(trace.time_s),
        "samples": len(disturbed.time_s),
        "not tracked": int((~disturbed.tracked).sum()),
        "changed": json.loads(disturbed.header["changed"]),
    }


def _during(stream: Stream, fault: Disturbance) -> NDArray[np.bool_]:
    since_s = stream.said.time_s - stream.said.time_s[0]
    return (since_s >= fault.at_s - ROUNDING_S) & (since_s < fault.at_s + fault.for_s - ROUNDING_S)


def _chosen(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> NDArray[np.bool_]:
    during = _during(stream, fault)
    return during if fault.share == 1.0 else during & (generator.random(len(during)) < fault.share)


def _changed(stream: Stream, **columns: Any) -> Stream:
    return Stream(stream.arrival_s, replace(stream.said, **columns))


def _spike(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = _chosen(stream, fault, generator)
    position, flexion = stream.said.palm_position_m.copy(), stream.said.flexion_rad.copy()
    rotation = stream.said.palm_rotation_wxyz.copy()
    position[at] += fault.move_m
    flexion[at] += fault.flexion_rad
    turn = np.roll(Rotation.from_rotvec(fault.turn_rad).as_quat(), 1)
    if any(fault.turn_rad):
        rotation[at] = multiply(np.broadcast_to(turn, (int(at.sum()), 4)), rotation[at])
    return _changed(stream, palm_position_m=position, flexion_rad=flexion, palm_rotation_wxyz=rotation)


def _frozen(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = np.flatnonzero(_during(stream, fault))
    if not len(at):
        return stream
    columns = {name: getattr(stream.said, name).copy() for name in NUMBERS}
    for values in columns.values():
        values[at] = values[max(at[0] - 1, 0)]
    tracked = stream.said.tracked.copy()
    tracked[at] &= fault.kind != "untracked"
    return _changed(stream, tracked=tracked, **columns)


def _zeros(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = _chosen(stream, fault, generator)
    columns = {name: getattr(stream.said, name).copy() for name in NUMBERS}
    for values in columns.values():
        values[at] = 0.0
    return _changed(stream, **columns)


def _broken(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = _chosen(stream, fault, generator)
    position, flexion = stream.said.palm_position_m.copy(), stream.said.flexion_rad.copy()
    if fault.of in ("palm", "all"):
        position[at] = VALUES[fault.value]
    fingers = BROKEN.get(fault.of, [0, 1, 2, 3, 4])
    if fingers:
        flexion[np.ix_(at, np.array(fingers))] = VALUES[fault.value]
    return _changed(stream, palm_position_m=position, flexion_rad=flexion)


def _stuck(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = np.flatnonzero(_during(stream, fault))
    position, flexion = stream.said.palm_position_m.copy(), stream.said.flexion_rad.copy()
    if len(at) and fault.of in ("palm", "all"):
        position[at] = position[at[0]]
    fingers = BROKEN.get(fault.of, [0, 1, 2, 3, 4])
    if len(at) and fingers:
        flexion[np.ix_(at, np.array(fingers))] = flexion[at[0], fingers]
    return _changed(stream, palm_position_m=position, flexion_rad=flexion)


def _dropped(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    return stream.rows(np.flatnonzero(~_chosen(stream, fault, generator)))


def _doubled(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    at = _chosen(stream, fault, generator)
    copies = np.where(at, fault.times, 1)
    rows = np.repeat(np.arange(len(at)), copies)
    doubled = stream.rows(rows)
    if not fault.own_times:
        return doubled
    # Each copy is spread over the time to the next sample, the last over the usual interval.
    number = np.arange(len(rows)) - np.repeat(np.cumsum(copies) - copies, copies)
    apart = np.diff(stream.said.time_s)
    apart = np.append(apart, np.median(apart) if len(apart) else 0.0)
    later = number / copies[rows] * apart[rows]
    return Stream(doubled.arrival_s + later, replace(doubled.said, time_s=doubled.said.time_s + later))


def _swapped(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    arrival = stream.arrival_s.copy()
    swapped = -1
    for row in np.flatnonzero(_chosen(stream, fault, generator)[:-1]).tolist():
        if row > swapped:
            arrival[[row, row + 1]] = arrival[[row + 1, row]]
            swapped = row + 1
    return Stream(arrival, stream.said)


def _late(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    return Stream(stream.arrival_s + fault.by_s * _chosen(stream, fault, generator), stream.said)


def _clock(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    return _changed(stream, time_s=stream.said.time_s + fault.by_s * _during(stream, fault))


def _sampled(stream: Stream, fault: Disturbance, generator: np.random.Generator) -> Stream:
    """The motion, straight between the trace's samples, as a device of another rate takes it, from first to last."""
    time_s = stream.said.time_s
    count = int(np.floor((time_s[-1] - time_s[0]) * fault.rate_hz)) + 1
    early = generator.uniform(-fault.jitter, fault.jitter, count) if fault.jitter else np.zeros(count)
    at_s = np.clip(time_s[0] + (np.arange(count) + early) / fault.rate_hz, time_s[0], time_s[-1])
    held = np.searchsorted(time_s, at_s + ROUNDING_S, side="right") - 1

    def between(values: Array) -> Array:
        flat = values.reshape(len(values), -1)
        return np.column_stack([np.interp(at_s, time_s, column) for column in flat.T]).reshape(-1, *values.shape[1:])

    def turned(wxyz: Array) -> Array:
        if len(time_s) < 2:
            return wxyz[held]
        found = np.roll(Slerp(time_s, Rotation.from_quat(np.roll(wxyz, -1, axis=1)))(at_s).as_quat(), 1, axis=1)
        return found * np.where((found * wxyz[held]).sum(axis=1) < 0, -1.0, 1.0)[:, None]

    moved = replace(
        take_rows(stream.said, held, at_s),
        palm_position_m=between(stream.said.palm_position_m),
        palm_rotation_wxyz=turned(stream.said.palm_rotation_wxyz),
        flexion_rad=between(stream.said.flexion_rad),
        abduction_rad=between(stream.said.abduction_rad),
        object_position_m=between(stream.said.object_position_m),
        object_rotation_wxyz=turned(stream.said.object_rotation_wxyz),
        header={**stream.said.header, "rate_hz": f"{fault.rate_hz:g}"},
    )
    return Stream(at_s, moved)


FAULTS: dict[str, Callable[[Stream, Disturbance, np.random.Generator], Stream]] = {
    "spike": _spike,
    "frozen": _frozen,
    "untracked": _frozen,
    "zeros": _zeros,
    "broken": _broken,
    "stuck": _stuck,
    "dropped": _dropped,
    "doubled": _doubled,
    "swapped": _swapped,
    "late": _late,
    "clock": _clock,
    "sampled": _sampled,
}
