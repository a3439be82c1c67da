"""Run against run: where they part, by how much, and what of their inputs is not the same."""

from __future__ import annotations

import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.eval.panels import hard_steps
from palmar.model import HAND_SHAPES, AssetPack
from palmar.records import Run

Array = NDArray[Any]
ASKED = ("haptic_palm_position_m", "haptic_palm_rotation_wxyz", "haptic_flexion_rad", "haptic_abduction_rad")
PLACED = ("object_position_m", "object_rotation_wxyz")
ANSWERED = (
    "palm_position_m",
    "palm_rotation_wxyz",
    "flexion_rad",
    "abduction_rad",
    "fingertip_force_n",
    "palm_force_n",
)
HEADER = ("pack_sha256", "trace_sha256", "object", "solver", "level", "settings", "build", "machine")


def answers(run: Run) -> NDArray[np.uint32]:
    """(n,) a checksum of what each step answered, poses and forces, to the bit."""
    return _checksums(run, (*ANSWERED, "status"))


def asked(run: Run) -> NDArray[np.uint32]:
    """(n,) a checksum of what each step was asked: haptic hand and object."""
    return _checksums(run, (*ASKED, *PLACED))


def inputs(pack: AssetPack, object_name: str, level: int = -1) -> dict[str, Array]:
    """What a pack's hand and object are: the hand's numbers, and a checksum of each sphere and of the mesh."""
    tree = pack.objects[object_name]
    found: dict[str, Array] = {f"hand.{name}": np.asarray(getattr(pack.hand, name)) for name in HAND_SHAPES}
    found["object.spheres_m"] = _rows(tree.levels[level])
    found["object.mesh"] = np.array([zlib.crc32(tree.vertices_m.tobytes()), zlib.crc32(tree.faces.tobytes())])
    return found


def what_differs(before: dict[str, Array], now: dict[str, Array]) -> list[str]:
    """A line for each of `inputs` that is not what it was."""
    lines = []
    for name in before:
        old, new = before[name], now.get(name)
        if new is None or old.shape != new.shape:
            lines.append(f"{name} had shape {old.shape}, has {None if new is None else new.shape}")
            continue
        at = np.argwhere(old != new)
        if not len(at):
            continue
        more = f" and {len(at) - 1} more" if len(at) > 1 else ""
        place = ", ".join(map(str, at[0]))
        if name.startswith("hand."):
            lines.append(f"{name}[{place}] was {old[tuple(at[0])]:.9g}, is {new[tuple(at[0])]:.9g}{more}")
        else:
            lines.append(f"{name} differs, of {len(old)} first number {place}{more}")
    return lines


def first_different(a: Array, b: Array, tolerance: float = 0.0) -> int | None:
    """First step at which two series (n,) differ by more than a tolerance; the shorter one's end if one is longer."""
    n = min(len(a), len(b))
    if a.dtype.kind == "u":
        apart = a[:n] != b[:n]
    else:
        apart = (np.abs(a[:n] - b[:n]) > tolerance) | (np.isnan(a[:n]) != np.isnan(b[:n]))
    if apart.any():
        return int(np.argmax(apart))
    return n if len(a) != len(b) else None


def compare_runs(a: Run, b: Run) -> dict[str, Any]:
    """Two runs side by side.

    {"equal": poses, forces and status to the bit, "steps": [n, n], "first_step": first that differs or None,
    "first_asked": first whose input does, "largest": name -> {"value", "unit", "step"}, "status": name -> [steps,
    steps], "header": key -> [value, value] where they differ}
    """
    first = first_different(answers(a), answers(b))
    n = min(len(a.time_s), len(b.time_s))
    largest = {}
    for name, unit, apart in _differences(a, b, n):
        step = int(np.argmax(apart)) if n else 0
        largest[name] = {"value": float(apart[step]) if n else 0.0, "unit": unit, "step": step}
    counted = [hard_steps(run) for run in (a, b)]
    status = {name: [each.get(name, 0) for each in counted] for name in counted[0] | counted[1]}
    return {
        "equal": first is None,
        "steps": [len(a.time_s), len(b.time_s)],
        "first_step": first,
        "first_time_s": float(a.time_s[first]) if first is not None and first < len(a.time_s) else None,
        "first_asked": first_different(asked(a), asked(b)),
        "largest": largest,
        "status": status,
        "header": _header(a, b),
    }


def _differences(a: Run, b: Run, n: int) -> list[tuple[str, str, Array]]:
    """Name, unit and (n,) difference of what a user sees and feels."""

    def of(name: str) -> Array:
        return getattr(a, name)[:n] - getattr(b, name)[:n]

    turn = np.zeros(n)
    if n:
        rotation = [Rotation.from_quat(np.roll(run.palm_rotation_wxyz[:n], -1, axis=1)) for run in (a, b)]
        turn = np.degrees((rotation[0].inv() * rotation[1]).magnitude())
    return [
        ("palm", "mm", 1e3 * np.linalg.norm(of("palm_position_m"), axis=1)),
        ("palm rotation", "deg", turn),
        ("flexion", "deg", np.degrees(np.abs(of("flexion_rad")).reshape(n, 15).max(axis=1))),
        ("abduction", "deg", np.degrees(np.abs(of("abduction_rad")).max(axis=1))),
        ("fingertip force", "N", np.linalg.norm(of("fingertip_force_n"), axis=2).max(axis=1)),
        ("palm force", "N", np.linalg.norm(of("palm_force_n"), axis=1)),
        ("contacts", "1", np.abs(a.contacts[:n].astype(np.float64) - b.contacts[:n])),
    ]


def _header(a: Run, b: Run) -> dict[str, list[Any]]:
    """What the headers say differently; of settings, build and machine each key by itself."""
    found: dict[str, list[Any]] = {}
    for key in HEADER:
        pair = [run.header.get(key) for run in (a, b)]
        if pair[0] == pair[1]:
            continue
        try:
            tables = [json.loads(text or "") for text in pair]
        except ValueError:
            tables = pair
        if all(isinstance(table, dict) for table in tables):
            for name in sorted(tables[0].keys() | tables[1].keys()):
                both = [table.get(name) for table in tables]
                if both[0] != both[1]:
                    found[f"{key}.{name}"] = both
        else:
            found[key] = pair
    return found


def _checksums(run: Run, columns: tuple[str, ...]) -> NDArray[np.uint32]:
    n = len(run.time_s)
    parts = [np.ascontiguousarray(getattr(run, name)).reshape(n, -1).view(np.uint8) for name in columns]
    return _rows(np.hstack(parts)) if n else np.zeros(0, dtype=np.uint32)


def _rows(table: Array) -> NDArray[np.uint32]:
    """(n,) a checksum of each row."""
    table = np.ascontiguousarray(table)
    return np.array([zlib.crc32(row.tobytes()) for row in table], dtype=np.uint32)
