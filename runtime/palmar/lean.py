"""What a lean pack (`palmar tune`) asks of whoever replays on it: its settings, and a word where its promise ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palmar.model import AssetPack
from palmar.pack_check import TUNED
from palmar.records import Run, read_run
from palmar.seen import beyond, outside_text

SOLVER = "progressive"  # that packs are tuned for


def tuned_of(pack: AssetPack, name: str) -> dict[str, Any] | None:
    """What the manifest says of the tuning of an object ("": the only one); None of a pack that is not lean."""
    tree = pack.objects.get(name or next(iter(pack.objects)))
    return None if tree is None else tree.about.get(TUNED)


def lean_settings(pack: AssetPack, name: str, own: dict[str, Any]) -> dict[str, Any]:
    """Settings of a replay: those that a lean pack was tuned with, where the solver is the same, and one's own."""
    tuned = tuned_of(pack, name)
    return {**tuned["settings"], **own} if tuned and own.get("solver", SOLVER) == SOLVER else own


def beyond_line(run: Run | Path, pack: AssetPack, name: str) -> str:
    """Where a run leaves what the pack was tuned on, as one line; "" if nowhere, or if the pack is not lean."""
    tuned = tuned_of(pack, name)
    if tuned is None:
        return ""
    run = read_run(run) if isinstance(run, Path) else run
    found = beyond(run, tuned)
    said = (
        [f"the hand touches what no trace of the tuning came near: {outside_text(run, found)}"] if found.any() else []
    )
    if tuned["left_out"]:
        from palmar.eval.reach import part_gap

        near = part_gap(run, pack, name or next(iter(pack.objects)), tuned["left_out"]) * 1e3
        at = near.argmin()
        if near[at] < tuned["guard_mm"]:
            parts, when = ", ".join(tuned["left_out"]), run.time_s[at] - run.time_s[0]
            said.append(f"{parts}, left out of contact, come to {near[at]:.1f} mm from the mesh at {when:.2f} s")
    rest = f"; the pack promises {tuned['rest_mm']:.3g} mm there, not {tuned['fine_mm']:.3g}"
    return "; ".join(said) + (rest if found.any() else "") if said else ""
