"""What each cure of `progressive` is good for: hard scenes with one cure off in turn, and what then fails.

    python tests/ablation.py              the whole table, as in docs/method.md (some minutes)
    python tests/ablation.py --off curvature --scene poke

Each scene is replayed with its first case and two starts. `fails` is what fails, its value and, in brackets, its limit.
The other columns are of the fist and of the index between two ears: cost_excess against the converged answer to each
step, the share of steps that end at the limit of their rounds, and the thread CPU time of a step.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from palmar import load_pack, read_run
from palmar.check import check_scenes
from palmar.check_case import Asked
from palmar.eval.case import Reference
from palmar.eval.metrics import measure
from palmar.records import STATUS
from palmar.reference import same_start

CURES: dict[str, tuple[str, dict[str, Any]]] = {
    "none": ("all cures", {}),
    "rounds": ("one round a step", {"iterations": 1}),
    "curvature": ("rows know nothing of how gaps bend", {"curvature": 0.0}),
    "corrections": ("no least move out of a trial pose that sinks in", {"corrections": 0}),
    "bound": ("a round may move a link as far as 100 mm instead of 3", {"reach_most_m": 0.1}),
    "angle rate": ("a freed finger may leap", {"joint_step_rad": 100.0}),
    "one energy": ("palm before fingers, rotation imposed", {"palm_priority": 1000.0, "imposed_priority": 100.0}),
    "release": ("a hand left behind stays there", {"release_after_s": 3600.0}),
}
MEASURED = ("fist", "between_ears")
SCENES = (
    "fist",
    "between_ears",
    "poke",
    "slot_push",
    "hook",
    "swipe",
    "twist",
    "dropout",
    "left_behind",
    "deep_press",
    "limits_against_contact",
    "closed_loop_energy",
    "joint_step",
)


def said(row: dict[str, Any]) -> str:
    """What failed in a scene's replays."""
    parts = [f"{name} {fail['value']:.3g} {fail['unit']} ({fail['limit']:g})" for name, fail in row["fails"].items()]
    return ", ".join(parts)


def cost(folder: Path) -> list[str]:
    """cost_excess mean and p99, share at the limit, step_cpu p50 and p99 of the runs kept in a folder."""
    limit = next(bit for bit, name in STATUS.items() if name == "iteration_limit")
    excess, at_limit, cpu = [], [], []
    for scene in MEASURED:
        path = folder / f"{scene}-progressive.pack"
        run, pack = read_run(folder / f"{scene}-progressive.run.mcap"), load_pack(path)
        rows, _ = measure(run, pack, run.header["object"], reference=Reference(same_start(run, path), None))
        value = {row["stat"]: row["value"] for row in rows if row["metric"] == "cost_excess"}
        excess.append([value["mean"], value["p99"]])
        touching = np.diff(run.contact_start) > 0
        at_limit.append((run.status[touching] & limit > 0).mean())
        cpu.append(np.percentile(run.cpu_us[touching], [50, 99]))
    mean, p99 = np.mean(excess, axis=0)
    p50, tail = np.mean(cpu, axis=0)
    return [f"{mean:.2g}, {p99:.2g}", f"{np.mean(at_limit):.0%}", f"{p50:.0f}, {tail:.0f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--off", choices=list(CURES), action="append")
    parser.add_argument("--scene", action="append")
    arguments = parser.parse_args()
    scenes = arguments.scene or list(SCENES)
    kept_by_all: dict[str, str] = {}
    print("| off | that is | cost_excess mean, p99 % | at the limit | step p50, p99 us | fails |", flush=True)
    print("| --- | --- | --- | --- | --- | --- |", flush=True)
    for cure in arguments.off or CURES:
        what, settings = CURES[cure]
        with tempfile.TemporaryDirectory() as folder:
            report = check_scenes(
                sorted({*scenes, *MEASURED}), Asked(settings, quick=True, out=Path(folder), runs=True)
            )
            cells = cost(Path(folder))
        fails = {row["scene"]: said(row) for row in report["scenes"] if row["fails"]}
        if cure == "none":
            kept_by_all = fails
        new = [f"`{scene}`: {text}" for scene, text in fails.items() if kept_by_all.get(scene) != text]
        print(f"| {' | '.join([cure, what, *cells, '; '.join(new) or 'nothing here'])} |", flush=True)


if __name__ == "__main__":
    main()
