"""One scene by one solver: every case and start is made, replayed and judged; one run is held at a time."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from palmar.errors import PalmarError
from palmar.eval.case import Case
from palmar.eval.matrix import moment
from palmar.eval.metrics import measure
from palmar.eval.table import METRICS
from palmar.files import nearest
from palmar.model import AssetPack, HandModel, SphereTree, load_pack, save_pack
from palmar.records import Run, Trace, read_run, read_trace, write_trace
from palmar.replay import replay_file
from palmar.tally import Row, Tally, row_of
from palmar.tools.hand_file import default_hand
from palmar.tools.lattice import scene_object
from palmar.traces.actuator import Actuator, Feedback
from palmar.traces.keyframes import key_trace
from palmar.traces.opengloves import FORCE_FULL_SCALE
from palmar.traces.scene_file import Played, Sampled, cases_of, check_scene
from palmar.traces.scripted import load_scene

ALWAYS = ("penetration_spheres", "frozen_steps")  # the metrics that every scene is about
QUICK_STARTS = 2
OBJECTS_KEPT = 8  # cases that differ in the motion alone share their object


@dataclass(frozen=True)
class Asked:
    """What of a scene is replayed, and how."""

    settings: dict[str, Any]  # over those of the scene
    quick: bool = False  # the first case alone, QUICK_STARTS of it
    starts: int | None = None  # of a case, at most
    out: Path | None = None  # where `runs` go; also whether the worst moment is kept
    runs: bool = False  # keep pack, trace and run of the worst

    def starts_of(self, scene: Sampled) -> int:
        most = [scene.starts, *([QUICK_STARTS] if self.quick else []), *([] if self.starts is None else [self.starts])]
        return min(most)


def check_scene_with(
    name: str, solver: str, asked: Asked, progress: Callable[[str, float], None] = lambda text, part: None
) -> Tally:
    """Replay the cases and starts of a scene by a solver. name: as `load_scene` takes it. Raises PalmarError."""
    keys, where, _ = load_scene(name)
    cases = cases_of(keys, where.name)[: 1 if asked.quick else None]
    tally = Tally(where.stem, keys["id"], solver, why=keys["why"])
    object_of = lru_cache(maxsize=OBJECTS_KEPT)(lambda rule: scene_object(json.loads(rule)))
    with tempfile.TemporaryDirectory(prefix="palmar-check-") as folder:
        pack = Path(folder) / "object.pack"
        for done, (case, table) in enumerate(cases):
            progress(f"{where.stem} {case}", done / len(cases))
            scene = check_scene(table, where.name)
            assert isinstance(scene, Sampled)
            save_object(pack, default_hand(), object_of(json.dumps(scene.object, sort_keys=True)))
            for start in range(asked.starts_of(scene)):
                _run_start(Path(folder), pack, scene, (case, start), tally, asked)
    tally.compare_ends(scene.same_end_force_n, scene.same_end_m)
    return tally


def require_known(name: str) -> Path:
    """The file of a scene that `check` can run. Raises PalmarError E-CONF for one of a pack's object, and for a metric,
    or a number of one, that there is not."""
    keys, where, _ = load_scene(name)
    if keys["kind"] == "grasp":
        raise PalmarError("E-CONF", str(where), f"{name} is made for the object of a pack; script and replay it")
    metrics = [metric.name for metric in METRICS]
    numbers = [f"{metric.name} {stat.name}" for metric in METRICS for stat in metric.stats]
    for _, table in cases_of(keys, where.name):
        scene = check_scene(table, where.name)
        assert isinstance(scene, Sampled)
        asked = (
            ("metrics", scene.metrics, metrics),
            ("limits", scene.limits, numbers),
            ("figures", scene.figures, numbers),
        )
        for key, names, known in asked:
            for unknown in (each for each in names if each not in known):
                raise PalmarError("E-CONF", f"{where}:{key}", f"{unknown!r} is not known{nearest(unknown, known)}")
    return where


def _run_start(folder: Path, pack_path: Path, scene: Sampled, at: tuple[str, int], tally: Tally, asked: Asked) -> None:
    case, start = at
    pack = load_pack(pack_path)
    about = {*ALWAYS, *scene.metrics}
    only = about | {name.split()[0] for name in scene.figures}
    run = replay_case(folder, pack_path, scene, (tally.scene, case, start), tally.solver, asked.settings)
    rows, series = measure(run, pack, "object", only=only)
    rows = [row if row["metric"] in about else {**row, "limit": None, "margin_db": None} for row in rows]
    if scene.end_offset_m is not None:
        apart_m = np.linalg.norm(run.palm_position_m[-1] - run.haptic_palm_position_m[-1])
        rows.append(row_of("end_offset", "mm", 1e3 * float(apart_m), 1e3 * scene.end_offset_m))
    if scene.settled_after_steps is not None:
        rows.append(_settled_row(Case(run, pack, "object"), scene.settled_after_steps))
    if scene.force_gone_after_s is not None:
        rows.append(_lost_force_row(run, read_trace(files_of(folder)[0]), scene.force_gone_after_s))
    if scene.actuator is not None:
        rows += _actuator_rows(run, scene.actuator)
    tally.see(run, case)
    if tally.take(rows, case, start, scene.figures) and asked.out is not None:
        assert tally.worst is not None
        tally.moment = moment(run, pack, "object", tally.worst, series)
        if asked.runs:
            for path, ending in zip((pack_path, *files_of(folder)), ("pack", "mcap", "run.mcap"), strict=True):
                shutil.copyfile(path, asked.out / f"{tally.scene}-{tally.solver}.{ending}")


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


def _settled_row(case: Case, steps: int) -> Row:
    """Largest change of a fingertip's force where the input has been constant for longer than so many steps."""
    changes = np.linalg.norm(np.diff(case.run.fingertip_force_n, axis=0), axis=2).max(axis=1)
    still = case.still_steps[1:] > steps
    return row_of("settled_force_step", "N", float(changes[still].max(initial=0.0)), 0.0)


def _lost_force_row(run: Run, samples: Trace, after_s: float) -> Row:
    """Largest force on a fingertip or the palm in steps farther than after_s from the last tracked sample."""
    tracked_s = samples.time_s[samples.tracked]
    since_s = run.time_s - tracked_s[np.maximum(np.searchsorted(tracked_s, run.time_s, side="right") - 1, 0)]
    force_n = np.linalg.norm(np.hstack([run.fingertip_force_n.reshape(-1, 15), run.palm_force_n]), axis=1)
    lost = since_s > after_s + 1e-9  # rounding of the times
    return row_of("lost_force", "N", float(force_n[lost].max(initial=0.0)), 0.0)


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
        row_of("actuator_error", "N", max(float(off_n.max()) - quantum_n, 0.0), 0.0),
        row_of("actuator_unused", "N", max(played.cap_n - float(force_n.max()), 0.0), 0.0),
    ]
