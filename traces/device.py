"""The table of foreign formats, and the `import` verb."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from palmar.coupling import complete_flexion
from palmar.errors import BadTrace, PalmarError
from palmar.model import HandModel, write_whole
from palmar.profile import Profile
from palmar.records import Trace, write_trace
from palmar.tables import holds_table
from palmar.traces.adroit_door import COLUMNS as ADROIT_DOOR_COLUMNS
from palmar.traces.adroit_door import read_adroit_door
from palmar.traces.adroit_hand import adroit_hand_toml
from palmar.traces.column_map import read_column_map, read_mapped_csv
from palmar.traces.columns import nearest, read_header
from palmar.traces.glove_angles import read_opengloves
from palmar.traces.isaac_teleop import read_isaac_teleop
from palmar.traces.leap import COLUMNS as LEAP_COLUMNS
from palmar.traces.leap import read_leap
from palmar.traces.optical_glove import COLUMNS as OPTICAL_COLUMNS
from palmar.traces.optical_glove import read_optical_glove
from palmar.traces.readings import apply_readings
from palmar.traces.recording import Recording
from palmar.traces.samples import COLUMNS as SAMPLE_COLUMNS
from palmar.traces.samples import read_samples
from palmar.traces.scenario_csv import COLUMNS as SCENARIO_COLUMNS
from palmar.traces.scenario_csv import read_scenario_csv
from palmar.traces.solve import solve_recording
from palmar.traces.webxr import COLUMNS as WEBXR_COLUMNS
from palmar.traces.webxr import read_webxr
from palmar.traces.webxr_json import read_webxr_json


class Device(NamedTuple):
    """A format: how to read it, what it is, and the header row or the ending that gives it away."""

    read: Callable[..., Trace | Recording]
    about: str
    columns: list[str]
    endings: tuple[str, ...] = ()


DEVICES: dict[str, Device] = {
    "scenario-csv": Device(
        read_scenario_csv, "reference scenario: palm pose, 15 flexions and a phase a row", SCENARIO_COLUMNS
    ),
    "adroit-door": Device(
        read_adroit_door, "CyberGlove demonstrations of the Adroit hand at a door", ADROIT_DOOR_COLUMNS
    ),
    "webxr": Device(read_webxr, "WebXR hand tracking, such as a Quest 3's: 25 joint poses a row", WEBXR_COLUMNS),
    "webxr-json": Device(
        read_webxr_json, "WebXR input captured by Meta's immersive web emulation runtime", [], (".json",)
    ),
    "leap": Device(read_leap, "Leap Motion: palm and finger joints a row", LEAP_COLUMNS),
    "optical-glove": Device(
        read_optical_glove, "motion capture of a glove: three markers on the back, two a finger", OPTICAL_COLUMNS
    ),
    "opengloves": Device(read_opengloves, "the raw bytes in a recording of `palmar record`", ["device_bytes"]),
    "isaac-teleop": Device(read_isaac_teleop, "MCAP recordings of NVIDIA's Isaac Teleop: 26 OpenXR joints a hand", []),
    "samples": Device(
        read_samples, "samples that `palmar export` wrote, as CSV, JSON or Parquet", SAMPLE_COLUMNS, (".parquet",)
    ),
}
# Not a trace: the hand that a device's angles are of, as hand TOML.
HANDS: dict[str, tuple[Callable[..., str], str]] = {
    "adroit-hand": (adroit_hand_toml, "adroit_hand.json, the chain of the Adroit hand, to a hand TOML"),
}


def import_file(
    path: str | Path,
    out: str | Path,
    *,
    format: str | None = None,
    hand: HandModel | None = None,
    profile: Profile | None = None,
    change: Callable[[Trace], Trace] = lambda trace: trace,
    **options: Any,
) -> dict[str, Any]:
    """Turn a foreign log into a trace (or a hand's description into a hand TOML) and say what was done.

    format: a name of DEVICES or HANDS, or a TOML file that maps the columns of a CSV; None takes it from the header row
    or the ending. options go to the format's reader. hand: that positions are solved for, or whose coupling joints
    without a column follow, already made to fit the profile; profile: whose hand it is.
    change: the last thing done to the trace. Returns format, out, samples, duration_s, rate_hz (None for a single
    sample), assumptions (sentences), changed (what: how many or how much) and, of positions, residual_mm.
    Raises BadTrace, PalmarError; then nothing is written.
    """
    name = format or _guess_format(Path(path))
    if name in HANDS:
        convert = HANDS[name][0]
        _check_options(name, convert, options)
        text = convert(Path(path), **options)
        write_whole(out, text.encode())
        return {"format": name, "out": str(out), "assumptions": _leading_comments(text), "changed": {}}
    log = read_device(path, name, **options)
    if isinstance(log, Recording):
        if hand is None:
            needed = f"whose fingers are they? --profile of a `palmar calibrate {path}`, or --hand"
            raise PalmarError("E-CONF", "--profile", f"format {name} has positions, no angles: {needed}")
        trace = solve_recording(log, hand, profile)
    elif profile is not None and hand is not None:
        trace = apply_readings(log, hand, profile)
    elif np.isnan(log.flexion_rad).any():
        trace = _follow_coupling(log, hand, name)
    elif hand is not None:
        raise PalmarError("E-CONF", "--hand", f"format {name} has the angles of its own hand; leave it out")
    else:
        trace = log
    trace = change(trace)
    write_trace(out, trace)
    return {"format": name, "out": str(out), **summarise(trace)}


def _follow_coupling(log: Trace, hand: HandModel | None, name: str) -> Trace:
    """The log with its joints without a column filled by the hand's coupling."""
    if hand is None:
        raise PalmarError("E-CONF", "--hand", f"{name} has no column for some joints: whose coupling do they follow?")
    said = "Joints without a column follow the coupling of the hand."
    header = {
        **log.header,
        "hand": hand.about["name"],
        "assumptions": json.dumps([*json.loads(log.header["assumptions"]), said]),
    }
    return replace(log, header=header, flexion_rad=complete_flexion(hand, log.flexion_rad))


def read_device(path: str | Path, format: str | None = None, **options: Any) -> Trace | Recording:
    """What a foreign log holds, angles or positions. Raises BadTrace, PalmarError."""
    path = Path(path)
    name = format or _guess_format(path)
    if name.endswith(".toml"):
        columns = read_column_map(name)
        for option in options:
            raise PalmarError("E-CONF", option, "no option: the map says all; write it into the map")
        return read_mapped_csv(path, columns)
    if name in HANDS:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"format {name} is a hand; a log of a hand that moves is needed")
    if name not in DEVICES:
        known = [*DEVICES, *HANDS]
        raise BadTrace(
            "E-TRACE-FORMAT",
            str(path),
            f"format {name!r}{nearest(name, known)}; known are {', '.join(known)}, or a .toml map",
        )
    read = DEVICES[name].read
    _check_options(name, read, options)
    return read(path, **options)


