"""The metrics of docs/metrics.md: from a run to rows, and from rows to one verdict."""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case, Reference
from palmar.eval.table import METRICS, Metric, Stat, limit_of, values_of
from palmar.model import AssetPack
from palmar.records import Run

Array = NDArray[np.float64]
Row = dict[str, Any]
METRICS_SCHEMA = "palmar.metrics/1"
ROUNDING = 1e-6  # in the unit of a metric whose limit is 0


def measure(
    run: Run,
    pack: AssetPack,
    object_name: str,
    name: str = "",
    only: Collection[str] | None = None,
    *,
    pack_bytes: int | None = None,
    reference: Reference | None = None,
) -> tuple[list[Row], dict[str, Array]]:
    """The metrics of a run: rows, and series, metric -> (n,) one number a step in the metric's unit, NaN where none.

    only: names of the metrics to work out; all if left out. A row is {"run", "metric", "stat", "unit", "value",
    "limit", "margin_db"}. Where nothing could be measured value, limit and margin are None and "reason" says why; where
    the scene sets the limit "reason_limit" says why. margin_db = 20 log10(limit / value); None where that is not
    finite, since value or limit is 0. Raises BadPack or BadTrace if run and pack cannot be judged.
    """
    return measure_case(Case(run, pack, object_name, pack_bytes, reference), name, only)


def measure_case(case: Case, name: str = "", only: Collection[str] | None = None) -> tuple[list[Row], dict[str, Array]]:
    """What `measure` says, of a case whose gaps may be asked for again."""
    rows: list[Row] = []
    series: dict[str, Array] = {}
    for metric in METRICS:
        if only is not None and metric.name not in only:
            continue
        values = values_of(metric.function, case)
        if isinstance(values, np.ndarray) and len(values) == len(case.run.time_s) > 1:
            # Where every value of a step is NaN the step is NaN, without numpy's warning.
            series[metric.name] = values if values.ndim == 1 else np.fmax.reduce(values, axis=1)
        for stat in metric.stats:
            of = values if stat.function is None else values_of(stat.function, case)
            rows.append({"run": name, "metric": metric.name, **_row(metric, stat, of, case)})
    return rows, series


def _row(metric: Metric, stat: Stat, values: Any, case: Case) -> Row:
    unit = stat.unit or metric.unit
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
    limit, reason = limit_of(metric, stat, case)
    row |= {"value": value, "limit": limit, "margin_db": margin_db(value, limit)}
    return {**row, "reason_limit": reason} if reason else row


def margin_db(value: float, limit: float | None) -> float | None:
    """20 log10(limit / value); None without a limit, and where value or limit is 0."""
    if limit is None or value <= 0 or limit <= 0:
        return None
    return float(20 * np.log10(limit / value))


def worst_margin(rows: list[Row]) -> tuple[float, Row] | None:
    """The stability score: the smallest margin of the limited rows in dB and the row that sets it; None without any.

    Infinite where value or limit is 0: +inf for a value within its limit, -inf for one beyond. A row that is beyond by
    rounding alone stands for the run only where no other fails.
    """
    limited = [(_margin(row), row) for row in rows if row["limit"] is not None]
    return min(limited, key=lambda pair: standing(*pair), default=None)


def by_rounding(row: Row) -> bool:
    """Whether the value is above a limit of 0 by so little that nobody could feel or see it."""
    return bool(row["limit"] == 0 and 0 < row["value"] < ROUNDING)


def standing(margin: float, row: Row) -> float:
    """What margins are put in order by: behind all that fail otherwise comes what fails by rounding."""
    return -1e-9 if by_rounding(row) else margin


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
    first = next((row for row in rows if (row["metric"], row["stat"]) == ("penetration_spheres", "max")), row)
    held = f"Keeps all {len(limited)} limits: {_say(first)}"
    return True, f"{held}; worst margin {_decibels(margin)} ({row['metric']} {row['stat']}). {_beside(rows)}"


def _beside(rows: list[Row]) -> str:
    """What penetration is not to be read without: the model's error, the lag, its cost, the freezes."""
    of = (("gap", "max"), ("palm_offset", "p99"), ("cost_excess", "mean"), ("frozen_steps", "sum"))
    found = [_say(row) for key in of for row in rows if (row["metric"], row["stat"]) == key]
    return f"Beside it: {', '.join(found)}." if found else ""


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
