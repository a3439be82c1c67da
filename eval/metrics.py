"""The table of metrics: names, formulas and limits of docs/metrics.md, from a run to rows and to one verdict."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval import force, motion, penetration, timing
from palmar.eval.case import Case, NotMeasured
from palmar.model import AssetPack
from palmar.records import Run

Array = NDArray[np.float64]
Row = dict[str, Any]
Limit = float | Callable[[Case], float | None] | None
METRICS_SCHEMA = "palmar.metrics/1"


@dataclass(frozen=True)
class Stat:
    """One number of a metric: how its values, NaN left out, become one."""

    name: str
    summary: Callable[[Any], float]
    limit: Limit = None
    unit: str | None = None  # if not the metric's
    function: Callable[[Case], Any] | None = None  # if not the metric's


@dataclass(frozen=True)
class Metric:
    """One row of the table. function: a case -> one number a step (n,), more than one (n, k), or the pack's figures."""

    name: str
    unit: str
    better: str  # "lower", or "-" for what is neither good nor bad alone
    function: Callable[[Case], Any]
    stats: tuple[Stat, ...]


def _percentile(q: float) -> Callable[[Array], float]:
    return lambda values: float(np.percentile(values, q))


def _share_above(threshold: float) -> Callable[[Array], float]:
    return lambda values: float(np.mean(values > threshold))


def _stated(figure: str) -> Callable[[Case], Any]:
    """A figure of the pack's manifest for the level of the run."""

    def find(case: Case) -> Any:
        if figure not in case.model_error:
            raise NotMeasured(f"the pack does not state {figure}")
        return case.model_error[figure]

    return find


def _pack_tolerance(case: Case) -> float | None:
    return case.tree.about.get("parameters", {}).get("error_mm")


def _steps_by_100_000(case: Case) -> float:
    return len(case.run.time_s) / 100_000


P50, P99, P999 = _percentile(50), _percentile(99), _percentile(99.9)
OF_MODEL = (
    Stat("max", itemgetter("max")),
    Stat("p99", itemgetter("p99"), _pack_tolerance),  # what --error-mm asks for; the maximum is stated beside it
    Stat("mean", itemgetter("mean")),
)

