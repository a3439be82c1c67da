"""The search of `palmar tune`: one reduction after the other, each kept only if every limit holds on every trace."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.tuned import Held
from palmar.model import AssetPack, load_pack, save_pack
from palmar.tools.lean import lean_tree, own_error_mm, rest_of
from palmar.tune_cells import Bench, Model, Progress, Trial, try_answer, try_place

Array = NDArray[np.float64]

STEP = 2 ** (1 / 4)  # between two errors that are tried
FINER, COARSER = (-1, -2, -4), (2, 4, 8, 12)  # steps from the full model's own error
# Other settings that make a step cheaper, tried in this order, each as far as it goes.
SETTINGS: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("iterations", (3, 2, 1)),
    ("corrections", (1, 0)),
    ("reach_most_m", (0.0015,)),
    ("reach_least_m", (0.0001,)),
)
GAIN = 0.01  # of the operations: less is none


@dataclass(frozen=True)
class Stage:
    """One reduction that was kept, or the full model: what it is, and how it was judged."""

    name: str
    what: str
    trial: Trial
    fine_mm: float


@dataclass
class Search:
    """What is searched in, and what was tried: every candidate with its verdict."""

    bench: Bench
    pack: AssetPack
    traces: Sequence[Path]
    rows: Sequence[Held]
    seen_m: Array  # (k, 4) balls over what hands came near
    share_seen: float
    left_out: list[str]
    rest_mm: float
    seed: int
    tries: int
    made: Path
    progress: Progress
    tried: list[dict[str, Any]] = field(default_factory=list)

    def left(self) -> bool:
        return len(self.tried) < self.tries

    def judge(self, what: str, model: Model, fine_mm: float) -> Trial:
        """Judge a model on all traces and keep the verdict."""
        return self.note(what, fine_mm, self.place(what, try_answer(self.bench, model, self.traces, self.rows)))

    def place(self, what: str, trial: Trial) -> Trial:
        """The dear part of a trial, if the rest of it broke nothing."""

        def tell(done: int) -> None:
            part = (len(self.tried) + done / len(self.traces)) / self.tries
            self.progress(f"trying {what}: trace {done} of {len(self.traces)}", min(part, 1.0))

        return trial if trial.broken else try_place(self.bench, trial, self.traces, self.rows, tell)

    def note(self, what: str, fine_mm: float, trial: Trial, why: str = "") -> Trial:
        found = [
            {"metric": row.rule.name, "value": trial.values[row.rule.name], "allowed": row.allowed}
            for row in trial.broken
        ]
        self.tried.append(
            {
                "what": what,
                "spheres": trial.model.spheres,
                "fine_mm": fine_mm,
                "settings": trial.model.settings,
                "broken": found,
                "trace": trial.trace,
                "why": why,
            }
        )
        return trial

    def model(self, fine_mm: float, settings: dict[str, Any]) -> Model:
        """Spheres within fine_mm where hands came near; made once."""
        told = [
            self.pack.sha256,
            self.bench.name,
            self.seen_m.round(9).tolist(),
            self.share_seen,
            fine_mm,
            self.rest_mm,
            self.seed,
        ]
        key = hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]
        path = self.made / f"fine-{fine_mm:.4g}mm-{key}.pack"
        if not path.is_file():
            part = min(len(self.tried) / self.tries, 1.0)
            tree = self.pack.objects[self.bench.name]
            lean = lean_tree(
                tree,
                self.seen_m,
                self.share_seen,
                fine_mm,
                self.rest_mm,
                self.seed,
                lambda text, _: self.progress(f"spheres within {fine_mm:.3g} mm: {text}", part),
            )
            save_pack(path, AssetPack(self.pack.hand, {self.bench.name: lean}, {"tools": {}, "seed": self.seed}))
        return Model(path, len(load_pack(path).objects[self.bench.name].leaves), settings)


def search(s: Search, full: Stage) -> list[Stage]:
    """The full model and the reductions that were kept, each on top of the one before."""
    stages = [full]
    for reduce in (_coarse_rest, _coarser, _leave_out, _settings):
        if s.left():
            stages += reduce(s, stages)
    return stages


def _coarse_rest(s: Search, stages: list[Stage]) -> list[Stage]:
    """Coarse where no hand comes near; finer than the full model elsewhere if it has to be."""
    own_mm = own_error_mm(s.pack.objects[s.bench.name])
    for steps in (0, *FINER):
        fine_mm = own_mm * STEP**steps
        model = s.model(fine_mm, s.bench.full.settings)
        if model.spheres >= stages[-1].trial.model.spheres or not s.left():
            break
        trial = s.judge(f"{fine_mm:.3g} mm where hands come near", model, fine_mm)
        if not trial.broken:
            what = f"within {rest_of(fine_mm, s.rest_mm):.3g} mm where no hand comes near, {fine_mm:.3g} mm elsewhere"
            return [Stage("coarse rest", what, trial, fine_mm)]
    return []


def _coarser(s: Search, stages: list[Stage]) -> list[Stage]:
    """The largest error where hands come near: steps that grow while limits hold, then the middle of what is left."""
    own_mm = own_error_mm(s.pack.objects[s.bench.name])
    if len(stages) > 1 and stages[-1].fine_mm < own_mm * (1 - 1e-9):
        return []  # it had to be finer already
    good, best, bad = 0, None, COARSER[-1] + 1
    while bad - good > 1 and s.left():
        ahead = [steps for steps in COARSER if good < steps < bad]
        steps = ahead[0] if ahead and bad > COARSER[-1] else (good + bad) // 2
        fine_mm = own_mm * STEP**steps
        if fine_mm > s.rest_mm:
            bad = steps
            continue
        model = s.model(fine_mm, s.bench.full.settings)
        trial = s.judge(f"{fine_mm:.3g} mm where hands come near", model, fine_mm)
        if trial.broken:
            bad = steps
        else:
            good = steps
            if model.spheres < (best or stages[-1]).trial.model.spheres:
                best = Stage("coarser contact", f"within {fine_mm:.3g} mm where hands come near", trial, fine_mm)
    return [best] if best else []


def _leave_out(s: Search, stages: list[Stage]) -> list[Stage]:
    """Parts of the hand that never came within the guard distance touch nothing."""
    if not s.left_out:
        return []
    last = stages[-1]
    what = f"{', '.join(s.left_out)} out of contact"
    model = last.trial.model
    changed = Model(model.pack, model.spheres, {**model.settings, "leave_out": "+".join(s.left_out)})
    trial = s.judge(what, changed, last.fine_mm)
    return [] if trial.broken else [Stage("parts left out", what, trial, last.fine_mm)]


def _settings(s: Search, stages: list[Stage]) -> list[Stage]:
    """Cheaper settings, one name after the other, chosen by their answers; all of them are then judged at once.

    If they break a limit the last of them is taken back, and so on.
    """
    last = stages[-1]
    chain = [last.trial]
    for name, values in SETTINGS:
        for value in values:
            if not s.left():
                break
            model = chain[-1].model
            trial = try_answer(
                s.bench, Model(model.pack, model.spheres, {**model.settings, name: value}), s.traces, s.rows
            )
            saved = _saves(trial, chain[-1])
            if trial.broken or not saved:
                s.note(f"{name} {value:g}", last.fine_mm, trial, "" if saved else "saves nothing")
                break
            chain.append(trial)
    while len(chain) > 1 and s.left():
        what = ", ".join(f"{key} {value:g}" for key, value in chain[-1].model.settings.items() if key in dict(SETTINGS))
        trial = s.note(what, last.fine_mm, s.place(what, chain.pop()))
        if not trial.broken:
            return [Stage("settings", what, trial, last.fine_mm)]
    return []


def _saves(trial: Trial, before: Trial) -> bool:
    """Whether a step takes fewer operations, in the mean or in its tail, and more in neither."""
    saved = [1 - trial.operations[stat] / before.operations[stat] for stat in ("mean", "p99")]
    return max(saved) >= GAIN and min(saved) >= -GAIN


def parts_left_out(part_m: dict[str, float], guard_m: float) -> list[str]:
    """Parts of the hand that never came within the guard; none if that is all of them."""
    found = [part for part, gap in part_m.items() if gap > guard_m]
    return found if len(found) < len(part_m) else []
