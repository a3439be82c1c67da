"""A user profile as TOML. The keys are written down in docs/calibration.md."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.model import FINGERS
from palmar.profile import PROFILE_SCHEMA, FingerMeasures, Profile
from palmar.tools.toml_file import check_keys, get_number, get_text, is_number, read_toml

Array = NDArray[np.float64]

TOP_KEYS = ("schema", "name", "side", "source", "hand", "hand_length_m", "hand_breadth_m", "finger", "device")
DEVICE_KEYS = ("name", "palm_position_m", "palm_rotation_wxyz")
# Of a finger: shape, lowest and highest value.
FINGER_KEYS: dict[str, tuple[tuple[int, ...], float, float]] = {
    "length_m": ((3,), 0.002, 0.15),
    "length_spread_m": ((3,), 0.0, 0.15),
    "width_m": ((4,), 0.002, 0.1),
    "joint_m": ((3,), -0.5, 0.5),
    "flexion_axis": ((3, 3), -1.0, 1.0),
    "abduction_axis": ((3,), -1.0, 1.0),
    "flexion_limit_deg": ((3, 2), -180.0, 180.0),
    "abduction_limit_deg": ((2,), -180.0, 180.0),
    "reading_rad": ((3, 2), -1e6, 1e6),
    "marker_m": ((2, 3), -0.5, 0.5),
}
NEEDS_DEVICE = ("reading_rad", "marker_m")


def read_profile(path: str | Path) -> Profile:
    """Read a profile. Raises BadPack E-CONF with the file and key, what was found and what is allowed."""
    table, content = read_toml(path)
    where = str(path)
    if table.get("schema") != PROFILE_SCHEMA:
        found = f"{table['schema']!r}" if "schema" in table else "missing"
        raise BadPack("E-CONF", f"{where}:schema", f"{found}; {PROFILE_SCHEMA!r} is needed")
    check_keys(where, table, TOP_KEYS, ("name", "side"))
    fingers = table.get("finger", [])
    if not isinstance(fingers, list):
        raise BadPack("E-CONF", f"{where}:finger", "is no list; [[finger]] with a name is needed")
    measures = [FingerMeasures()] * 5
    named: set[str] = set()
    for number, row in enumerate(fingers):
        at = f"{where}:finger[{number}]"
        check_keys(at, row, ("name", *FINGER_KEYS), ("name",))
        name = get_text(at, row, "name", FINGERS)
        if name in named:
            raise BadPack("E-CONF", f"{at}.name", f"{name!r} stands there twice")
        named.add(name)
        measures[FINGERS.index(name)] = _read_finger(at, row)
    device, pose = _read_device(where, table)
    needing = [key for key in NEEDS_DEVICE for m in measures if getattr(m, key) is not None]
    if needing and not device:
        raise BadPack("E-CONF", f"{where}:device", f"is missing, but {needing[0]} is of one; [device] name is needed")
    return Profile(
        name=get_text(where, table, "name"),
        side=get_text(where, table, "side", ("right", "left")),
        source=get_text(where, table, "source") if "source" in table else Path(path).name,
        hand=get_text(where, table, "hand") if "hand" in table else "",
        hand_length_m=get_number(where, table, "hand_length_m", 0.05, 0.5) if "hand_length_m" in table else None,
        hand_breadth_m=get_number(where, table, "hand_breadth_m", 0.02, 0.3) if "hand_breadth_m" in table else None,
        fingers=tuple(measures),
        device=device,
        palm_from_device=pose,
        sha256=hashlib.sha256(content).hexdigest(),
    )


def profile_toml(profile: Profile) -> str:
    """The profile as TOML; lengths to a micrometre, angles to a thousandth of a degree."""
    lines = [
        "# Lengths in metres, in the palm frame of docs/hand_toml.md. Keys: docs/calibration.md.",
        f'schema = "{PROFILE_SCHEMA}"',
        f"name = {_text(profile.name)}",
        f'side = "{profile.side}"',
        f"source = {_text(profile.source)}",
    ]
    lines += [f"hand = {_text(profile.hand)}"] if profile.hand else []
    for key in ("hand_length_m", "hand_breadth_m"):
        value = getattr(profile, key)
        lines += [f"{key} = {_numbers(value, 6)}"] if value is not None else []
    for finger, measures in zip(FINGERS, profile.fingers, strict=True):
        rows = []
        for key in FINGER_KEYS:
            value = getattr(measures, key.replace("_deg", "_rad"))
            if value is not None:
                degrees = key.endswith("_deg")
                rows.append(f"{key} = {_numbers(np.degrees(value) if degrees else value, 3 if degrees else 6)}")
        lines += ["", "[[finger]]", f'name = "{finger}"', *rows] if rows else []
    if profile.device:
        lines += ["", "[device]", f"name = {_text(profile.device)}"]
        if profile.palm_from_device:
            lines += [f"palm_position_m = {_numbers(profile.palm_from_device[0], 6)}"]
            lines += [f"palm_rotation_wxyz = {_numbers(profile.palm_from_device[1], 9)}"]
    return "\n".join(lines) + "\n"


def _read_finger(where: str, row: dict[str, Any]) -> FingerMeasures:
    parts: dict[str, Array] = {}
    for key, (shape, low, high) in FINGER_KEYS.items():
        if key not in row:
            continue
        value = _array(where, key, row[key], shape, low, high)
        if key.endswith("axis"):
            length = np.linalg.norm(value, axis=-1, keepdims=True)
            if not (np.abs(length - 1) < 1e-3).all():
                raise BadPack("E-CONF", f"{where}.{key}", f"{row[key]}; directions of length 1 are needed")
            value = value / length
        if "limit" in key and not (value[..., 0] < value[..., 1]).all():
            raise BadPack("E-CONF", f"{where}.{key}", f"{row[key]}; lowest below highest is needed")
        parts[key.replace("_deg", "_rad")] = np.radians(value) if key.endswith("_deg") else value
    return FingerMeasures(**parts)


def _read_device(where: str, table: dict[str, Any]) -> tuple[str, tuple[Array, Array] | None]:
    if "device" not in table:
        return "", None
    at = f"{where}:device"
    row = check_keys(at, table["device"], DEVICE_KEYS, ("name",))
    given = [key for key in DEVICE_KEYS[1:] if key in row]
    if not given:
        return get_text(at, row, "name"), None
    if len(given) == 1:
        raise BadPack("E-CONF", at, f"{given[0]} alone; {' and '.join(DEVICE_KEYS[1:])} are needed together")
    position = _array(at, "palm_position_m", row["palm_position_m"], (3,), -0.5, 0.5)
    rotation = _array(at, "palm_rotation_wxyz", row["palm_rotation_wxyz"], (4,), -1.0, 1.0)
    if not abs(np.linalg.norm(rotation) - 1) < 1e-3:
        found = f"{row['palm_rotation_wxyz']} has length {np.linalg.norm(rotation):.4g}"
        raise BadPack("E-CONF", f"{at}.palm_rotation_wxyz", f"{found}; a rotation has 1")
    return get_text(at, row, "name"), (position, rotation / np.linalg.norm(rotation))


def _array(where: str, key: str, value: Any, shape: tuple[int, ...], low: float, high: float) -> Array:
    """Numbers of this shape, from low to high."""

    def fits(part: Any, sizes: tuple[int, ...]) -> bool:
        if not sizes:
            return is_number(part)
        return isinstance(part, list) and len(part) == sizes[0] and all(fits(item, sizes[1:]) for item in part)

    wanted = " x ".join(map(str, shape))
    if not fits(value, shape):
        raise BadPack("E-CONF", f"{where}.{key}", f"{str(value)[:60]}; {wanted} finite numbers are needed")
    numbers = np.array(value, dtype=np.float64)
    if not ((numbers >= low) & (numbers <= high)).all():
        wrong = numbers[(numbers < low) | (numbers > high)][0]
        raise BadPack("E-CONF", f"{where}.{key}", f"{wrong:g}; {low:g} to {high:g} is allowed")
    return numbers


def _text(value: str) -> str:
    """A TOML basic string: JSON's escapes are TOML's too."""
    return json.dumps(value)


def _numbers(value: Array | float, digits: int) -> str:
    if np.ndim(value) == 0:
        return repr(round(float(value), digits) + 0.0)  # + 0.0 turns -0.0 into 0.0
    return "[" + ", ".join(_numbers(part, digits) for part in np.asarray(value)) + "]"
