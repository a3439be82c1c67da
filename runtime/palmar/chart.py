"""The `chart` verb: solvers x levels x qualities on the same traces, judged on all cores, then timed on one, alone.

The result of each replay is kept in a file of its own under `cells`, so that a chart that was stopped, or that is asked
for again with more, takes up what is there.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from palmar import _runtime
from palmar.chart_inputs import Scene, find_scenes
from palmar.eval.chart import CLOCKS, Cell, by_contacts, by_fingers, chart_csv, dots, judge, lead
from palmar.files import require_own_folder, sha256_of
from palmar.model import load_pack, write_whole
from palmar.noise import kernel, noise_note
from palmar.records import read_run
from palmar.replay import machine, replay_file
from palmar.workers import workers

Progress = Callable[[str, float], None]

CHART_SCHEMA = "palmar.chart/1"
PRODUCT = "progressive"
MOST_FACTOR = 2.5  # a level may have so many times more or fewer spheres than asked for
FINGERS_AT = 3000  # spheres of the level that the cost of fingers is measured at
RESULTS = {"index.html", "chart.csv", "chart.json", "figures", "cells", "made"}


@dataclass(frozen=True)
class Asked:
    """What a chart is to compare."""

    solvers: tuple[str, ...]
    spheres: tuple[int, ...]
    qualities: dict[str, list[dict[str, Any]]] = field(default_factory=dict)  # of a solver, beside its defaults
    repeats: int = 3
    seed: int = 0
    jobs: int = 1


@dataclass(frozen=True)
class Job:
    """One replay of the grid."""

    pack: str
    trace: str
    object: str
    name: str  # of object and trace
    number: int  # of the level in the tree
    level: int  # spheres asked for
    spheres: int
    solver: str
    settings: dict[str, Any]
    in_use: str

    @property
    def quality(self) -> str:
        return " ".join(f"{key}={value}" for key, value in self.settings.items())


def make_chart(
    files: Sequence[Path],
    out: Path,
    asked: Asked,
    *,
    shapes: Sequence[str] = (),
    grasps: int = 1,
    fingers: bool = True,
    progress: Progress = lambda text, fraction: None,
) -> dict[str, Any]:
    """Compare solvers on traces and write the folder: index.html, chart.csv, chart.json, figures, cells, made.

    files: packs and traces; shapes: built-in objects; see `find_scenes`. Returns page, sentence, note, cells, dots.
    Raises PalmarError, BadPack, BadTrace; what was measured until then stays in `cells`.
    """
    from palmar.eval.chart_figures import write_figures
    from palmar.eval.chart_page import build_page, told

    require_own_folder(out, RESULTS, "chart")
    out.mkdir(parents=True, exist_ok=True)
    scenes = find_scenes(
        files,
        shapes,
        spheres=asked.spheres,
        grasps=grasps,
        fingers=fingers,
        made=out / "made",
        progress=progress,
    )
    jobs = jobs_of(scenes, asked)
    for settings in {json.dumps(job.settings | {"solver": job.solver}): job for job in jobs}.values():
        check_settings(settings)
    cells, measured = run_jobs(jobs, asked, out / "cells", progress)
    first = PRODUCT if PRODUCT in asked.solvers else asked.solvers[0]
    found, contacts, in_use = dots(cells, first), by_contacts(cells), by_fingers(cells)
    sentence, note = lead(found, first), noise_note(measured["kernels"])
    about = _about(scenes, jobs, asked, measured)
    page = build_page(found, contacts, in_use, product=first, sentence=sentence, note=note, about=about)
    write_whole(out / "index.html", page.encode())
    write_whole(out / "chart.csv", chart_csv(found).encode())
    answer = {"schema": CHART_SCHEMA, "sentence": sentence, "note": note, "about": about}
    answer |= {"dots": [told(dot) for dot in found], "contacts": contacts, "fingers": in_use}
    write_whole(out / "chart.json", json.dumps(answer, indent=1, allow_nan=False).encode())
    (out / "figures").mkdir(exist_ok=True)
    write_figures(found, contacts, in_use, first, out / "figures")
    return {"page": str(out / "index.html"), "cells": len(cells), **answer}


def _about(scenes: Sequence[Scene], jobs: Sequence[Job], asked: Asked, measured: dict[str, Any]) -> dict[str, str]:
    """What a page says of how its numbers came about."""
    kernels = measured["kernels"]
    build = _runtime.build_info()
    grid = [scene.name for scene in scenes if not scene.in_use]
    return {
        "traces": "; ".join(grid),
        "levels": ", ".join(f"{n:,}" for n in asked.spheres) + " spheres, or the level of a pack nearest to that",
        "replays": f"{len(jobs)}, those of the grid judged once, each timed {asked.repeats} times, in an order drawn "
        f"anew each time (seed {asked.seed}), one after the other on one core, in {measured['sittings']} sittings",
        "times": f"thread CPU time of a step, of the steps in which {PRODUCT} touches; wall time stands in chart.csv. "
        "The first steps of a replay are in it.",
        "failed steps": "a link on the wrong side of the true surface, the pose of the step before kept, or more than "
        "1 mm inside the spheres",
        "depths": "of the exact hand over every step, the deepest of all traces; judged without the solver's code",
        "calibration": "a fixed piece of work took at least "
        + ", ".join(f"{k['least_us']:.0f}" for k in kernels)
        + " us before, between and after the repeats; wall by CPU time "
        + ", ".join(f"{k['wall_by_cpu']:.2f}" for k in kernels),
        "not measured": "threads: a step has one; other devices' latency; the time to read and write files",
        "machine": ", ".join(f"{key} {value}" for key, value in machine().items()),
        "build": ", ".join(f"{key} {value}" for key, value in sorted(build.items())),
        "packs": "; ".join(f"{path.name} {sha256_of(path)[:16]}" for path in dict.fromkeys(s.pack for s in scenes)),
    }


def check_settings(job: Job) -> None:
    """Raise PalmarError for a setting that the core does not know, before hours of work."""
    _runtime.Session(job.pack, job.object, {**job.settings, "solver": job.solver, "level": job.number})


def jobs_of(scenes: Sequence[Scene], asked: Asked) -> list[Job]:
    """Every replay of the grid, and those that the cost of fingers is read from."""
    jobs = []
    for scene in scenes:
        counts = [len(level) for level in load_pack(scene.pack).objects[scene.object].levels]
        wanted = (min(asked.spheres, key=lambda n: abs(math.log(n / FINGERS_AT))),) if scene.in_use else asked.spheres
        for level, number in levels_for(counts, wanted).items():
            for solver in asked.solvers:
                for settings in [{}, *([] if scene.in_use else asked.qualities.get(solver, []))]:
                    jobs.append(
                        Job(
                            pack=str(scene.pack),
                            trace=str(scene.trace),
                            object=scene.object,
                            name=scene.name,
                            number=number,
                            level=level,
                            spheres=counts[number],
                            solver=solver,
                            settings=settings,
                            in_use=scene.in_use,
                        )
                    )
    return jobs


def levels_for(counts: Sequence[int], wanted: Sequence[int]) -> dict[int, int]:
    """Spheres asked for -> the level nearest to it by ratio, none twice, none farther than MOST_FACTOR.

    Where no level is near enough the finest stands for the count that is nearest to it.
    """

    def apart(count: int, asked: int) -> float:
        return abs(math.log(count / asked))

    pairs = sorted((apart(count, asked), asked, number) for number, count in enumerate(counts) for asked in wanted)
    found: dict[int, int] = {}
    for distance, asked, number in pairs:
        if distance <= math.log(MOST_FACTOR) and asked not in found and number not in found.values():
            found[asked] = number
    if not found:
        found[min(wanted, key=lambda asked: apart(counts[-1], asked))] = len(counts) - 1
    return dict(sorted(found.items()))


def run_jobs(jobs: Sequence[Job], asked: Asked, folder: Path, progress: Progress) -> tuple[list[Cell], dict[str, Any]]:
    """Judge and time what is not in `folder` yet; the cells, and what was found of the machine meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = keys_of(jobs)
    _judge_all(jobs, keys, asked.jobs, folder, lambda text, part: progress(text, 0.6 * part))
    kernels = time_all(jobs, keys, asked, folder, lambda text, part: progress(text, 0.6 + 0.4 * part))
    cells = [_read(job, folder / key) for job, key in zip(jobs, keys, strict=True)]
    return cells, kernels


