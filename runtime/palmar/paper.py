"""The paper's experiments once more: `palmar report --paper`. It knows all stages.

Packs and traces stay in the folder `made`, and are taken up again when the same is asked for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from palmar import _runtime
from palmar.errors import PalmarError
from palmar.files import require_file, require_own_folder, sha256_of, stem_of
from palmar.model import load_pack, write_whole
from palmar.noise import kernel, noise_note
from palmar.records import Trace, read_run, read_trace, write_trace
from palmar.replay import machine, object_of, replay_file

Progress = Callable[[str, float], None]

PAPER_SCHEMA = "palmar.paper/1"
OF_A_PAPER = {"index.html", "paper.json", "figures", "made"}
# Leaves of each object, as in the paper: "more than 500" of simple shapes, and its counts of complex ones. `ears`
# stands for its bunny; a teapot is not among the built-in objects.
SIMPLE = {"sphere": 512, "cylinder": 512, "triangular_prism": 512, "cube": 512, "hexagonal_prism": 512}
COMPLEX = {"rock": 3089, "shamrock": 3511, "cup": 4047, "ears": 2896}
BEHAVIOURS = {"touch": "one finger", "pinch": "two fingers", "grasp": "five and palm"}  # scene -> row of Fig. 11
IN_TURN = ("cylinder", "hexagonal_prism")  # of Fig. 12
IN_TURN_SCENE, STATES_SCENE, SWITCH_SCENE = "five_finger_grasp", "squeeze_hold_slide", "ear_switch"
NOISE = {"position_m": 2e-5, "joint_rad": 1.7e-4}  # of a sensor: 0.02 mm, 0.01 degrees


def make_paper(
    files: Sequence[Path],
    out: Path,
    *,
    repeats: int = 3,
    seed: int = 0,
    progress: Progress = lambda text, fraction: None,
) -> dict[str, Any]:
    """Replay the paper's experiments and write figures, the numbers behind them, its table V.D, and a page.

    files: packs whose objects take the place of the complex ones, and traces of theirs, which take the place of the
    scripted one; see `_complex`. repeats: timed replays of each; the least time of a step counts. Returns page,
    figures, table, note. Raises PalmarError, BadPack, BadTrace.
    """
    from palmar.eval.paper_page import write_paper

    require_own_folder(out, OF_A_PAPER, "paper's figures")
    for path in files:
        if require_file(path).suffix not in (".pack", ".mcap"):
            raise PalmarError("E-USAGE", str(path), "is neither a .pack nor a .mcap")
    if files and not any(path.suffix == ".pack" for path in files):
        raise PalmarError("E-USAGE", str(files[0]), "a trace without a pack; name the pack of its object too")
    made = out / "made"
    made.mkdir(parents=True, exist_ok=True)
    packs = {
        name: _build(name, count, seed, made, lambda t, f: progress(t, 0.12 * f)) for name, count in SIMPLE.items()
    }
    complex_packs, given = _complex(files, seed, made, lambda text, part: progress(text, 0.12 + 0.28 * part))
    jobs = _jobs(packs, complex_packs, given, seed, made, lambda text, part: progress(text, 0.4 + 0.15 * part))
    runs, kernels = _replay_all(jobs, made, repeats, seed, lambda text, part: progress(text, 0.55 + 0.25 * part))
    note = noise_note(kernels)
    asked = f"each {repeats} times, in an order drawn anew each time (seed {seed})"
    about = _about(jobs, kernels, json.loads(runs[0][0].header["settings"]), asked)
    assets = {path: load_pack(path) for path in {job["pack"] for job in jobs}}
    told = [
        {**job, "assets": assets[job["pack"]], "run": run, "times_us": times}
        for job, (run, times) in zip(jobs, runs, strict=True)
    ]
    answer = write_paper(told, out, note, about, lambda text, part: progress(text, 0.8 + 0.2 * part))
    write_whole(out / "paper.json", json.dumps({"schema": PAPER_SCHEMA, **answer}, indent=1, allow_nan=False).encode())
    return {"page": str(out / "index.html"), **answer}


def _build(shape: str, spheres: int, seed: int, made: Path, progress: Progress) -> Path:
    from palmar.tools.pack import build

    path = made / f"{shape}-{spheres}-{seed}.pack"
    if not path.is_file():
        build([f"shape:{shape}"], path, spheres=spheres, seed=seed, progress=progress)
    return path


def _complex(
    files: Sequence[Path], seed: int, made: Path, progress: Progress
) -> tuple[dict[str, Path], dict[str, list[Path]]]:
    """Pack of each complex object, and the traces given of it: those of `files`, else the built-in ones."""
    packs = [path for path in files if path.suffix == ".pack"]
    traces = [path for path in files if path.suffix == ".mcap"]
    if not packs:
        found = {}
        for number, (name, count) in enumerate(COMPLEX.items()):
            progress(f"build {name}", number / len(COMPLEX))
            found[name] = _build(name, count, seed, made, lambda text, part: None)
        return found, {}
    found = {name: path for path in packs for name in load_pack(path).objects}
    given: dict[str, list[Path]] = {}
    for trace in traces:
        samples = read_trace(trace)
        names = {object_of(samples, path) for path in packs} - {""} or set(found)
        if len(names) != 1:
            raise PalmarError("E-OBJECT", str(trace), f"fits {', '.join(sorted(found))}; it has to name one of them")
        given.setdefault(names.pop(), []).append(trace)
    return found, given


def _jobs(
    simple: dict[str, Path],
    complex_packs: dict[str, Path],
    given: dict[str, list[Path]],
    seed: int,
    made: Path,
    progress: Progress,
) -> list[dict[str, Any]]:
    """Every replay: figure, object, pack, trace and what it is called."""
    from palmar.traces.fingers import IN_USE
    from palmar.traces.in_turn import in_turn, shaken

    jobs: list[dict[str, Any]] = []

    def add(figure: str, name: str, pack: Path, trace: Path, label: str) -> None:
        jobs.append({"figure": figure, "object": name, "pack": pack, "trace": trace, "label": label})
        progress(f"{name} {label}", min(0.99, len(jobs) / 45))

    for name, pack in simple.items():
        for scene, label in BEHAVIOURS.items():
            add("11", name, pack, _script(scene, pack, name, seed, made), label)
        if name in IN_TURN:
            whole = _script(IN_TURN_SCENE, pack, name, seed, made)
            add("12", name, pack, _derive(whole, "in-turn", made, in_turn), "fingers in turn")
    for name, pack in complex_packs.items():
        whole = _script(STATES_SCENE, pack, name, seed, made)
        for trace in given.get(name, [whole]):
            add("13", name, pack, trace, "squeeze, hold, slide" if trace == whole else stem_of(trace))
        noisy = _derive(whole, "noise", made, lambda trace: shaken(trace, seed=seed, **NOISE))
        add("V.D", name, pack, noisy, "with sensor noise")
        for label, used in IN_USE.items():
            add("15", name, pack, _derive(whole, label.replace(" ", "-"), made, partial(_part, used)), label)
    if "ears" in complex_packs and not given.get("ears"):
        pack = complex_packs["ears"]
        add("13", "ears", pack, _script(SWITCH_SCENE, pack, "ears", seed, made), "switch of contact")
    return jobs


def _part(used: tuple[tuple[str, ...], bool], whole: Trace) -> Trace:
    from palmar.traces.fingers import with_fingers

    return with_fingers(whole, *used)


def _script(scene: str, pack: Path, name: str, seed: int, made: Path) -> Path:
    from palmar.traces.scripted import script

    path = made / f"{stem_of(pack)}-{name}-{load_pack(pack).sha256[:8]}-{scene}-{seed}.mcap"
    if not path.is_file():
        script(scene, pack, path, object=name, seed=seed)
    return path


def _derive(whole: Path, ending: str, made: Path, change: Callable[[Any], Any]) -> Path:
    path = made / f"{stem_of(whole)}-{ending}.mcap"
    if not path.is_file():
        trace = change(read_trace(whole))
        write_trace(path, replace(trace, header=trace.header | {"derived": ending}))
    return path


def _replay_all(
    jobs: Sequence[dict[str, Any]], made: Path, repeats: int, seed: int, progress: Progress
) -> tuple[list[tuple[Any, dict[str, Any]]], list[dict[str, float]]]:
    """Each job's run and the least of its times, all of them once in each repeat, in an order drawn anew."""
    kernel()  # the first is warm-up
    kernels = [kernel()]
    found: list[tuple[Any, dict[str, Any]] | None] = [None] * len(jobs)
    for repeat in range(repeats):
        for done, k in enumerate(np.random.default_rng([seed, repeat]).permutation(len(jobs))):
            job, out = jobs[k], made / f"{k:02d}-{stem_of(jobs[k]['trace'])}.run.mcap"
            progress(
                f"replay {repeat + 1}/{repeats}: {job['object']} {job['label']}", (repeat + done / len(jobs)) / repeats
            )
            replay_file(job["pack"], job["trace"], out, object_name=job["object"])
            run = read_run(out)
            now = {clock: getattr(run, clock) for clock in ("cpu_us", "search_us", "solve_us", "verify_us")}
            before = found[k]
            least = now if before is None else {clock: np.minimum(before[1][clock], now[clock]) for clock in now}
            found[k] = (run, least)
        kernels.append(kernel())
    return [each for each in found if each is not None], kernels


