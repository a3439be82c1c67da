"""Models on trial for `palmar tune`: each replayed on each trace, judged beside the full model, and kept in a file."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from palmar import _runtime
from palmar.eval.tuned import Held, Values, broken, combined, judge_answer, judge_place
from palmar.files import sha256_of
from palmar.model import load_pack, write_whole
from palmar.records import read_run
from palmar.replay import replay_file

Progress = Callable[[str, float], None]

CELL_SCHEMA = "palmar.tune-cell/1"


@dataclass(frozen=True)
class Model:
    """A pack's object with settings."""

    pack: Path
    spheres: int
    settings: dict[str, Any]


@dataclass(frozen=True)
class Bench:
    """What every trial shares: the object's name, the full model, where cells and full runs are, and who works."""

    name: str
    full: Model
    folder: Path
    pool: ProcessPoolExecutor | None  # None: in this process

    def full_run(self, trace: Path) -> Path:
        """The full model's run of a trace, replayed once."""
        path = self.folder / f"{_key('full', self.full, trace, self.name)}.run.mcap"
        if not path.is_file():
            replay_file(self.full.pack, trace, path, object_name=self.name, settings=self.full.settings)
        return path


@dataclass(frozen=True)
class Trial:
    """A model judged on traces, in their order; on fewer of them where an earlier one broke a limit."""

    model: Model
    values: Values  # of `combined`
    operations: dict[str, float]  # means over the traces of a step's mean and p99, and the largest of all
    broken: list[Held]
    trace: str = ""  # that broke them


def try_model(
    bench: Bench,
    model: Model,
    traces: Sequence[Path],
    rows: Sequence[Held] = (),
    tell: Callable[[int], None] = lambda done: None,
) -> Trial:
    """Judge a model on traces, one after the other up to the first that breaks any of the rows' limits.

    What needs no distances first, on all traces: it takes a twentieth of the time.
    """
    trial = try_answer(bench, model, traces, rows)
    return trial if trial.broken else try_place(bench, trial, traces, rows, tell)


def try_answer(bench: Bench, model: Model, traces: Sequence[Path], rows: Sequence[Held] = ()) -> Trial:
    """The part of a trial that needs no distances, on all traces."""
    cells = [_answer_of(bench, model, trace) for trace in traces]
    values = combined([cell["values"] for cell in cells])
    operations = {stat: sum(cell["operations"][stat] for cell in cells) / len(cells) for stat in ("mean", "p99")}
    operations["max"] = max(cell["operations"]["max"] for cell in cells)
    return Trial(model, values, operations, broken(rows, values), "all traces")


def try_place(
    bench: Bench,
    trial: Trial,
    traces: Sequence[Path],
    rows: Sequence[Held] = (),
    tell: Callable[[int], None] = lambda done: None,
) -> Trial:
    """The rest of a trial, up to the first trace that breaks any of the rows' limits."""
    arguments = [
        (trial.model, trace, bench.name, bench.folder / f"{_key('place', trial.model, trace, bench.name)}.json")
        for trace in traces
    ]
    answers = [] if bench.pool is None else [bench.pool.submit(place_of, *each) for each in arguments]
    values = []
    for number, each in enumerate(arguments):
        values.append((place_of(*each) if not answers else answers[number].result())["values"])
        tell(number + 1)
        found = broken(rows, values[-1])
        if found:
            for later in answers[number + 1 :]:
                later.cancel()
            return replace(trial, values=trial.values | _known(values), broken=found, trace=traces[number].name)
    return replace(trial, values=trial.values | _known(values), broken=[], trace="")


def _known(values: Sequence[Values]) -> Values:
    return {name: value for name, value in combined(values).items() if value is not None}


def _answer_of(bench: Bench, model: Model, trace: Path) -> dict[str, Any]:
    """The cell of one answer, worked out if it is not there."""
    cell = bench.folder / f"{_key('answer', model, trace, bench.name)}.json"
    if cell.is_file():
        return _kept(cell)
    full = read_run(bench.full_run(trace))
    with tempfile.TemporaryDirectory(prefix="palmar-tune-") as place:
        run = replay_to(model, trace, bench.name, Path(place) / "cell.run.mcap")
    return _keep(cell, model, trace, judge_answer(run, full, load_pack(model.pack)))


def place_of(model: Model, trace: Path, name: str, cell: Path) -> dict[str, Any]:
    """The cell of what needs distances, worked out if it is not there."""
    if cell.is_file():
        return _kept(cell)
    with tempfile.TemporaryDirectory(prefix="palmar-tune-") as place:
        run = replay_to(model, trace, name, Path(place) / "cell.run.mcap")
    return _keep(cell, model, trace, judge_place(run, load_pack(model.pack), name))


def _kept(cell: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(cell.read_text())["judged"]
    return found


def _keep(cell: Path, model: Model, trace: Path, judged: dict[str, Any]) -> dict[str, Any]:
    told = {"schema": CELL_SCHEMA, "pack": model.pack.name, "trace": trace.name, "settings": model.settings}
    write_whole(cell, json.dumps({**told, "judged": judged}, indent=1).encode())
    return judged


def replay_to(model: Model, trace: Path, name: str, out: Path) -> Any:
    """The run of a model on a trace, written to a file."""
    replay_file(model.pack, trace, out, object_name=name, settings=model.settings)
    return read_run(out)


def _key(kind: str, model: Model, trace: Path, name: str) -> str:
    """A name that changes with whatever the answer depends on."""
    core, pack, samples = _hash(Path(_runtime.__file__)), _hash(model.pack), _hash(trace)
    told = json.dumps([CELL_SCHEMA, kind, core, pack, samples, name, model.settings], sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()[:24]


@cache
def _hash_at(path: Path, changed_ns: int) -> str:
    return sha256_of(path)


def _hash(path: Path) -> str:
    return _hash_at(path, path.stat().st_mtime_ns)
