"""The `check` verb: scenes -> objects, traces, runs, and whether every limit holds. It knows all stages, as `demo`."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from palmar.errors import PalmarError
from palmar.eval.case import Case
from palmar.eval.matrix import moment, write_matrix
from palmar.eval.metrics import margin_db, measure, worst_margin
from palmar.eval.table import METRICS
from palmar.files import nearest
from palmar.model import AssetPack, HandModel, SphereTree, load_pack, save_pack, write_whole
from palmar.records import Run, Trace, read_run, read_trace, write_trace
from palmar.replay import replay_file
from palmar.tools.hand_file import default_hand
from palmar.tools.lattice import scene_object
from palmar.traces.actuator import Actuator, Feedback
from palmar.traces.keyframes import key_trace
from palmar.traces.opengloves import FORCE_FULL_SCALE
from palmar.traces.scene_file import Played, Sampled, cases_of, check_scene
from palmar.traces.scripted import SCENES, load_scene

FELT_N = 0.05  # a force below it says nothing of a contact
CHECK_SCHEMA = "palmar.check/1"
QUICK_STARTS = 2
ALWAYS = ("penetration_spheres", "frozen_steps")  # the metrics that every scene is about

Row = dict[str, Any]


@dataclass
class Tally:
    """What the replays of one scene by one solver came to."""

    scene: str
    id: str
    solver: str
    runs: int = 0
    steps: int = 0
    failed: int = 0
    margin_db: float = float("inf")
    worst: Row | None = None  # the row that sets the margin, with its case and start
    fails: dict[str, Row] = field(default_factory=dict)  # METRIC STAT -> its worst row, with the number of runs
    figures: dict[str, float] = field(default_factory=dict)  # METRIC STAT -> the largest value
    contact_steps: dict[str, int] = field(default_factory=dict)  # of each case
    end_force_n: list[list[float]] = field(default_factory=list)  # of each run, the last on each fingertip
    end_palm_m: list[list[float]] = field(default_factory=list)  # of each run, the last place of the palm shown
    why: str = ""
    moment: Row | None = None  # of the run that set the margin, if a matrix is to be drawn

    @property
    def passed(self) -> bool:
        return self.worst is not None and not self.fails and not self.untouched

    @property
    def untouched(self) -> list[str]:
        """Cases in which the hand never met the object: they would show nothing."""
        return [case for case, steps in self.contact_steps.items() if not steps]

    def see(self, run: Run, case: str) -> None:
        """Count a run's steps and contacts, whatever its metrics say."""
        self.runs, self.steps = self.runs + 1, self.steps + len(run.time_s)
        # A solver may report no contact where it sinks in; a force then still tells that the hand was stopped.
        force_n = np.linalg.norm(np.hstack([run.fingertip_force_n.reshape(-1, 15), run.palm_force_n]), axis=1)
        met = (run.contacts > 0) | (force_n > FELT_N)
        self.contact_steps[case] = self.contact_steps.get(case, 0) + int(met.sum())
        self.end_force_n.append(np.linalg.norm(run.fingertip_force_n[-1], axis=1).tolist())
        self.end_palm_m.append(run.palm_position_m[-1].tolist())

    def compare_ends(self, force_limit_n: float | None, place_limit_m: float | None) -> None:
        """Add how far the last forces and places of the runs are from those of the first, where there is a limit."""
        if force_limit_n is not None:
            spread = float(np.abs(np.array(self.end_force_n) - self.end_force_n[0]).max())
            self.take(
                [_row("end_force_spread", "N", spread, force_limit_n)], "all cases", 0, ["end_force_spread value"]
            )
        if place_limit_m is not None:
            apart_m = np.linalg.norm(np.array(self.end_palm_m) - self.end_palm_m[0], axis=1).max()
            row = _row("end_place_spread", "mm", 1e3 * float(apart_m), 1e3 * place_limit_m)
            self.take([row], "all cases", 0, ["end_place_spread value"])

    def take(self, rows: list[Row], case: str, start: int, asked: Sequence[str]) -> bool:
        """Add the rows of one run; whether it set a new worst margin."""
        at = {"case": case, "start": start}
        above = [row for row in rows if row["limit"] is not None and row["value"] > row["limit"]]
        self.failed += bool(above)
        for row in above:
            name = f"{row['metric']} {row['stat']}"
            before = self.fails.get(name)
            worse = before is None or row["value"] / max(row["limit"], 1e-9) > before["value"] / max(
                before["limit"], 1e-9
            )
            runs = before["runs"] + 1 if before else 1
            self.fails[name] = {**({**row, **at} if before is None or worse else before), "runs": runs}
        for row in rows:
            name = f"{row['metric']} {row['stat']}"
            if name in asked and row["value"] is not None:
                self.figures[name] = max(row["value"], self.figures.get(name, row["value"]))
        score = worst_margin(rows)
        if score is None:
            return False
        # Of two margins without bound the larger value is the worse.
        if self.worst is not None and (score[0], -score[1]["value"]) >= (self.margin_db, -self.worst["value"]):
            return False
        self.margin_db, self.worst = score[0], {**score[1], **at}
        return True

    def line(self) -> str:
        """One line for a person: what held by how much, or what failed where."""
        touched = sum(self.contact_steps.values()) / max(self.steps, 1)
        head = f"{self.id:<4} {self.scene:<20} {self.solver:<12} {self.runs:>4} runs, {touched:>3.0%} contact "
        if self.worst is None:
            return f"{head} nothing that has a limit could be measured"
        parts = [_say_fail(name, row) for name, row in self.fails.items()]
        if self.untouched:
            parts.append(f"no contact in {len(self.untouched)} cases ({self.untouched[0]})")
        if parts:
            said = f"FAILS {self.failed}: " + "; ".join(parts)
        else:
            said = f"{_decibels(self.margin_db)} {self.worst['metric']} {self.worst['stat']} {_say_value(self.worst)}"
        shown = ", ".join(f"{name} {value:.4g}" for name, value in self.figures.items())
        return f"{head} {said}{f' | {shown}' if shown else ''}"


