"""`palmar tune` on the recorded door demonstrations: tuned on ten of the fifteen, tried on the other five.

`python tests/tune_figures.py [-o DIR] [--error-mm 0.25] [--guard-mm 5]` prints the figures of docs/tune.md as tables.
With -o the lean pack and the page stay in DIR/tuning, and a run that was stopped goes on from there. Some ten minutes
of CPU time; the times are of this machine, the full and the lean pack timed in one run, in mixed order.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from recordings import SHARED, listed

from palmar.importing import import_log
from palmar.tools.pack import build
from palmar.traces.device import import_file
from palmar.tune import Asked, tune
from palmar.workers import cores

TUNED_ON = 10


def door_inputs(folder: Path, error_mm: float) -> tuple[Path, list[Path]]:
    """The pack of the door's handle with the Adroit hand, and a trace of each demonstration; made once."""
    logs = sorted(SHARED / name for name in listed()["adroit-door"]["files"] if Path(name).name.startswith("door_"))
    logs = [log for log in logs if log.suffix == ".csv"]
    pack = folder / f"latch-{error_mm:g}.pack"
    if not pack.exists():
        import_file(logs[0].parent / "adroit_hand.json", folder / "adroit.toml", format="adroit-hand")
        build([logs[0].parent / "latch.obj"], pack, error_mm=error_mm, hand_path=folder / "adroit.toml")
    traces = []
    for log in logs:
        traces.append(folder / f"{log.stem}.mcap")
        if not traces[-1].exists():
            import_log(log, traces[-1], format="adroit-door")
    return pack, traces


def print_tables(answer: dict[str, Any]) -> None:
    print("| model | spheres | bytes | cost p50 us | cost p99 us | tail p99 us | p99.9 us | max us | operations p99 |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for stage in answer["stages"]:
        times = [f"{stage['times_us'][name]:.1f}" for name in ("cost_p50", "cost_p99", "p99", "p99.9", "max")]
        cells = [stage["name"], f"{stage['spheres']:,}", f"{stage['bytes']:,}", *times]
        print(f"| {' | '.join(cells)} | {stage['operations']['p99']:,.0f} |")
    held = [row for row in answer["limits"] if row["allowed"] is not None]
    print(
        f"\n| limit | unit | full | lean | allowed | limit | {' | '.join(row['name'] for row in answer['outside'])} |"
    )
    print("| --- " * (6 + len(answer["outside"])) + "|")
    for row in held:
        numbers = [row["own"], row["value"], row["allowed"], row["limit"]]
        numbers += [each["values"][row["metric"]] for each in answer["outside"]]
        over = [False] * 4 + [row["metric"] in each["broken"] for each in answer["outside"]]
        cells = ["-" if n is None else f"{n:.3g}{' (!)' if bad else ''}" for n, bad in zip(numbers, over, strict=True)]
        print(f"| {row['metric']} | {row['unit']} | {' | '.join(cells)} |")
    beyond = [f"{each['beyond_mm']:.1f}" for each in answer["outside"]]
    print(f"| outside of what was seen | mm | - | - | - | - | {' | '.join(beyond)} |")
    print("", answer["sentence"], *answer["promise"], answer["note"], sep="\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, help="folder for pack, traces and tuning")
    parser.add_argument("--error-mm", type=float, default=0.25, help="of the full pack")
    parser.add_argument("--guard-mm", type=float, default=5.0)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        pack, traces = door_inputs(folder, chosen.error_mm)
        asked = Asked(guard_mm=chosen.guard_mm, jobs=cores())
        name = (
            "tuning" if (chosen.error_mm, chosen.guard_mm) == (0.25, 5.0) else f"tuning-{pack.stem}-{chosen.guard_mm:g}"
        )
        print_tables(tune(pack, traces[:TUNED_ON], folder / name, asked, holdout=traces[TUNED_ON:]))


if __name__ == "__main__":
    main()