def _about(
    jobs: Sequence[dict[str, Any]], kernels: Sequence[dict[str, float]], settings: dict[str, Any], asked: str
) -> dict[str, str]:
    """What the page says of how its numbers came about."""
    packs = dict.fromkeys(job["pack"] for job in jobs)
    return {
        "replays": f"{len(jobs)}, {asked}, one after the other on one core",
        "times": "of each step the least thread CPU time of its repeats; the first steps of a replay are in it",
        "calibration": "a fixed piece of work took at least "
        + ", ".join(f"{k['least_us']:.0f}" for k in kernels)
        + " us before, between and after the repeats; wall by CPU time "
        + ", ".join(f"{k['wall_by_cpu']:.2f}" for k in kernels),
        "sensor noise": f"white, {1e3 * NOISE['position_m']:g} mm on each coordinate of the palm and "
        f"{np.degrees(NOISE['joint_rad']):.2g} degrees on each flexion, in the rows of the table that say so",
        "not measured": "several threads (a step has one); a glove in a person's hand, whose motion would answer "
        "the force; the device's "
        "and the display's latency",
        "settings": ", ".join(f"{key} {value}" for key, value in sorted(settings.items())),
        "machine": ", ".join(f"{key} {value}" for key, value in machine().items()),
        "build": ", ".join(f"{key} {value}" for key, value in sorted(_runtime.build_info().items())),
        "packs": "; ".join(f"{path.name} {sha256_of(path)[:16]}" for path in packs),
        "traces": "; ".join(f"{path.name} {sha256_of(path)[:16]}" for path in {job["trace"]: None for job in jobs}),
    }