def check_scenes(
    scenes: Sequence[str],
    *,
    solvers: Sequence[str] = ("progressive",),
    settings: dict[str, Any] | None = None,
    quick: bool = False,
    out: Path | None = None,
    runs: bool = False,
    progress: Callable[[str, float], None] = lambda text, fraction: None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Replay every case and start of every scene by every solver and judge each run; one run is held at a time.

    scenes: names or TOML files; none for all of the suite. settings go over those of the scenes. quick: the first case
    and two starts. out: a folder for check.json and the matrix of scenes and solvers, whose cells open the worst
    moment; runs: keep there the pack, trace and run of each cell's worst margin too.
    Returns schema, passed, scenes. Raises PalmarError, BadPack, BadTrace.
    """
    names = list(scenes) or suite()
    loaded = [load_scene(name) for name in names]
    for (keys, where, _), name in zip(loaded, names, strict=True):
        if keys["kind"] == "grasp":
            raise PalmarError("E-CONF", str(where), f"{name} is made for the object of a pack; script and replay it")
    hand = default_hand()
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    tallies: list[Tally] = []
    # Cases that differ in the motion alone share their object.
    object_of = lru_cache(maxsize=8)(lambda asked: scene_object(json.loads(asked)))
    with tempfile.TemporaryDirectory(prefix="palmar-check-") as folder:
        for number, (keys, where, _) in enumerate(loaded):
            cases = cases_of(keys, where.name)[: 1 if quick else None]
            of_scene = {solver: Tally(where.stem, keys["id"], solver, why=keys["why"]) for solver in solvers}
            for done, (case, table) in enumerate(cases):
                progress(f"{where.stem} {case}", (number + done / len(cases)) / len(loaded))
                scene = check_scene(table, where.name)
                assert isinstance(scene, Sampled)
                _require_known(scene, where)
                tree = object_of(json.dumps(scene.object, sort_keys=True))
                pack = Path(folder) / "object.pack"
                save_object(pack, hand, tree)
                for tally in of_scene.values():
                    _run_case(Path(folder), pack, scene, case, tally, settings or {}, quick, out, runs)
            for tally in of_scene.values():
                tally.compare_ends(scene.same_end_force_n, scene.same_end_m)
            tallies += of_scene.values()
            for tally in of_scene.values():
                say(tally.line())
    answer = {
        "schema": CHECK_SCHEMA,
        "passed": all(tally.passed for tally in tallies),
        "scenes": [_told(tally) for tally in tallies],
    }
    if out is not None:
        write_whole(out / "check.json", json.dumps(answer, indent=1).encode())
        shown = {(tally.scene, tally.solver): tally.moment for tally in tallies if tally.moment is not None}
        answer = {**answer, "page": str(write_matrix(out, answer["scenes"], shown))}
    return answer


def suite() -> list[str]:
    """The scenes of the stability suite: all that stand for themselves, by name."""
    names = sorted(path.stem for path in SCENES.glob("*.toml"))
    return [name for name in names if load_scene(name)[0]["kind"] != "grasp"]


def _run_case(
    folder: Path,
    pack_path: Path,
    scene: Sampled,
    case: str,
    tally: Tally,
    settings: dict[str, Any],
    quick: bool,
    out: Path | None,
    runs: bool,
) -> None:
    pack = load_pack(pack_path)
    about = {*ALWAYS, *scene.metrics}
    only = about | {name.split()[0] for name in scene.figures}
    for start in range(min(scene.starts, QUICK_STARTS) if quick else scene.starts):
        run = replay_case(folder, pack_path, scene, (tally.scene, case, start), tally.solver, settings)
        rows, series = measure(run, pack, "object", only=only)
        rows = [row if row["metric"] in about else {**row, "limit": None, "margin_db": None} for row in rows]
        if scene.end_offset_m is not None:
            apart_m = np.linalg.norm(run.palm_position_m[-1] - run.haptic_palm_position_m[-1])
            rows.append(_row("end_offset", "mm", 1e3 * float(apart_m), 1e3 * scene.end_offset_m))
        if scene.settled_after_steps is not None:
            rows.append(_settled_row(Case(run, pack, "object"), scene.settled_after_steps))
        if scene.force_gone_after_s is not None:
            rows.append(_lost_force_row(run, read_trace(files_of(folder)[0]), scene.force_gone_after_s))
        if scene.actuator is not None:
            rows += _actuator_rows(run, scene.actuator)
        tally.see(run, case)
        if tally.take(rows, case, start, scene.figures) and out is not None:
            assert tally.worst is not None
            tally.moment = moment(run, pack, "object", tally.worst, series)
            if not runs:
                continue
            for path, ending in zip((pack_path, *files_of(folder)), ("pack", "mcap", "run.mcap"), strict=True):
                shutil.copyfile(path, out / f"{tally.scene}-{tally.solver}.{ending}")


def replay_case(
    folder: Path, pack_path: Path, scene: Sampled, place: tuple[str, str, int], solver: str, settings: dict[str, Any]
) -> Run:
    """Make the trace of a scene's case at a start, replay it, and read the run; both stay in the folder (`files_of`).

    place: name of the scene, of the case, number of the start.
    """
    name, case, start = place
    trace, run_path = files_of(folder)
    chosen = {"resample": "hold", "rate_hz": scene.rate_hz, **scene.settings, **settings, "solver": solver}
    samples = key_trace(scene, load_pack(pack_path).hand, start)
    samples.header.update(scene=name, object="object", case=case)
    write_trace(trace, samples)
    replay_file(pack_path, trace, run_path, object_name="object", settings=chosen)
    return read_run(run_path)


def files_of(folder: Path) -> tuple[Path, Path]:
    """Where `replay_case` puts trace and run."""
    return folder / "scene.mcap", folder / "scene.run.mcap"


def save_object(path: Path, hand: HandModel, tree: SphereTree) -> None:
    """Write the pack of a scene."""
    save_pack(path, AssetPack(hand, {"object": tree}, {"tools": {}, "seed": 0}))


def _require_known(scene: Sampled, where: Path) -> None:
    """Raise PalmarError E-CONF for a metric, or a number of one, that there is not."""
    metrics = [metric.name for metric in METRICS]
    numbers = [f"{metric.name} {stat.name}" for metric in METRICS for stat in metric.stats]
    asked = (
        ("metrics", scene.metrics, metrics),
        ("limits", scene.limits, numbers),
        ("figures", scene.figures, numbers),
    )
    for key, names, known in asked:
        for name in names:
            if name not in known:
                raise PalmarError("E-CONF", f"{where}:{key}", f"{name!r} is not known{nearest(name, known)}")


def _settled_row(case: Case, steps: int) -> Row:
    """Largest change of a fingertip's force where the input has been constant for longer than so many steps."""
    changes = np.linalg.norm(np.diff(case.run.fingertip_force_n, axis=0), axis=2).max(axis=1)
    still = case.still_steps[1:] > steps
    return _row("settled_force_step", "N", float(changes[still].max(initial=0.0)), 0.0)


def _lost_force_row(run: Run, samples: Trace, after_s: float) -> Row:
    """Largest force on a fingertip or the palm in steps farther than after_s from the last tracked sample."""
    tracked_s = samples.time_s[samples.tracked]
    since_s = run.time_s - tracked_s[np.maximum(np.searchsorted(tracked_s, run.time_s, side="right") - 1, 0)]
    force_n = np.linalg.norm(np.hstack([run.fingertip_force_n.reshape(-1, 15), run.palm_force_n]), axis=1)
    lost = since_s > after_s + 1e-9  # rounding of the times
    return _row("lost_force", "N", float(force_n[lost].max(initial=0.0)), 0.0)


def _actuator_rows(run: Run, played: Played) -> list[Row]:
    """How far commands are from the force on their fingertip, cut at the cap and 0 where it would close the finger, in
    N beyond a quantum of the actuator; and how much of the cap was never asked for, since that would show nothing."""
    feedback = Feedback(Actuator(played.cap_n, played.brake_only, quantum_n=played.quantum_n))
    steps = np.unique(np.searchsorted(run.time_s, np.arange(run.time_s[0], run.time_s[-1], 1.0 / played.rate_hz)))
    levels = np.array(
        [feedback.levels(float(run.time_s[k]), run.fingertip_force_n[k], run.joint_torque_n_m[k]) for k in steps]
    )
    force_n = np.linalg.norm(run.fingertip_force_n[steps], axis=2)
    if played.brake_only:
        force_n = np.where(run.joint_torque_n_m[steps].sum(axis=2) > 0, 0.0, force_n)
    off_n = np.abs(levels / FORCE_FULL_SCALE * played.cap_n - np.minimum(force_n, played.cap_n))
    quantum_n = max(played.quantum_n, played.cap_n / FORCE_FULL_SCALE)
    return [
        _row("actuator_error", "N", max(float(off_n.max()) - quantum_n, 0.0), 0.0),
        _row("actuator_unused", "N", max(played.cap_n - float(force_n.max()), 0.0), 0.0),
    ]


def _row(name: str, unit: str, value: float, limit: float) -> Row:
    """A number that a scene asks for beside those of eval, in the form of theirs."""
    found = {"metric": name, "stat": "value", "unit": unit, "value": value, "limit": limit}
    return {**found, "margin_db": margin_db(value, limit)}


def _told(tally: Tally) -> dict[str, Any]:
    """A tally as JSON; a margin without bound is null."""
    told = dict(vars(tally))
    told["margin_db"] = tally.margin_db if abs(tally.margin_db) < float("inf") else None
    told["passed"], told["untouched"] = tally.passed, tally.untouched
    del told["end_force_n"], told["end_palm_m"], told["moment"]
    return told


def _say_fail(name: str, row: Row) -> str:
    where = ", ".join(part for part in (row["case"], f"start {row['start']}") if part)
    return f"{name} {_say_value(row)} above {row['limit']:.4g} in {row['runs']} ({where})"


def _say_value(row: Row) -> str:
    return f"{row['value']:.4g}{'' if row['unit'] == '1' else ' ' + row['unit']}"


def _decibels(margin: float) -> str:
    return f"{margin:+.1f} dB" if abs(margin) < float("inf") else "all kept:"
