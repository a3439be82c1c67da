"""The `calibrate` verb: a recording, measurements, or both, as a user profile."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palmar.errors import PalmarError
from palmar.files import MCAP_MAGIC, sha256_of
from palmar.model import FINGERS, Array, HandModel, write_whole
from palmar.profile import Profile, bone_vectors, fit_to_profile, hand_breadth, hand_length
from palmar.records import Trace, read_trace
from palmar.show import print_residuals
from palmar.terminal import print_fields, print_table
from palmar.tools.default_hands import find_hand
from palmar.tools.profile_file import profile_toml, read_profile
from palmar.traces.calibrate import calibrate_recording
from palmar.traces.device import read_device
from palmar.traces.glove_angles import DEVICE as OPENGLOVES
from palmar.traces.glove_angles import read_opengloves
from palmar.traces.readings import calibrate_readings
from palmar.traces.recording import Recording


def calibrate(
    file: Path | None,
    out: Path,
    *,
    name: str,
    side: str = "right",
    hand_name: str | None = None,
    hand_length_mm: float | None = None,
    hand_breadth_mm: float | None = None,
    lengths_mm: Sequence[str] = (),
    widths_mm: Sequence[str] = (),
    format: str | None = None,
    options: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Write the profile and say what is in it; measurements stand over what a recording gave.

    file: a log of positions or angles, a trace, or a profile. hand_name: the hand that shapes start from and that the
    profile has to fit. Returns profile, sha256, name, side, hand (length and breadth in mm, and of each finger its
    lengths and their spread), and what the recording left (residual_mm, joints not read).
    Raises BadPack, BadTrace, PalmarError; then nothing is written.
    """
    hand = find_hand(hand_name)
    profile, told = _start(file, name, side, hand, format, options or {})
    lengths = dict(_measured("--length-mm", text, 3) for text in lengths_mm)
    widths = dict(_measured("--width-mm", text, 4) for text in widths_mm)
    fingers = tuple(
        replace(
            measures,
            length_m=lengths.get(f, measures.length_m),
            length_spread_m=None if f in lengths else measures.length_spread_m,
            width_m=widths.get(f, measures.width_m),
        )
        for f, measures in enumerate(profile.fingers)
    )
    profile = replace(
        profile,
        hand=profile.hand or str(hand.about.get("name", "")),
        fingers=fingers,
        hand_length_m=profile.hand_length_m if hand_length_mm is None else hand_length_mm / 1e3,
        hand_breadth_m=profile.hand_breadth_m if hand_breadth_mm is None else hand_breadth_mm / 1e3,
    )
    fitted = fit_to_profile(hand, profile)
    write_whole(out, profile_toml(profile).encode())
    return {
        "profile": str(out),
        "sha256": sha256_of(out),
        "name": profile.name,
        "side": profile.side,
        "hand": _tell_hand(fitted, profile),
        **told,
    }


def print_calibration(answer: dict[str, Any]) -> None:
    """Lengths and spreads, residuals, then the file."""
    fingers = answer["hand"]["fingers"]
    columns = ("finger", "length mm", "spread mm")
    cells = ((f, *(_join(v) for v in (row["length_mm"], row["spread_mm"]))) for f, row in fingers.items())
    print_table(columns, list(cells))
    if "residual_mm" in answer:
        print_residuals(answer["residual_mm"])
    fields = {"hand length mm": answer["hand"]["length_mm"], "hand breadth mm": answer["hand"]["breadth_mm"]}
    print_fields(fields | {key: value for key, value in answer.items() if key not in ("hand", "residual_mm")})


def _start(
    file: Path | None, name: str, side: str, hand: HandModel, format: str | None, options: dict[str, Any]
) -> tuple[Profile, dict[str, Any]]:
    """The profile before the measurements, and what a recording left."""
    if file is None:
        if side not in ("right", "left"):
            raise PalmarError("E-CONF", "--side", f"{side!r}; allowed are right, left")
        return Profile(name=name, side=side, source="measured"), {}
    if file.suffix == ".toml":
        return read_profile(file), {}
    with file.open("rb") as stream:
        is_trace = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
    log = _read_trace(file) if is_trace and format is None else read_device(file, format, **options)
    if isinstance(log, Recording):
        return calibrate_recording(log, hand, name)
    return calibrate_readings(log, name)


def _read_trace(file: Path) -> Trace:
    """A trace; of a recorded glove what it read, not what was made of it."""
    trace = read_trace(file)
    return read_opengloves(file) if trace.header["device"] == OPENGLOVES else trace


def _measured(flag: str, text: str, count: int) -> tuple[int, Array]:
    """`index=42,25,18` as a finger's number and metres."""
    finger, _, numbers = text.partition("=")
    parts = numbers.split(",")
    fits = len(parts) == count and all(re.fullmatch(r"\s*\d+\.?\d*\s*", part) for part in parts)
    if finger not in FINGERS or not fits:
        example = ",".join(["20"] * count)
        needed = f"a finger and {count} lengths, such as index={example}, are needed"
        raise PalmarError("E-USAGE", flag, f"{text!r}; {needed}")
    metres = np.array([float(part) for part in parts]) / 1e3
    if not ((metres > 0.002) & (metres < 0.15)).all():
        raise PalmarError("E-CONF", flag, f"{text!r}; 2 to 150 mm is allowed")
    return FINGERS.index(finger), metres


def _tell_hand(hand: HandModel, profile: Profile) -> dict[str, Any]:
    fingers = {}
    for f, measures in enumerate(profile.fingers):
        spread = measures.length_spread_m
        length_mm = np.linalg.norm(bone_vectors(hand, f), axis=1) * 1e3
        fingers[FINGERS[f]] = {
            "length_mm": [round(float(v), 2) for v in length_mm],
            "spread_mm": None if spread is None else [round(float(v) * 1e3, 2) for v in spread],
        }
    return {
        "length_mm": round(hand_length(hand) * 1e3, 1),
        "breadth_mm": round(hand_breadth(hand) * 1e3, 1),
        "fingers": fingers,
    }


def _join(values: list[float] | None) -> str:
    return "" if values is None else "  ".join(f"{v:.2f}" for v in values)