def keys_of(jobs: Sequence[Job]) -> list[str]:
    """A name for each replay that changes with whatever its answer depends on."""
    hashes = {path: sha256_of(Path(path)) for job in jobs for path in (job.pack, job.trace)}
    core = sha256_of(Path(_runtime.__file__))
    names = []
    for job in jobs:
        told = [core, hashes[job.pack], hashes[job.trace], job.object, job.number, job.solver, job.settings]
        names.append(hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:24])
    return names


def _judge_all(jobs: Sequence[Job], keys: Sequence[str], count: int, folder: Path, progress: Progress) -> None:
    todo = {
        key: job
        for job, key in zip(jobs, keys, strict=True)
        if not job.in_use and not (folder / f"{key}.json").is_file()
    }
    if not todo:
        return
    with workers(min(count, len(todo))) as pool:
        waiting = {pool.submit(judge_job, job): key for key, job in todo.items()}
        for done, answer in enumerate(as_completed(waiting)):
            key = waiting[answer]
            write_whole(folder / f"{key}.json", json.dumps(answer.result(), indent=1).encode())
            progress(f"judged {todo[key].solver} {todo[key].level} {todo[key].name}", (done + 1) / len(todo))


def judge_job(job: Job) -> dict[str, Any]:
    """Replay and judge one cell: what stands in its file."""
    with tempfile.TemporaryDirectory(prefix="palmar-chart-") as place:
        run = _replay(job, Path(place))
        pack = load_pack(job.pack)
        told = {**asdict(job), "pack": Path(job.pack).name, "trace": Path(job.trace).name}
        return {"schema": "palmar.cell/1", "job": told, "judged": judge(run, pack, job.object)}


