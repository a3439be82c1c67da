"""Every recording of tests/data/recordings.toml: imported, replayed on an object in the hand's path, judged.

`python tests/recordings.py [NAME...] [-o DIR]` prints one row a recording, those whose file or group has a NAME in it;
-o keeps trace and run of each and writes one report of all. Hands are calibrated from the recording itself; the door
demonstrations have their own hand and the door's handle, all others a cup that is put where the hand closes.
"""

from __future__ import annotations

import argparse
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from palmar import load_pack, read_run
from palmar.calibrate import calibrate
from palmar.errors import PalmarError
from palmar.eval.metrics import measure
from palmar.eval.report import write_report
from palmar.files import sha256_of
from palmar.importing import import_log
from palmar.reference import same_start
from palmar.replay import replay_file
from palmar.tools.pack import build
from palmar.traces.device import import_file

TOP = Path(__file__).resolve().parents[1]
LIST = TOP / "tests" / "data" / "recordings.toml"
SHARED = TOP.parent / "shared" / "data"
METRICS = ("penetration_spheres", "penetration_mesh", "wrong_side", "frozen_steps", "joint_step_excess", "palm_offset")


def listed() -> dict[str, dict[str, Any]]:
    """The groups of the list by name."""
    return tomllib.loads(LIST.read_text())


def door_pack(folder: Path) -> Path:
    """The Adroit hand and the door's handle."""
    pack = folder / "latch.pack"
    if not pack.exists():
        source = SHARED / "traces" / "adroit_door"
        import_file(source / "adroit_hand.json", folder / "adroit.toml", format="adroit-hand")
        build([source / "latch.obj"], pack, error_mm=0.25, hand_path=folder / "adroit.toml")
    return pack


def cup_pack(folder: Path, log: Path, profile: Path) -> Path:
    """A cup and the hand of whoever was recorded."""
    pack = folder / f"{log.stem}.pack"
    build(["shape:cup"], pack, error_mm=1.0, profile_path=profile)
    return pack


def replay_recording(log: Path, form: str, folder: Path) -> tuple[Path, Path, dict[str, Any]]:
    """Pack and run of one recording, and what import said."""
    trace, run = folder / f"{log.stem}.mcap", folder / f"{log.stem}.run.mcap"
    if form == "adroit-door":
        pack = door_pack(folder)
        said = import_log(log, trace, format=form)
    else:
        profile = folder / f"{log.stem}.toml"
        calibrate(log, profile, name=log.stem)
        pack = cup_pack(folder, log, profile)
        said = import_log(log, trace, format=form, profile_path=profile, grasp=pack)
    replay_file(pack, trace, run)
    return pack, run, said


def judge(pack_path: Path, run_path: Path) -> dict[str, float]:
    """The numbers of a row, METRIC STAT -> value."""
    run, pack = read_run(run_path), load_pack(pack_path)
    name = next(iter(pack.objects))
    rows, _ = measure(run, pack, name, only=METRICS)
    touched = float((run.contacts > 0).mean())
    steps = {"steps": float(len(run.time_s)), "contact": touched, "cpu p99": float(np.percentile(run.cpu_us, 99))}
    return steps | {f"{row['metric']} {row['stat']}": row["value"] for row in rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of names; all recordings if none")
    parser.add_argument("-o", "--out", type=Path, help="folder for traces, runs and report")
    chosen = parser.parse_args()
    print(
        "| recording | s | rate Hz | residual of fingertips p99 mm | counted by import | steps in contact "
        "| deepest in spheres mm "
        "| deepest in mesh mm | wrong side, frozen steps | joint excess deg | palm offset max mm |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        pairs = []
        for group, about in listed().items():
            for name, sha256 in about["files"].items() if about["recordings"] else ():
                log = SHARED / name
                if chosen.names and not any(part in f"{group} {name}" for part in chosen.names):
                    continue
                if sha256_of(log) != sha256:
                    raise PalmarError("E-HASH", str(log), f"is not the file of the list, whose sha256 is {sha256}")
                pack, run, said = replay_recording(log, about["format"], folder)
                pairs.append((run, pack))
                print(row_of(f"{group}/{log.stem}", said, judge(pack, run)), flush=True)
        if chosen.out:
            page = write_report(pairs, chosen.out / "report", same_start=same_start)["page"]
            print(f"\nreport: {page}")


def row_of(name: str, said: dict[str, Any], found: dict[str, float]) -> str:
    tips = said.get("residual_mm", {}).get("fingertips", {})
    counted = "; ".join(
        f"{what} {count:g}" for what, count in said["changed"].items() if isinstance(count, int | float)
    )
    cells = [
        name,
        f"{said['duration_s']:.2f}",
        f"{said['rate_hz']:.0f}",
        f"{tips['p99']:.2g}" if tips else "-",
        counted or "-",
        f"{found['contact']:.0%}",
        f"{found['penetration_spheres max']:.4g}",
        f"{found['penetration_mesh max']:.2g}",
        f"{found['wrong_side sum']:.0f}, {found['frozen_steps sum']:.0f}",
        f"{found['joint_step_excess max']:.2g}",
        f"{found['palm_offset max']:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
