"""Regression: replay what golden.csv names and hold every number in it against its tolerance. It knows all stages.

Beside the numbers a file of the same name, ending in .trail.npz, keeps of each replay what is needed to say where it
went another way: a checksum of every step's answer and input, the series behind the numbers, and the hand.
"""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from palmar.check_case import ALWAYS, replay_case, save_object
from palmar.errors import BadTrace, PalmarError
from palmar.eval.compare import answers, asked, first_different, inputs, what_differs
from palmar.eval.metrics import measure
from palmar.eval.table import METRICS
from palmar.files import require_file
from palmar.model import AssetPack, load_pack, write_whole
from palmar.records import Run, read_run, read_trace
from palmar.replay import object_of, replay_file
from palmar.tools.hand_file import default_hand
from palmar.tools.lattice import scene_object
from palmar.traces.scene_file import Sampled, cases_of, check_scene
from palmar.traces.scripted import load_scene

GOLDEN_SCHEMA = "palmar.golden/1"
TRAIL = ".trail.npz"
# What a new row starts with: on one build a replay is the same to the bit, another compiler rounds otherwise; 1 um of
# radius moves a palm by ten times this.
TOLERANCE = 1e-4
# Kept of every replay, beside what its scene is about.
KEPT = ("palm_offset", "excess_force_step", "joint_step_excess", "energy_generated", "friction_force", "contacts")


@dataclass(frozen=True)
class GoldenRow:
    """One expected number. scene: a name, or a trace (with its pack), relative to golden.csv."""

    scene: str
    pack: str
    case: str
    start: int
    solver: str
    level: int
    metric: str
    stat: str
    unit: str
    value: float
    tolerance: float
    reason: str

    @property
    def replay(self) -> tuple[str, str, str, int, str, int]:
        return self.scene, self.pack, self.case, self.start, self.solver, self.level


COLUMNS = [column.name for column in fields(GoldenRow)]


def read_golden(path: Path) -> list[GoldenRow]:
    """The rows of a golden.csv. Raises PalmarError E-GOLDEN with the line and what is allowed."""
    with require_file(path).open(newline="", encoding="utf-8") as stream:
        table = csv.DictReader(stream)
        if table.fieldnames != COLUMNS:
            raise PalmarError("E-GOLDEN", f"{path}:1", f"columns {table.fieldnames}; needed are {','.join(COLUMNS)}")
        rows = [_row(cells, f"{path}:{number}") for number, cells in enumerate(table, start=2)]
    known = {(metric.name, stat.name) for metric in METRICS for stat in metric.stats}
    for number, row in enumerate(rows, start=2):
        if (row.metric, row.stat) not in known:
            raise PalmarError("E-GOLDEN", f"{path}:{number}", f"no metric {row.metric!r} with a number {row.stat!r}")
    return rows


def _row(cells: dict[str, Any], where: str) -> GoldenRow:
    numbers: dict[str, Any] = {}
    for name, kind in (("start", int), ("level", int), ("value", float), ("tolerance", float)):
        try:
            numbers[name] = kind(cells[name])
        except (TypeError, ValueError):
            raise PalmarError("E-GOLDEN", where, f"{name} {cells[name]!r}; a number is needed") from None
    if not (np.isfinite(numbers["value"]) and 0 <= numbers["tolerance"] < np.inf):
        raise PalmarError("E-GOLDEN", where, "value and tolerance have to be finite, the tolerance from 0")
    if None in cells or None in cells.values():
        raise PalmarError("E-GOLDEN", where, f"{len(COLUMNS)} cells are needed")
    return GoldenRow(**{**cells, **numbers})


def write_golden(path: Path, rows: Sequence[GoldenRow]) -> None:
    out = io.StringIO()
    table = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows({**asdict(row), "value": repr(row.value), "tolerance": repr(row.tolerance)} for row in rows)
    write_whole(path, out.getvalue().encode())