METRICS: tuple[Metric, ...] = (
    Metric(
        "penetration_spheres",
        "mm",
        "lower",
        penetration.penetration_spheres,
        (Stat("max", np.max, 0.001), Stat("p99", P99), Stat("share_above_0.1", _share_above(0.1), unit="1")),
    ),
    Metric(
        "penetration_mesh",
        "mm",
        "lower",
        penetration.penetration_mesh,
        (Stat("max", np.max, penetration.penetration_mesh_limit), Stat("p99", P99)),
    ),
    Metric("hover", "mm", "lower", penetration.hover, (Stat("max", np.max), Stat("p99", P99, 0.25))),
    Metric("wrong_side", "steps", "lower", penetration.wrong_side_steps, (Stat("sum", np.sum, 0.0),)),
    Metric("force_variation", "%", "lower", force.force_variation, (Stat("mean", np.mean), Stat("std", np.std))),
    Metric("force_variation_ratio", "1", "lower", force.force_variation_ratio, (Stat("mean", np.mean, 1.05),)),
    Metric("excess_force_step", "N", "lower", force.excess_force_step, (Stat("max", np.max, 0.05),)),
    Metric("still_force_step", "N", "lower", force.still_force_step, (Stat("max", np.max, 0.0),)),
    Metric(
        "joint_step_excess",
        "deg",
        "lower",
        motion.joint_step_excess,
        (
            Stat("max", np.max, 0.05),
            Stat("max_recovery", np.max, 2.0, function=motion.joint_step_excess_in_recovery),
        ),
    ),
    Metric(
        "free_lag",
        "deg",
        "lower",
        motion.free_lag_joints,
        (
            Stat("max_joint", np.max, 0.0),
            Stat("max_palm", np.max, 0.0, unit="mm", function=motion.free_lag_palm),
        ),
    ),
    Metric(
        "palm_offset",
        "mm",
        "lower",
        motion.palm_offset,
        (Stat("mean", np.mean), Stat("p99", P99), Stat("max", np.max)),
    ),
    Metric(
        "frozen_steps",
        "steps",
        "lower",
        motion.frozen_steps,
        (
            Stat("sum", np.sum, _steps_by_100_000),
            Stat("longest", np.max, 20.0, unit="ms", function=motion.longest_freeze_ms),
        ),
    ),
    Metric("contacts", "1", "-", timing.contacts, (Stat("mean", np.mean), Stat("max", np.max))),
    Metric(
        "step_cpu",
        "us",
        "lower",
        timing.step_cpu,
        (
            Stat("p50", P50),
            Stat("p99", P99),
            Stat("p99.9", P999),
            Stat("max", np.max),
            Stat("p50_contact", P50, function=timing.step_cpu_in_contact),
            Stat("p99_contact", P99, function=timing.step_cpu_in_contact),
        ),
    ),
    Metric(
        "step_wall",
        "us",
        "lower",
        timing.step_wall,
        (
            Stat("p50", P50),
            Stat("p99", P99),
            Stat("p99.9", P999),
            Stat("max", np.max),
            Stat("share_above_1ms", _share_above(1000.0), unit="1"),
        ),
    ),
    Metric(
        "step_operations",
        "1",
        "lower",
        timing.step_operations,
        (Stat("p50", P50), Stat("p99", P99), Stat("max", np.max)),
    ),
    Metric("protrusion", "mm", "lower", _stated("protrusion_mm"), OF_MODEL),
    Metric("gap", "mm", "lower", _stated("gap_mm"), OF_MODEL),
    Metric(
        "normal_error",
        "deg",
        "lower",
        _stated("normal_error_deg"),
        (Stat("median", itemgetter("median")), Stat("p95", itemgetter("p95"))),
    ),
    Metric("spheres", "1", "-", lambda case: np.array([len(case.spheres)]), (Stat("value", np.max),)),
)


def measure(run: Run, pack: AssetPack, object_name: str, name: str = "") -> tuple[list[Row], dict[str, Array]]:
    """Every metric of a run: rows, and series, metric -> (n,) one number a step in the metric's unit, NaN where none.

    A row is {"run", "metric", "stat", "unit", "value", "limit", "margin_db"}. Where nothing could be measured value,
    limit and margin are None and "reason" says why. margin_db = 20 log10(limit / value); None where that is not finite,
    since value or limit is 0. Raises BadPack or BadTrace if run and pack cannot be judged.
    """
    case = Case(run, pack, object_name)
    rows: list[Row] = []
    series: dict[str, Array] = {}
    for metric in METRICS:
        values = _values(metric.function, case)
        if isinstance(values, np.ndarray) and len(values) == len(run.time_s) > 1:
            # Where every value of a step is NaN the step is NaN, without numpy's warning.
            series[metric.name] = values if values.ndim == 1 else np.fmax.reduce(values, axis=1)
        for stat in metric.stats:
            of = values if stat.function is None else _values(stat.function, case)
            rows.append({"run": name, "metric": metric.name, **_row(stat, stat.unit or metric.unit, of, case)})
    return rows, series


def _values(function: Callable[[Case], Any], case: Case) -> Any:
    """What the function gives, or the reason why it gives nothing."""
    try:
        return function(case)
    except NotMeasured as reason:
        return str(reason)


def _row(stat: Stat, unit: str, values: Any, case: Case) -> Row:
    row = {"stat": stat.name, "unit": unit, "value": None, "limit": None, "margin_db": None}
    if isinstance(values, str):
        return {**row, "reason": values}
    if isinstance(values, np.ndarray):
        values = values[~np.isnan(values)]
        if not len(values):
            return {**row, "reason": "no step that counts"}
    value = float(stat.summary(values))
    if not np.isfinite(value):
        return {**row, "reason": f"the value is {value}"}
    limit = stat.limit(case) if callable(stat.limit) else stat.limit
    return {**row, "value": value, "limit": limit, "margin_db": margin_db(value, limit)}