def time_all(
    jobs: Sequence[Job], keys: Sequence[str], asked: Asked, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Time every cell so often, in an order drawn anew for each repeat; the machine's own noise beside."""
    path = folder / "machine.json"
    told: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {"kernels": [], "sittings": 0}
    job_of = dict(zip(keys, jobs, strict=True))
    todo = [(repeat, key) for repeat in range(asked.repeats) for key in job_of if repeat >= _repeats(folder / key)]
    if not todo:
        return told
    told["sittings"] += 1
    kernel()  # the first is warm-up
    told["kernels"].append(kernel())
    done = 0
    with tempfile.TemporaryDirectory(prefix="palmar-chart-") as place:
        for repeat in range(asked.repeats):
            of_repeat = [key for number, key in todo if number == repeat]
            for k in np.random.default_rng([asked.seed, repeat]).permutation(len(of_repeat)):
                key = of_repeat[k]
                run = _replay(job_of[key], Path(place))
                times = {clock: getattr(run, clock).astype(np.float32)[None] for clock in CLOCKS}
                _keep(folder / key, times, run.contacts.astype(np.uint16))
                done += 1
                progress(f"timed {job_of[key].solver} {job_of[key].level} {job_of[key].name}", done / len(todo))
            told["kernels"].append(kernel())
            write_whole(path, json.dumps(told, indent=1).encode())
    return told


def _replay(job: Job, place: Path) -> Any:
    out = place / "cell.run.mcap"
    settings = {**job.settings, "solver": job.solver, "level": job.number}
    replay_file(Path(job.pack), Path(job.trace), out, object_name=job.object, settings=settings)
    return read_run(out)


def _repeats(stem: Path) -> int:
    path = stem.with_suffix(".npz")
    if not path.is_file():
        return 0
    with np.load(path) as kept:
        return len(kept[CLOCKS[0]])


def _keep(stem: Path, times: dict[str, Any], contacts: Any) -> None:
    """Add one repeat to a cell's times."""
    path = stem.with_suffix(".npz")
    if path.is_file():
        with np.load(path) as kept:
            times = {clock: np.concatenate([kept[clock], times[clock]]) for clock in CLOCKS}
    out = io.BytesIO()
    np.savez_compressed(out, contacts=contacts, **times)
    write_whole(path, out.getvalue())


def read_times(stem: Path) -> tuple[dict[str, Any], Any]:
    """What `time_all` kept of a cell: CLOCKS -> (repeats, n) us, and contacts (n,)."""
    with np.load(stem.with_suffix(".npz")) as kept:
        return {clock: kept[clock].astype(np.float64) for clock in CLOCKS}, kept["contacts"].astype(np.int64)


def _read(job: Job, stem: Path) -> Cell:
    judged = {} if job.in_use else json.loads(stem.with_suffix(".json").read_text())["judged"]
    times, contacts = read_times(stem)
    place = job.name, job.level, job.spheres, job.solver, job.quality, job.in_use
    return Cell(*place, judged, times, contacts)
