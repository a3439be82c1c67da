"""The table of metrics: names, units and limits of docs/metrics.md, each with the function that has its formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval import contact_set, cost, energy, force, hand_mesh, motion, penetration, slide, timing
from palmar.eval.case import Case, NotMeasured

Array = NDArray[np.float64]
Limit = float | Callable[[Case], float | None] | None


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


def _operation_budget(case: Case) -> float | None:
    """What the solver may use in a step; None for a baseline, which has no budget."""
    settings = case.settings()
    return settings.get("operations") if settings.get("solver") == "progressive" else None


def _pack_bytes(case: Case) -> Array:
    if case.pack_bytes is None:
        raise NotMeasured("the pack is not a file")
    return np.array([case.pack_bytes])


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
    Metric(
        "penetration_hand_mesh",
        "mm",
        "lower",
        hand_mesh.penetration_hand_mesh,
        (Stat("max", np.max, hand_mesh.penetration_hand_mesh_limit), Stat("p99", P99)),
    ),
    Metric("hover", "mm", "lower", penetration.hover, (Stat("max", np.max), Stat("p99", P99, 0.25))),
    Metric("wrong_side", "steps", "lower", penetration.wrong_side_steps, (Stat("sum", np.sum, 0.0),)),
    Metric("force_variation", "%", "lower", force.force_variation, (Stat("mean", np.mean), Stat("std", np.std))),
    Metric("force_variation_ratio", "1", "lower", force.force_variation_ratio, (Stat("mean", np.mean, 1.05),)),
    Metric("excess_force_step", "N", "lower", force.excess_force_step, (Stat("max", np.max, 0.05),)),
    Metric("friction_force", "N", "lower", force.friction_force, (Stat("p50", P50), Stat("p99", P99))),
    Metric("still_force_step", "N", "lower", force.still_force_step, (Stat("max", np.max, 0.0),)),
    Metric(
        "contact_toggles",
        "1",
        "lower",
        contact_set.contact_toggles,
        (Stat("sum", np.sum, 0.0, unit="1/s", function=contact_set.contact_toggles_a_second),),
    ),
    Metric("force_above_20hz", "N", "lower", slide.force_above_20hz, (Stat("value", np.max, 0.1),)),
    Metric("force_ripple", "N", "lower", slide.force_ripple, (Stat("value", np.max, 0.14),)),
    Metric("energy_generated", "%", "lower", energy.energy_generated, (Stat("max", np.max, 1.0),)),
    Metric("energy_lost", "%", "lower", energy.energy_lost, (Stat("value", np.max),)),
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
        "cost_excess",
        "%",
        "lower",
        cost.cost_excess,
        (
            Stat("mean", np.mean, 5.0),
            Stat("p99", P99),
            Stat("mean_own", np.mean, function=cost.cost_excess_own),
            Stat("p99_own", P99, function=cost.cost_excess_own),
        ),
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
    Metric("recovery", "ms", "lower", lambda case: _recovery_ms(case), (Stat("max", np.max),)),
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
        (Stat("p50", P50), Stat("p99", P99), Stat("max", np.max, _operation_budget)),
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
    Metric("bytes", "1", "-", _pack_bytes, (Stat("value", np.max),)),
)


def values_of(function: Callable[[Case], Any], case: Case) -> Any:
    """What the function gives, or the reason why it gives nothing."""
    try:
        return function(case)
    except NotMeasured as reason:
        return str(reason)


def limit_of(metric: Metric, stat: Stat, case: Case) -> tuple[float | None, str]:
    """The limit of a number on this run, and the scene's reason where the scene sets it."""
    own = case.limits_of_scene.get(f"{metric.name} {stat.name}")
    if own is not None:
        return own["limit"], own["reason"]
    return (stat.limit(case) if callable(stat.limit) else stat.limit), ""


# What has to be within its limit again after a disturbance, by the first number of each.
RECOVERS = (
    "penetration_spheres",
    "penetration_mesh",
    "wrong_side",
    "excess_force_step",
    "still_force_step",
    "joint_step_excess",
    "frozen_steps",
)


def _recovery_ms(case: Case) -> Array:
    """(k,) ms from the end of each phase named disturbance to the end of the last step with a value above its limit.

    Counted up to the next disturbance or the end of the run.
    """
    ends = sorted(phase["end_s"] for phase in case.run.phases if phase["name"] == "disturbance")
    if not ends:
        raise NotMeasured("no phase named disturbance")
    outside = np.zeros(len(case.run.time_s), dtype=bool)
    for metric in METRICS:
        if metric.name in RECOVERS:
            values, limit = values_of(metric.function, case), limit_of(metric, metric.stats[0], case)[0]
            if isinstance(values, np.ndarray) and limit is not None:
                outside |= values > limit
    outside &= ~case.in_phase("disturbance")
    times = case.run.time_s
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else 1e-3
    bad_s = times[outside]
    found = []
    for end, following in zip(ends, [*ends[1:], np.inf], strict=True):
        after = bad_s[(bad_s >= end) & (bad_s < following)]
        found.append(1e3 * (after[-1] + step_s - end) if len(after) else 0.0)
    return np.array(found)
