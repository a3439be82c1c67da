"""The `compare` verb: run against run, pose by pose and, where their packs are at hand, number by number."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palmar.eval.compare import compare_runs, inputs, what_differs
from palmar.eval.compare_page import build_page
from palmar.eval.metrics import measure
from palmar.files import find_packs, require_file, require_own_folder, whole_folder
from palmar.model import load_pack
from palmar.records import Run, read_run

COMPARE_SCHEMA = "palmar.compare/1"
OF_A_COMPARISON = {"index.html", "compare.json"}


def compare_files(a: Path, b: Path, packs: Sequence[Path], out: Path | None = None) -> dict[str, Any]:
    """Two runs side by side: what `compare_runs` says, and with packs the metrics and what the packs differ in.

    packs: besides those beside the runs. {..., "metrics": [{"metric", "stat", "unit", "values": [a, b]}], "packs":
    lines}; without a pack "metrics" is None. out: a folder for a page of it, which needs the packs; then also "page".
    Raises BadTrace, BadPack, PalmarError.
    """
    if out is not None:
        require_own_folder(out, OF_A_COMPARISON, "comparison")
    runs = [read_run(require_file(path)) for path in (a, b)]
    answer: dict[str, Any] = {"schema": COMPARE_SCHEMA, "runs": [str(a), str(b)], **compare_runs(*runs)}
    paths = [path for _, path in find_packs([a, b], packs)] if packs or out or _beside(a, b, runs) else None
    if paths is None:
        return {**answer, "metrics": None, "packs": []}
    assets = [load_pack(path) for path in paths]
    names = [run.header.get("object", "") for run in runs]
    levels = [int(run.header.get("level", -1)) for run in runs]
    parts = [inputs(pack, name, level) for pack, name, level in zip(assets, names, levels, strict=True)]
    measured = [measure(run, pack, name) for run, pack, name in zip(runs, assets, names, strict=True)]
    rows = [each[0] for each in measured]
    metrics = [
        {key: one[key] for key in ("metric", "stat", "unit")} | {"values": [one["value"], other["value"]]}
        for one, other in zip(*rows, strict=True)
        if one["value"] is not None or other["value"] is not None
    ]
    answer |= {"metrics": metrics, "packs": what_differs(*parts)}
    if out is not None:
        with whole_folder(out, OF_A_COMPARISON, "comparison") as folder:
            page = build_page(answer, runs, assets, [each[1] for each in measured])
            (folder / "index.html").write_text(page, encoding="utf-8")
            (folder / "compare.json").write_text(json.dumps(answer, indent=1, sort_keys=True) + "\n")
        answer["page"] = str(out / "index.html")
    return answer


def _beside(a: Path, b: Path, runs: Sequence[Run]) -> bool:
    """Whether the packs of both runs lie beside them."""
    from palmar.files import sha256_of

    for path, run in zip((a, b), runs, strict=True):
        hashes = {sha256_of(pack) for pack in path.parent.glob("*.pack") if pack.is_file()}
        if run.header.get("pack_sha256") not in hashes:
            return False
    return True


def print_comparison(answer: dict[str, Any]) -> None:
    """For a person: whether they are the same, else where they part and by how much."""
    from palmar.terminal import cell, print_fields, print_table

    if answer["equal"]:
        print("the same poses, forces and status in every step, bit for bit")
    else:
        time = answer["first_time_s"]
        at = "" if time is None else f" ({time:.4g} s)"
        print(f"first differing step {answer['first_step']}{at}")
        if answer["first_asked"] is not None:
            print(f"the haptic hand or the object differs from step {answer['first_asked']} on")
        rows = [(name, row["value"], row["unit"], row["step"]) for name, row in answer["largest"].items()]
        print_table(("largest difference", "value", "unit", "at step"), rows)
    pairs = [(name, *both) for name, both in answer["status"].items() if both[0] != both[1]]
    if pairs:
        print_table(("status", "steps of a", "of b"), pairs)
    said = {name: f"{cell(old)} | {cell(new)}" for name, (old, new) in answer["header"].items()}
    print_fields(said | {f"pack {k + 1}": line for k, line in enumerate(answer["packs"])})
    if answer["metrics"] is None:
        print("metrics were not compared: the packs are not beside the runs; name them with --pack")
        return
    changed = [row for row in answer["metrics"] if row["values"][0] != row["values"][1]]
    rows = [
        (f"{row['metric']} {row['stat']}", *("" if v is None else cell(v) for v in row["values"]), row["unit"])
        for row in changed
    ]
    if rows:
        print_table(("metric that differs", "a", "b", "unit"), rows)
    if "page" in answer:
        print(f"page: {answer['page']}")