def check_golden(
    path: Path,
    scenes: Sequence[str],
    *,
    pack: Path | None = None,
    solvers: Sequence[str] = (),
    reason: str | None = None,
    progress: Callable[[str, float], None] = lambda text, fraction: None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Replay what the file names, or the scenes and traces named of it, and compare.

    reason: write the new values, each that changed with this reason; scenes and traces that the file does not name are
    added, by `solvers`, traces on `pack`. Returns schema, passed, updated, replays, failures. Raises PalmarError,
    BadPack, BadTrace.
    """
    rows = read_golden(path) if path.exists() or reason is None else []
    names = [_name(scene, path) for scene in scenes]
    wanted = list(dict.fromkeys(row.replay for row in rows if not names or row.scene in names))
    if reason is not None:
        wanted += [new for new in _new_replays(names, path, pack, solvers) if new not in wanted]
    elif missing := set(names) - {row.scene for row in rows}:
        raise PalmarError("E-GOLDEN", str(path), f"says nothing of {sorted(missing)[0]}; --update adds it")
    trail = Trail(path)
    failures: list[dict[str, Any]] = []
    replays, updated = [], 0
    with tempfile.TemporaryDirectory(prefix="palmar-golden-") as folder:
        for done, place in enumerate(wanted):
            progress(f"{place[0]} {place[4]}", done / len(wanted))
            run, assets, name, about = _replay(Path(folder), path.parent, place)
            expected = [row for row in rows if row.replay == place]
            metrics = {row.metric for row in expected} or {*ALWAYS, *about, *KEPT}
            measured, series = measure(run, assets, name, only=metrics)
            now = {(row["metric"], row["stat"]): row for row in measured if row["value"] is not None}
            found = [] if reason is not None and not expected else _compare(expected, now)
            where = trail.where(place, run, assets, name, series)
            found = [{**failure, **where(failure["metric"], failure["tolerance"])} for failure in found]
            changed = trail.changed(place, run, assets, name) if expected else []
            if not found:
                # Other numbers of a hand are never the same check, even where none of those below tells.
                found = [_of_hand(expected[0], line) for line in changed if line.startswith("hand.")]
            failures += found
            told = {"scene": place[0], "case": place[2], "solver": place[4], "numbers": len(expected or now)}
            replays.append({**told, "changed_inputs": changed})
            say(_line(replays[-1], found, new=not expected))
            if reason is not None:
                fresh, count = _updated(place, expected, now, reason)
                rows = [row for row in rows if row.replay != place] + fresh
                updated += count
                trail.keep(place, run, assets, name, series)
    if reason is not None:
        write_golden(path, rows)
        trail.write()
    passed = reason is not None or not failures
    told = {"schema": GOLDEN_SCHEMA, "passed": passed, "updated": updated, "replays": replays}
    return {**told, "failures": failures}


def _name(scene: str, path: Path) -> str:
    """The scene as the file names it: traces and scene files by their way from the file."""
    if Path(scene).suffix not in (".mcap", ".toml"):
        return scene
    return _from(require_file(Path(scene)), path.parent)


def _from(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def _new_replays(
    names: Sequence[str], path: Path, pack: Path | None, solvers: Sequence[str]
) -> list[tuple[str, str, str, int, str, int]]:
    found = []
    for name in names:
        of, case = "", ""
        if name.endswith(".mcap"):
            if pack is None:
                raise PalmarError("E-USAGE", name, "a trace without a pack; name it with --pack")
            of = _from(require_file(pack), path.parent)
        else:
            keys, where, _ = load_scene(path.parent / name if name.endswith(".toml") else name)
            if keys["kind"] == "grasp":
                raise PalmarError("E-CONF", name, "is made for the object of a pack; script it and name the trace")
            case = cases_of(keys, where.name)[0][0]
        found += [(name, of, case, 0, solver, -1) for solver in solvers or ("progressive",)]
    return found


def _replay(
    folder: Path, base: Path, place: tuple[str, str, str, int, str, int]
) -> tuple[Run, AssetPack, str, list[str]]:
    """The run, its pack, the object, and what the scene is about."""
    scene, pack, case, start, solver, level = place
    if scene.endswith(".mcap"):
        trace, out = require_file(base / scene), folder / "trace.run.mcap"
        samples = read_trace(trace)
        name = object_of(samples, require_file(base / pack))
        replay_file(base / pack, trace, out, object_name=name, settings={"solver": solver, "level": level})
        run = read_run(out)
        return run, load_pack(base / pack), run.header["object"], ["wrong_side", "penetration_mesh"]
    keys, where, _ = load_scene(base / scene if scene.endswith(".toml") else scene)
    table = dict(cases_of(keys, where.name)).get(case)
    if table is None:
        raise PalmarError("E-GOLDEN", scene, f"has no case {case!r}")
    sampled = check_scene(table, where.name)
    assert isinstance(sampled, Sampled)
    path = folder / "object.pack"
    save_object(path, default_hand(), _object(json.dumps(sampled.object, sort_keys=True)))
    run = replay_case(folder, path, sampled, (where.stem, case, start), solver, {"level": level})
    return run, load_pack(path), "object", sampled.metrics


@lru_cache(maxsize=4)
def _object(table: str) -> Any:
    return scene_object(json.loads(table))


def _compare(expected: Sequence[GoldenRow], now: dict[tuple[str, str], dict[str, Any]]) -> list[dict[str, Any]]:
    failures = []
    for row in expected:
        found = now.get((row.metric, row.stat))
        value = None if found is None else float(found["value"])
        if value is None or abs(value - row.value) > row.tolerance:
            told = {name: getattr(row, name) for name in ("scene", "case", "solver", "metric", "stat", "unit")}
            failures.append({**told, "old": row.value, "new": value, "tolerance": row.tolerance})
    return failures


def _updated(
    place: tuple[str, str, str, int, str, int],
    expected: Sequence[GoldenRow],
    now: dict[tuple[str, str], dict[str, Any]],
    reason: str,
) -> tuple[list[GoldenRow], int]:
    """The rows of a replay as they are from now on, and how many changed."""
    if not expected:
        rows = [
            GoldenRow(*place, metric, stat, row["unit"], float(row["value"]), TOLERANCE, reason)
            for (metric, stat), row in now.items()
        ]
        return rows, len(rows)
    found, changed = [], 0
    for row in expected:
        new = now.get((row.metric, row.stat))
        if new is not None and abs(float(new["value"]) - row.value) <= row.tolerance:
            found.append(row)
            continue
        changed += 1
        if new is not None:
            found.append(replace(row, value=float(new["value"]), reason=reason))
    return found, changed


def _line(replay: dict[str, Any], failures: list[dict[str, Any]], *, new: bool) -> str:
    head = f"{replay['scene']:<24} {replay['solver']:<12}"
    if failures:
        return "\n".join(f"{head} FAILS {say_failure(failure)}" for failure in failures)
    said = f"new, {replay['numbers']} numbers" if new else f"the same {replay['numbers']} numbers"
    return "; but ".join([f"{head} {said}", *replay["changed_inputs"]])


def _of_hand(row: GoldenRow, said: str) -> dict[str, Any]:
    """What stands for a number of the hand that is not what it was."""
    told = {"scene": row.scene, "case": row.case, "solver": row.solver, "metric": said.partition(" ")[0], "stat": ""}
    return {**told, "unit": "", "old": None, "new": None, "tolerance": 0.0, "said": f"{said}; no golden number tells"}


def say_failure(failure: dict[str, Any]) -> str:
    """Metric, old, new, where they part and what is not the same."""
    if "said" in failure:
        return failure["said"]
    unit = "" if failure["unit"] == "1" else f" {failure['unit']}"
    new = "not measured" if failure["new"] is None else f"{failure['new']:.9g}"
    tolerance = f"(tolerance {failure['tolerance']:g})"
    said = f"{failure['metric']} {failure['stat']} was {failure['old']:.9g}{unit}, is {new} {tolerance}"
    step, beyond = failure.get("first_step"), failure.get("first_beyond")
    if step is not None:
        said += f"; first differing step {step}"
    if beyond is not None:
        said += f", beyond the tolerance from step {beyond}"
    return "; ".join([said, *failure.get("causes", [])])


class Trail:
    """What is kept of each golden replay beside its numbers, by place in the file."""

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(path.name + TRAIL) if path.suffix != ".csv" else path.with_suffix(TRAIL)
        self.arrays: dict[str, Any] = {}
        if self.path.is_file():
            try:
                with np.load(self.path) as kept:
                    self.arrays = {name: kept[name] for name in kept.files}
            except (ValueError, OSError, EOFError) as error:
                raise BadTrace("E-GOLDEN", str(self.path), f"cannot be read ({error}); --update writes it") from None

    def keep(self, place: tuple[Any, ...], run: Run, pack: AssetPack, name: str, series: dict[str, Any]) -> None:
        head = "|".join(map(str, place))
        self.arrays = {key: value for key, value in self.arrays.items() if not key.startswith(f"{head}|")}
        parts = {"answers": answers(run), "asked": asked(run), "settings": np.array(run.header.get("settings", ""))}
        parts |= {f"series|{metric}": values.astype(np.float32) for metric, values in series.items()}
        parts |= {f"inputs|{key}": value for key, value in inputs(pack, name, _level(run)).items()}
        self.arrays |= {f"{head}|{key}": value for key, value in parts.items()}

    def changed(self, place: tuple[Any, ...], run: Run, pack: AssetPack, name: str) -> list[str]:
        """What of hand, object, input and settings is not what it was, a line each."""
        kept = self._of(place)
        if not kept:
            return []
        before = {key.removeprefix("inputs|"): value for key, value in kept.items() if key.startswith("inputs|")}
        lines = what_differs(before, inputs(pack, name, _level(run)))
        step = first_different(kept["asked"], asked(run))
        lines += [f"the haptic hand or the object's place differs from step {step} on"] if step is not None else []
        return lines + (["the settings differ"] if str(kept["settings"]) != run.header.get("settings", "") else [])

    def where(
        self, place: tuple[Any, ...], run: Run, pack: AssetPack, name: str, series: dict[str, Any]
    ) -> Callable[[str, float], dict[str, Any]]:
        """Of a metric: first_step whose answer is another, first_beyond the tolerance, causes in the inputs."""
        kept = self._of(place)
        if not kept:
            return lambda metric, tolerance: {"causes": ["no trail of it is kept"]}
        causes = self.changed(place, run, pack, name) or ["hand, object, input and settings are the same"]
        first = first_different(kept["answers"], answers(run))

        def of(metric: str, tolerance: float) -> dict[str, Any]:
            old, new = kept.get(f"series|{metric}"), series.get(metric)
            both = old is not None and new is not None
            beyond = first_different(old, new.astype(np.float32), tolerance) if both else None  # type: ignore
            return {"first_step": first, "first_beyond": beyond, "causes": causes}

        return of

    def _of(self, place: tuple[Any, ...]) -> dict[str, Any]:
        head = "|".join(map(str, place)) + "|"
        return {key.removeprefix(head): value for key, value in self.arrays.items() if key.startswith(head)}

    def write(self) -> None:
        out = io.BytesIO()
        np.savez_compressed(out, **self.arrays)
        write_whole(self.path, out.getvalue())


def _level(run: Run) -> int:
    return int(run.header.get("level", -1))