def margin_db(value: float, limit: float | None) -> float | None:
    """20 log10(limit / value); None without a limit, and where value or limit is 0."""
    if limit is None or value <= 0 or limit <= 0:
        return None
    return float(20 * np.log10(limit / value))


def worst_margin(rows: list[Row]) -> tuple[float, Row] | None:
    """The stability score: the smallest margin of the limited rows in dB and the row that sets it; None without any.

    Infinite where value or limit is 0: +inf for a value within its limit, -inf for one beyond.
    """
    limited = [(_margin(row), row) for row in rows if row["limit"] is not None]
    return min(limited, key=itemgetter(0), default=None)


def _margin(row: Row) -> float:
    if row["margin_db"] is not None:
        return row["margin_db"]
    return np.inf if row["value"] <= row["limit"] else -np.inf


def verdict(rows: list[Row]) -> tuple[bool, str]:
    """Whether the rows of one run keep every limit, and a sentence that says so or what failed and by how much."""
    limited = [row for row in rows if row["limit"] is not None]
    worst = worst_margin(rows)
    if worst is None:
        return False, "Nothing that has a limit could be measured."
    failed = sorted((row for row in limited if row["value"] > row["limit"]), key=_margin)
    if failed:
        named = "; ".join(f"{_say(row)}, above {row['limit']:.4g} ({_decibels(_margin(row))})" for row in failed[:3])
        more = f"; and {len(failed) - 3} more" if len(failed) > 3 else ""
        return False, f"Fails {len(failed)} of {len(limited)} limits: {named}{more}. {_beside(rows)}"
    margin, row = worst
    held = f"Keeps all {len(limited)} limits: {_say(_find(rows, 'penetration_spheres', 'max'))}"
    return True, f"{held}; worst margin {_decibels(margin)} ({row['metric']} {row['stat']}). {_beside(rows)}"


def _beside(rows: list[Row]) -> str:
    """What penetration is not to be read without: the model's error, the lag, the freezes."""
    of = (("gap", "max"), ("palm_offset", "p99"), ("frozen_steps", "sum"))
    return f"Beside it: {', '.join(_say(_find(rows, *each)) for each in of)}."


def _find(rows: list[Row], metric: str, stat: str) -> Row:
    return next(row for row in rows if (row["metric"], row["stat"]) == (metric, stat))


def _say(row: Row) -> str:
    name = f"{row['metric']} {row['stat']}"
    if row["value"] is None:
        return f"{name} not measured"
    return f"{name} {row['value']:.4g}{'' if row['unit'] == '1' else ' ' + row['unit']}"


def _decibels(margin: float) -> str:
    return f"{margin:+.1f} dB" if np.isfinite(margin) else "without bound"


def metrics_json(measured: list[tuple[str, Run, list[Row]]]) -> str:
    """metrics.json of runs, each (name, run, rows of `measure`): where every number came from, and the numbers."""
    runs = []
    for name, run, _ in measured:
        header = run.header
        trace = json.loads(header.get("trace_header", "{}"))
        runs.append(
            {
                "run": name,
                "pack_sha256": header.get("pack_sha256"),
                "trace_sha256": header.get("trace_sha256"),
                "scene": header.get("scene", trace.get("scene")),
                "object": header.get("object"),
                "solver": header.get("solver"),
                "level": int(header["level"]) if "level" in header else None,
                "settings": json.loads(header.get("settings", "{}")),
                "build": json.loads(header.get("build", "{}")),
                "machine": json.loads(header.get("machine", "{}")),
            }
        )
    rows = [{**row, "run": name} for name, _, of_run in measured for row in of_run]
    return json.dumps({"schema": METRICS_SCHEMA, "runs": runs, "rows": rows}, indent=1, allow_nan=False) + "\n"
