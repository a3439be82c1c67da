"""The `export` verb: any of the three files as CSV, every number in full, for tools that are not Palmar."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import PalmarError
from palmar.files import nearest, stem_of
from palmar.model import FINGERS, JOINTS, AssetPack, write_whole
from palmar.records import Run, Trace

PLACEMENT = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
FLEXIONS = tuple(f"{finger}_{joint}_rad" for finger in FINGERS for joint in JOINTS)
ABDUCTIONS = tuple(f"{finger}_abduction_rad" for finger in FINGERS)


def export_file(
    content: AssetPack | Trace | Run, path: Path, out_dir: Path, name: str = "", level: int | None = None
) -> list[Path]:
    """Write the content of the file `path` as CSV into `out_dir`; name and level choose among the spheres of a pack."""
    if not isinstance(content, AssetPack) and (name or level is not None):
        raise PalmarError("E-USAGE", str(path), "--object and --level choose spheres of a pack; this is none")
    if isinstance(content, AssetPack):
        return export_pack(content, out_dir, name, level)
    if isinstance(content, Run):
        return export_run(content, out_dir, stem_of(path))
    return export_trace(content, out_dir, stem_of(path))


def export_pack(pack: AssetPack, out_dir: Path, name: str, level: int | None = None) -> list[Path]:
    """Spheres of each object as OBJECT.spheres.csv: the leaves, or one level as OBJECT.level_K.spheres.csv.

    name: one object, or "" for all. Raises PalmarError if there is no such object or level; then nothing is written.
    """
    if name and name not in pack.objects:
        raise PalmarError(
            "E-OBJECT", name, f"not in the pack{nearest(name, list(pack.objects))}; it has {', '.join(pack.objects)}"
        )
    chosen = {name: pack.objects[name]} if name else pack.objects
    for found, tree in chosen.items():
        if level is not None and not 0 <= level < len(tree.levels):
            raise PalmarError("E-LEVEL", found, f"level {level}; it has levels 0 to {len(tree.levels) - 1}")
    out_dir.mkdir(parents=True, exist_ok=True)
    written = []
    for found, tree in chosen.items():
        spheres = tree.leaves if level is None else tree.levels[level]
        suffix = "" if level is None else f".level_{level}"
        path = out_dir / f"{found}{suffix}.spheres.csv"
        _write_csv(path, ("x_m", "y_m", "z_m", "radius_m"), spheres.tolist())
        written.append(path)
    return written


def export_run(run: Run, out_dir: Path, stem: str) -> list[Path]:
    """Poses, status, step time and contacts of each step as STEM.poses.csv."""
    columns: list[str] = ["time_s"]
    blocks: list[NDArray[Any]] = [run.time_s]
    for hand, prefix in (("graphic", ""), ("haptic", "haptic_")):
        columns += _hand_columns(f"{hand}_")
        blocks += _hand_blocks(run, prefix)
    columns += ["status", "step_cpu_us", "contacts", *(f"object_{part}" for part in PLACEMENT)]
    blocks += [run.status, run.cpu_us, run.contacts, run.object_position_m, run.object_rotation_wxyz]
    out_dir.mkdir(parents=True, exist_ok=True)
    path = out_dir / f"{stem}.poses.csv"
    _write_csv(path, columns, _rows(blocks))
    return [path]


def export_trace(trace: Trace, out_dir: Path, stem: str) -> list[Path]:
    """The samples as STEM.samples.csv."""
    columns = ["time_s", "tracked", *_hand_columns(""), "has_object_pose", *(f"object_{part}" for part in PLACEMENT)]
    blocks: list[NDArray[Any]] = [trace.time_s, trace.tracked.astype(np.uint8), *_hand_blocks(trace, "")]
    blocks += [trace.has_object_pose.astype(np.uint8), trace.object_position_m, trace.object_rotation_wxyz]
    out_dir.mkdir(parents=True, exist_ok=True)
    path = out_dir / f"{stem}.samples.csv"
    _write_csv(path, columns, _rows(blocks))
    return [path]


def _hand_columns(prefix: str) -> list[str]:
    return [*(f"{prefix}palm_{part}" for part in PLACEMENT), *(prefix + name for name in FLEXIONS + ABDUCTIONS)]


def _hand_blocks(source: Any, prefix: str) -> list[NDArray[Any]]:
    fields = ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad")
    return [getattr(source, prefix + field) for field in fields]


def _rows(blocks: list[NDArray[Any]]) -> Iterable[list[Any]]:
    """Row i of every block, side by side; integers stay integers."""
    lists = [block.reshape(len(block), -1).tolist() for block in blocks]
    return ([value for part in parts for value in part] for parts in zip(*lists, strict=True))


def _write_csv(path: Path, columns: Iterable[str], rows: Iterable[list[Any]]) -> None:
    # csv writes a float as repr does: the shortest text that reads back as the same number.
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    write_whole(path, text.getvalue().encode())
