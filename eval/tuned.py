"""What a leaner model is held to: limits beside what the full one does on the same traces, and what it comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.judge import fingertips, graphic_poses
from palmar.eval.metrics import measure
from palmar.model import AssetPack
from palmar.records import Run

Array = NDArray[np.float64]
Values = dict[str, float | None]  # by "metric stat"; None where nothing could be measured

FLOOR_N = 2.0  # a force that is smaller is held against this: differences of less than 0.14 N are not felt
# A finger joint's angle is told apart from 2.5 degrees on (Tan et al. 1994): 2 mm at a fingertip 50 mm off the joint.
FELT_MM = 2.0
FELT_SHARE = 7.0  # % of a force that is just felt (Pang, Tan and Durlach 1991)
ROUNDING = 1e-12
MESH_MM = 0.1  # beyond the full model's own depth: what the paper states as its own


@dataclass(frozen=True)
class Rule:
    """One number that a leaner model is held to. limit: None where it is shown alone, unless asked for."""

    metric: str
    stat: str
    unit: str
    limit: float | None = None
    beyond_own: bool = False  # the limit counts from what the full model does

    @property
    def name(self) -> str:
        return f"{self.metric} {self.stat}"


RULES = (
    Rule("penetration_spheres", "max", "mm", 0.001),
    Rule("penetration_mesh", "max", "mm", MESH_MM, beyond_own=True),
    Rule("hover", "p99", "mm", 0.25),
    Rule("wrong_side", "sum", "steps", 0.0),
    Rule("frozen_steps", "sum", "steps", 0.0),
    Rule("force_above_20hz", "value", "N", 0.1),
    Rule("force_ripple", "value", "N", 0.14),
    Rule("still_force_step", "max", "N", 0.0),
    Rule("contact_toggles", "sum", "1/s", 0.0),
    Rule("joint_step_excess", "max", "deg", 0.05),
    Rule("free_lag", "max_joint", "deg", 0.0),
    Rule("free_lag", "max_palm", "mm", 0.0),
    Rule("force_difference", "mean", "%", FELT_SHARE, beyond_own=True),
    Rule("pose_difference", "mean", "mm", FELT_MM, beyond_own=True),
    Rule("force_difference", "max", "%"),
    Rule("pose_difference", "max", "mm"),
    Rule("excess_force_step", "max", "N"),
    Rule("palm_offset", "max", "mm"),
)
DIFFERENCES = ("force_difference", "pose_difference")


@dataclass(frozen=True)
class Held:
    """A rule on some traces: what the full model does, the limit, and how much of it may be used in the search."""

    rule: Rule
    own: float | None
    limit: float | None  # None: shown alone
    allowed: float | None
    why: str = ""  # the limit is not held

    def breaks(self, value: float | None) -> bool:
        return self.allowed is not None and value is not None and value > self.allowed + ROUNDING


def judge_answer(run: Run, full: Run, pack: AssetPack) -> dict[str, Any]:
    """The part of RULES that needs no distances, quick: how a run's answer differs from the full model's.

    {"values": by "metric stat", "operations": {"mean", "p99", "max"}}.
    """
    values = {}
    for metric, series in (
        ("force_difference", force_difference(run, full)),
        ("pose_difference", pose_difference(run, full, pack)),
    ):
        at = full.contacts > 0
        values[f"{metric} mean"] = float(series[at].mean()) if at.any() else 0.0
        values[f"{metric} max"] = float(series.max())
    used = run.operations.astype(np.float64)
    operations = {"mean": float(used.mean()), "p99": float(np.percentile(used, 99)), "max": float(used.max())}
    return {"values": values, "operations": operations}


def judge_place(run: Run, pack: AssetPack, name: str) -> dict[str, Any]:
    """The rest of RULES: {"values": by "metric stat"}. Raises BadPack, BadTrace."""
    names = {rule.metric for rule in RULES} - set(DIFFERENCES)
    rows, _ = measure(run, pack, name, only=names)
    found = {f"{row['metric']} {row['stat']}": row["value"] for row in rows}
    wanted = [rule.name for rule in RULES if rule.metric in names]
    return {"values": {key: None if found[key] is None else found[key] + 0.0 for key in wanted}}  # no -0


def force_difference(run: Run, full: Run) -> Array:
    """(n,) %: largest difference of the force on a fingertip or the palm, by that of the full model, 2 N at least."""
    own = np.concatenate([full.fingertip_force_n, full.palm_force_n[:, None]], axis=1)
    away = np.concatenate([run.fingertip_force_n, run.palm_force_n[:, None]], axis=1) - own
    return 100 * (np.linalg.norm(away, axis=2) / np.maximum(np.linalg.norm(own, axis=2), FLOOR_N)).max(axis=1)


def pose_difference(run: Run, full: Run, pack: AssetPack) -> Array:
    """(n,) mm: farthest that a fingertip or the palm of the graphic hand is from that of the full model."""
    tips = fingertips(pack.hand, graphic_poses(run)) - fingertips(pack.hand, graphic_poses(full))
    palm = run.palm_position_m - full.palm_position_m
    return 1e3 * np.maximum(np.linalg.norm(tips, axis=2).max(axis=1), np.linalg.norm(palm, axis=1))


def combined(values: Sequence[Values]) -> Values:
    """Of each number the largest over the traces, of mean differences their mean; None where no trace has it."""
    found: Values = {}
    for rule in RULES:
        known = [value for each in values if (value := each.get(rule.name)) is not None]
        mean = rule.metric in DIFFERENCES and rule.stat == "mean"
        found[rule.name] = None if not known else float(np.mean(known)) if mean else max(known)
    return found


def held(own: Values, asked: Mapping[str, float], margin: float) -> list[Held]:
    """The rules beside the full model's values. asked: limits by "metric stat" instead of the defaults.

    own: of differences those of another model as full as the full one: nothing leaner can be asked for less.

    A share `margin` of the room between what the full model does and the limit is not to be used. A limit that the full
    model itself is beyond says nothing of a leaner one, and is not held unless it was asked for.
    """
    rows = []
    for rule in RULES:
        value = own[rule.name]
        limit = asked.get(rule.name, rule.limit)
        if limit is None or value is None:
            rows.append(Held(rule, value, None, None, "" if limit is None else "not measured on these traces"))
            continue
        if rule.beyond_own and rule.name not in asked:
            limit += value
        if value > limit and rule.name not in asked:
            rows.append(Held(rule, value, limit, None, "the full model itself is beyond it"))
        else:
            rows.append(Held(rule, value, limit, min(limit, value + (1 - margin) * max(limit - value, 0.0))))
    return rows


def broken(rows: Sequence[Held], values: Values) -> list[Held]:
    """Those of the limits that these values are beyond what is allowed of."""
    return [row for row in rows if row.breaks(values.get(row.rule.name))]
