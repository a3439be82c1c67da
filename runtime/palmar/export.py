"""The `export` verb: any of the three files as CSV, JSON or Parquet, every number in full, for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import PalmarError
from palmar.files import nearest, stem_of
from palmar.model import FINGERS, JOINTS, AssetPack
from palmar.records import Run, Trace
from palmar.tables import FORMS, Table, write_table

PLACEMENT = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
FLEXIONS = tuple(f"{finger}_{joint}_rad" for finger in FINGERS for joint in JOINTS)
ABDUCTIONS = tuple(f"{finger}_abduction_rad" for finger in FINGERS)
HAND = (*(f"palm_{part}" for part in PLACEMENT), *FLEXIONS, *ABDUCTIONS)
OBJECT = tuple(f"object_{part}" for part in PLACEMENT)
SAMPLES = ("time_s", "tracked", *HAND, "has_object_pose", *OBJECT)


def export_file(
    content: AssetPack | Trace | Run,
    path: Path,
    out_dir: Path,
    name: str = "",
    level: int | None = None,
    form: str = "csv",
) -> list[Path]:
    """Write the content of the file `path` into `out_dir`; name and level choose among the spheres of a pack.

    form: csv, json or parquet. The files are OBJECT.spheres, or OBJECT.level_K.spheres of a level that is named, of a
    pack; STEM.samples of a trace; STEM.poses of a run. Raises PalmarError E-OBJECT, E-LEVEL, E-USAGE, E-PACKAGE; then
    nothing is written.
    """
    if form not in FORMS:
        raise PalmarError("E-USAGE", "--format", f"{form!r}{nearest(form, FORMS)}; allowed are {', '.join(FORMS)}")
    if not isinstance(content, AssetPack) and (name or level is not None):
        raise PalmarError("E-USAGE", str(path), "--object and --level choose spheres of a pack; this is none")
    if isinstance(content, AssetPack):
        tables = pack_tables(content, name, level)
    elif isinstance(content, Run):
        tables = {f"{stem_of(path)}.poses": run_table(content)}
    else:
        tables = {f"{stem_of(path)}.samples": trace_table(content)}
    out_dir.mkdir(parents=True, exist_ok=True)
    written = []
    for stem, table in tables.items():
        written.append(out_dir / f"{stem}.{form}")
        write_table(written[-1], table)
    return written


def pack_tables(pack: AssetPack, name: str, level: int | None = None) -> dict[str, Table]:
    """Spheres of each object, by file stem: the leaves, or one level. name: one object, or "" for all.

    Raises PalmarError if there is no such object or level.
    """
    if name and name not in pack.objects:
        raise PalmarError(
            "E-OBJECT", name, f"not in the pack{nearest(name, list(pack.objects))}; it has {', '.join(pack.objects)}"
        )
    chosen = {name: pack.objects[name]} if name else pack.objects
    for found, tree in chosen.items():
        if level is not None and not 0 <= level < len(tree.levels):
            raise PalmarError("E-LEVEL", found, f"level {level}; it has levels 0 to {len(tree.levels) - 1}")
    tables = {}
    for found, tree in chosen.items():
        spheres = tree.leaves if level is None else tree.levels[level]
        suffix = "" if level is None else f".level_{level}"
        columns = dict(zip(("x_m", "y_m", "z_m", "radius_m"), spheres.T, strict=True))
        tables[f"{found}{suffix}.spheres"] = Table(columns, {"object": found})
    return tables


def run_table(run: Run) -> Table:
    """Poses, status, step time and contacts of each step."""
    names = ["time_s", *(f"graphic_{part}" for part in HAND), *(f"haptic_{part}" for part in HAND)]
    blocks = [run.time_s, *_hand_blocks(run, ""), *_hand_blocks(run, "haptic_")]
    names += ["status", "step_cpu_us", "contacts", *OBJECT]
    blocks += [run.status, run.cpu_us, run.contacts, run.object_position_m, run.object_rotation_wxyz]
    return Table(_columns(names, blocks), run.header)


def trace_table(trace: Trace) -> Table:
    """The samples, one a row; the trace's header is what is said about them."""
    blocks = [trace.time_s, trace.tracked, *_hand_blocks(trace, "")]
    blocks += [trace.has_object_pose, trace.object_position_m, trace.object_rotation_wxyz]
    return Table(_columns(SAMPLES, blocks), trace.header)


def trace_of(table: Table) -> Trace:
    """The trace whose `trace_table` it is. Raises KeyError for a column or a header key that is missing."""
    columns = table.columns

    def block(names: tuple[str, ...] | list[str], *shape: int) -> NDArray[np.float64]:
        stacked = np.column_stack([np.asarray(columns[name], dtype=np.float64) for name in names])
        return stacked.reshape(len(stacked), *shape)

    return Trace(
        header=table.about,
        time_s=block(["time_s"]),
        palm_position_m=block(HAND[:3], 3),
        palm_rotation_wxyz=block(HAND[3:7], 4),
        flexion_rad=block(FLEXIONS, 5, 3),
        abduction_rad=block(ABDUCTIONS, 5),
        tracked=block(["tracked"]) > 0.5,
        has_object_pose=block(["has_object_pose"]) > 0.5,
        object_position_m=block(OBJECT[:3], 3),
        object_rotation_wxyz=block(OBJECT[3:], 4),
    )


def _hand_blocks(source: Any, prefix: str) -> list[NDArray[Any]]:
    fields = ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad")
    return [getattr(source, prefix + field) for field in fields]


def _columns(names: list[str] | tuple[str, ...], blocks: list[NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Columns of every block, side by side; integers stay integers."""
    columns = [column for block in blocks for column in block.reshape(len(block), -1).T]
    return dict(zip(names, columns, strict=True))