def summarise(trace: Trace) -> dict[str, Any]:
    """Samples, duration, rate, assumptions, changes and residuals of a trace that was just made."""
    rate = trace.header.get("rate_hz")
    residual = {"residual_mm": json.loads(trace.header["residual_mm"])} if "residual_mm" in trace.header else {}
    return {
        "samples": len(trace.time_s),
        "duration_s": float(trace.time_s[-1] - trace.time_s[0]),
        "rate_hz": float(rate) if rate else None,
        "assumptions": json.loads(trace.header.get("assumptions", "[]")),
        "changed": json.loads(trace.header.get("changed", "{}")),
        **residual,
    }


def _guess_format(path: Path) -> str:
    """The format whose columns share most names with the header row; its reader then names what is misspelt."""
    if path.suffix == ".json":
        return _guess_json(path)
    if path.suffix == ".mcap" and not _is_ours(path):
        return "isaac-teleop"
    for name, device in DEVICES.items():
        if path.suffix in device.endings:
            return name
    known = ", ".join([*DEVICES, *HANDS])
    if path.suffix not in (".csv", ".tsv", ".txt"):
        raise BadTrace(
            "E-TRACE-FORMAT", str(path), f"extension {path.suffix!r} is of no known format; name one of {known}"
        )
    header = set(read_header(path))
    named = {name: set(device.columns) for name, device in DEVICES.items() if device.columns}
    shared = {name: len(header & columns) / len(columns) for name, columns in named.items()}
    best = max(shared, key=lambda name: shared[name])
    if shared[best] < 0.5:
        found = f"the header row is of no known format; name one of {known}, or a .toml map of its columns"
        raise BadTrace("E-TRACE-FORMAT", f"{path}:line 1", found)
    return best


def _is_ours(path: Path) -> bool:
    """Whether an MCAP file says in its header that Palmar wrote it."""
    try:
        with path.open("rb") as stream:
            return b"palmar" in stream.read(64)
    except OSError:
        return False


def _guess_json(path: Path) -> str:
    """By the first key: an exported table and a capture both have a schema, which is a text or a list."""
    if holds_table(path):
        return "samples"
    try:
        with path.open("rb") as stream:
            start = stream.read(64).replace(b" ", b"").replace(b"\n", b"")
    except OSError:
        start = b""
    return "webxr-json" if start.startswith(b'{"schema":[[') else "adroit-hand"


def _check_options(name: str, read: Callable[..., Any], options: dict[str, Any]) -> None:
    known = [p.name for p in inspect.signature(read).parameters.values() if p.kind is p.KEYWORD_ONLY]
    for option in options:
        if option not in known:
            allowed = f"it takes {', '.join(known)}" if known else "it takes none"
            raise PalmarError("E-CONF", option, f"no option of format {name}{nearest(option, known)}; {allowed}")


def _leading_comments(text: str) -> list[str]:
    """The comment lines a hand TOML starts with: what was assumed."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return lines
