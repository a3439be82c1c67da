"""Every figure that hands are held to, beside its target.

`python tests/tools/hand_figures.py [fits] [known] [recordings] [bunny]` prints a table for each name, all four if none.

fits: the rigged hands of the shared data: 99th percentiles and means, seconds of one fit, left against right.
known: a hand of known capsules with 0.2 mm of noise. recordings: calibrated and imported, fingertips' residuals.
bunny: a fitted hand, a bunny, a grasp, a run and what a report says of the two true meshes.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from conftest import make_rigged_hand, write_glb
from test_hand_fit import aligned, thickness

from palmar import load_pack, read_run
from palmar.calibrate import calibrate
from palmar.eval.metrics import measure
from palmar.eval.report import write_report
from palmar.importing import import_log
from palmar.reference import same_start
from palmar.replay import replay_file
from palmar.tools.hand_file import default_hand
from palmar.tools.hand_fit import fit_hand
from palmar.tools.pack import build
from palmar.traces.scripted import script

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
HANDS = ("webxr_generic_hand_right.glb", "webxr_generic_hand_left.glb", "godot_hand_right.gltf")


def fits(folder: Path) -> None:
    print("| hand | rest p99 of phalanges, palm | rest mean | sweep p99 of phalanges | seconds, of CPU |")
    print("| --- | --- | --- | --- | --- |")
    print("| target | 1.0, 1.0 | 0.35 | 2.5 | 30 on two cores |")
    for name in HANDS:
        wall, cpu = time.perf_counter(), time.process_time()
        answer = fit_hand(SHARED / "hands" / name, folder / f"{Path(name).stem}.pack")
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        error = answer["hand"]["error"]
        rest, sweep = error["rest"]["phalanges"], error["sweep"]["phalanges"]
        cells = [
            f"{_worse(rest, 'p99'):.2f}, {_worse(error['rest']['palm'], 'p99'):.2f}",
            f"{_worse(rest, 'mean'):.2f}",
            f"{_worse(sweep, 'p99'):.2f}",
            f"{wall:.0f}, {cpu:.0f}",
        ]
        print(f"| {Path(name).stem} | {' | '.join(cells)} |", flush=True)
    right, left = (load_pack(folder / f"{Path(name).stem}.pack").hand for name in HANDS[:2])
    length = [1e3 * np.linalg.norm(np.diff(hand.joint_m, axis=1), axis=2) for hand in (right, left)]
    radius = 1e3 * np.abs(right.phalanx_radius_m - left.phalanx_radius_m)
    off = np.abs(length[0] - length[1])
    print(f"\nleft against right, mm (target 0.1): index {off[1, 0]:.2f} and {radius[1, 0].max():.2f} at its knuckle,")
    off[1, 0], radius[1, 0] = 0, 0
    print(f"elsewhere lengths {off.max():.3f}, radii {radius.max():.3f}\n")


def _worse(figures: dict[str, dict[str, float]], stat: str) -> float:
    return max(figures["protrusion_mm"][stat], figures["gap_mm"][stat])


def known(folder: Path) -> None:
    true = default_hand()
    rigged = make_rigged_hand(true, noise_m=2e-4)
    fit_hand(write_glb(folder / "known.glb", rigged), folder / "known.pack", spheres=100)
    hand = load_pack(folder / "known.pack").hand
    ends, radii, true_ends, true_radii = aligned(hand, true)
    bones = (found[:, 1] - found[:, 0] for found in (ends, true_ends))
    axis, true_axis = (bone / np.linalg.norm(bone, axis=1)[:, None] for bone in bones)
    angle = np.degrees(np.arccos(np.clip(np.einsum("ka,ka->k", axis, true_axis), -1, 1)))
    lengths = [1e3 * np.linalg.norm(np.diff(some.joint_m, axis=1), axis=2) for some in (hand, true)]
    thick = [
        np.concatenate([thickness(*found, true_ends, f) for f in range(5)])
        for found in ((ends, radii), (true_ends, true_radii))
    ]
    print(f"known capsules: lengths {np.abs(lengths[0] - lengths[1]).max():.2f} mm (target 0.5), radii", end=" ")
    print(f"{1e3 * np.abs(thick[0] - thick[1]).max():.2f} mm (0.2), axes {angle.max():.2f} degrees (2)\n")


def recordings(folder: Path) -> None:
    traces = SHARED / "traces"
    logs = [traces / "quest3_webxr" / "quest3_right.csv", *sorted((traces / "leap").glob("*.csv"))]
    print("| recording | target p99 mm | fingertips p50, p99, max mm | spread of lengths mm | counted |")
    print("| --- | --- | --- | --- | --- |")
    for log, target in [*((log, 3) for log in logs), (traces / "qualisys_pillow" / "pillow_first_30s.csv", 5)]:
        profile = folder / f"{log.stem}.toml"
        told = calibrate(log, profile, name=log.stem)
        made = import_log(log, folder / f"{log.stem}.mcap", profile_path=profile)
        tips = made["residual_mm"]["fingertips"]
        spread = [finger["spread_mm"] for finger in told["hand"]["fingers"].values() if finger.get("spread_mm")]
        most = f"{np.max(spread):.2f}" if spread else "-"
        counted = ", ".join(f"{what} {count}" for what, count in made["changed"].items() if isinstance(count, int))
        figures = f"{tips['p50']:.2f}, {tips['p99']:.2f}, {tips['max']:.2f}"
        print(f"| {log.stem} | {target} | {figures} | {most} | {counted or '-'} |", flush=True)
    print()


def bunny(folder: Path) -> None:
    hand = folder / "webxr_generic_hand_right.pack"
    if not hand.exists():
        fit_hand(SHARED / "hands" / HANDS[0], hand)
    pack, trace, run = (folder / f"bunny{end}" for end in (".pack", ".mcap", ".run.mcap"))
    build([SHARED / "meshes" / "bunny.obj"], pack, size_mm=120.0, spheres=1000, hand_path=hand)
    script("grasp", pack, trace)
    replay_file(pack, trace, run)
    told = write_report([(run, pack)], folder / "report", same_start=same_start)
    print(f"bunny: {told['runs'][0]['verdict']}")
    rows, _ = measure(read_run(run), load_pack(pack), "bunny", only=("penetration_mesh", "penetration_hand_mesh"))
    for row in rows:
        print(f"  {row['metric']} {row['stat']}: {row['value']:.3g} {row['unit']}")


def main() -> None:
    tables = {"fits": fits, "known": known, "recordings": recordings, "bunny": bunny}
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", choices=[*tables, []], metavar="TABLE", help=", ".join(tables))
    chosen = parser.parse_args().names or list(tables)
    with tempfile.TemporaryDirectory() as name:
        for table in chosen:
            tables[table](Path(name))


if __name__ == "__main__":
    main()
