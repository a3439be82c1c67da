"""Each metric says exactly what was planted, and says why where it has nothing to say."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palmar.errors import BadPack, BadTrace
from palmar.eval import judge
from palmar.eval.metrics import METRICS, margin_db, measure, metrics_json, verdict, worst_margin

# A box from -20 to 20 mm, as in conftest.
BOX = 0.02 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
HOLD = [{"name": "hold", "start_s": 0.0, "end_s": 1.0}]
FAR = [[0, 0, -1.0, 0.01]]  # a leaf that nothing comes near


def value(rows, metric, stat):
    row = next(row for row in rows if (row["metric"], row["stat"]) == (metric, stat))
    return row["value"] if row["value"] is not None else row["reason"]


def away(n):
    """Palm positions half a metre off the box of the pack."""
    return np.tile([0.0, 0, 0.5], (n, 1))


def held(make_run, n=200, noise_m=0.0, seed=7):
    """A graphic hand at rest and the haptic hand 2 mm below it, 2 N at every fingertip, with noise."""
    depth = 0.002 + noise_m * np.random.default_rng(seed).normal(size=n)
    run = make_run(n, HOLD, palm_position_m=away(n))
    return replace(run, haptic_palm_position_m=run.palm_position_m - depth[:, None] * [0, 0, 1])


def with_forces(run, hand):
    force = judge.fingertip_force(hand, judge.graphic_poses(run), judge.haptic_poses(run))
    return replace(run, fingertip_force_n=force)


def test_fingertip_force_is_stiffness_times_the_way_across_the_distal_phalanx(hand, make_run):
    run = make_run(1)
    lower = replace(run, haptic_palm_position_m=np.array([[0, 0.005, -0.002]]))
    force = judge.fingertip_force(hand, judge.graphic_poses(lower), judge.haptic_poses(lower))
    assert force[0] == pytest.approx(np.tile([0, 0, 2.0], (5, 1)), abs=1e-12)  # newtons; 5 mm along y count nothing


def test_a_frozen_hand_has_the_variation_of_its_sensor_and_nothing_more(hand, make_pack, make_run):
    run = with_forces(held(make_run, noise_m=1e-5), hand)
    rows, series = measure(run, make_pack(FAR), "thing")
    assert value(rows, "force_variation_ratio", "mean") == pytest.approx(1, abs=1e-12)
    # White noise of 0.01 mm on 2 mm: mean |difference| is sigma 2 / sqrt(pi), 0.56 %; 199 samples scatter by 5 %.
    assert value(rows, "force_variation", "mean") == pytest.approx(0.56, rel=0.15)
    assert np.isnan(series["force_variation"][0]) and np.isfinite(series["force_variation"][1:]).all()
    assert value(rows, "excess_force_step", "max") < 1e-12  # newtons, rounding


def test_a_hand_that_adds_its_own_noise_has_a_ratio_above_one(hand, make_pack, make_run):
    run = held(make_run, noise_m=1e-5)
    jitter = 2e-5 * np.random.default_rng(8).normal(size=(len(run.time_s), 1)) * [0, 0, 1]
    rows, _ = measure(
        with_forces(replace(run, palm_position_m=run.palm_position_m + jitter), hand), make_pack(FAR), "thing"
    )
    # sigma grows from 0.01 to sqrt(0.01^2 + 0.02^2)
    assert value(rows, "force_variation_ratio", "mean") == pytest.approx(np.sqrt(5), rel=0.2)


def test_the_ratio_of_a_hold_without_noise_has_no_value_but_a_reason(hand, make_pack, make_run):
    rows, _ = measure(with_forces(held(make_run), hand), make_pack(FAR), "thing")
    assert "constant" in value(rows, "force_variation_ratio", "mean")
    assert value(rows, "still_force_step", "max") == 0


def test_a_forgotten_contact_is_seen_though_the_variation_stays_small(hand, make_pack, make_run):
    run = with_forces(held(make_run, n=400), hand)
    force = run.fingertip_force_n.copy()
    force[50::50, 1, 2] -= 0.6  # one step in 50, the index finger loses 0.6 N of its 2 N
    rows, _ = measure(replace(run, fingertip_force_n=force), make_pack(FAR), "thing")
    assert value(rows, "force_variation", "mean") < 0.6  # per cent: nothing to notice
    assert value(rows, "excess_force_step", "max") == pytest.approx(0.6, abs=1e-12)
    assert value(rows, "still_force_step", "max") == pytest.approx(0.6, abs=1e-12)
    passed, sentence = verdict(rows)
    assert not passed and "still_force_step max 0.6 N" in sentence and "excess_force_step max 0.6 N" in sentence


def test_a_fade_is_no_jump_but_what_grows_in_it_or_faster_than_it_is(hand, make_pack, make_run):
    gain = np.ones(300)
    gain[100:120] = np.linspace(0.95, 0, 20)  # lost: 2 N are gone in 20 steps, 0.1 N each
    gain[120:200] = 0
    gain[200:] = np.linspace(0.01, 1, 100)  # and grow back in 0.1 s
    status = np.zeros(300, dtype=np.uint32)
    status[100:200], status[200:299] = 16, 1
    run = with_forces(held(make_run, n=300), hand)
    run = replace(run, status=status, fingertip_force_n=run.fingertip_force_n * gain[:, None, None])
    assert value(measure(run, make_pack(FAR), "thing")[0], "excess_force_step", "max") < 1e-12  # newtons, rounding
    for step, excess in ((110, 0.2), (150, 0.3), (250, 0.3)):  # in the fade, which takes 0.1 N of it; lost; on its way
        force = run.fingertip_force_n.copy()
        force[step, 1, 2] += 0.3
        rows, _ = measure(replace(run, fingertip_force_n=force), make_pack(FAR), "thing")
        assert value(rows, "excess_force_step", "max") == pytest.approx(excess, abs=1e-10)


def test_a_still_hand_is_held_to_the_last_bit(hand, make_pack, make_run):
    run = with_forces(held(make_run), hand)
    force = run.fingertip_force_n.copy()
    force[100:, 3, 2] = np.nextafter(force[100, 3, 2], 3)
    rows, _ = measure(replace(run, fingertip_force_n=force), make_pack(FAR), "thing")
    assert 0 < value(rows, "still_force_step", "max") < 1e-15
    assert not verdict(rows)[0]


def test_the_first_ten_steps_after_the_input_settles_may_still_change(hand, make_pack, make_run):
    run = with_forces(held(make_run, n=40), hand)
    force = run.fingertip_force_n.copy()
    force[:10] *= np.linspace(0.5, 1, 10)[:, None, None]
    rows, _ = measure(replace(run, fingertip_force_n=force), make_pack(FAR), "thing")
    assert value(rows, "still_force_step", "max") == 0


def test_force_that_follows_the_haptic_hand_is_no_excess_and_a_jump_beyond_it_is(hand, make_pack, make_run):
    n = 30
    down = 1e-4 * np.arange(n)[:, None] * [0, 0, -1]
    run = make_run(n, palm_position_m=away(n))
    run = with_forces(replace(run, haptic_palm_position_m=run.palm_position_m + down), hand)
    rows, _ = measure(run, make_pack(FAR), "thing")
    assert value(rows, "excess_force_step", "max") < 1e-10  # newtons, rounding
    force = run.fingertip_force_n.copy()
    force[20:, 0, 2] += 0.3
    rows, _ = measure(replace(run, fingertip_force_n=force), make_pack(FAR), "thing")
    assert value(rows, "excess_force_step", "max") == pytest.approx(0.3, abs=1e-10)


def test_hover_is_the_gap_of_the_phalanges_that_report_contact(make_pack, make_run):
    # The middle finger lies straight along y over the box's face at z = 20 mm. The ball at the thick end of its first
    # phalanx has radius 8 mm / cos(phi), and its centre, moved back by 8 mm tan(phi), is over the face.
    lift_mm = np.array([0.0, 0.3, 0.5, -0.1])
    height = 0.02 + 0.008 * np.sqrt(1 + (0.0005 / 0.03) ** 2) + 1e-3 * lift_mm
    run = make_run(
        4, palm_position_m=np.stack([0 * height, 0 * height - 0.06, height], axis=1), contact_links={1: [7], 3: [0, 7]}
    )
    rows, series = measure(run, make_pack(FAR), "thing")
    # mm; the search along the axis ends within 0.001
    assert series["hover"] == pytest.approx([np.nan, 0.3, np.nan, 0], nan_ok=True, abs=1e-3)
    assert value(rows, "hover", "max") == pytest.approx(0.3, abs=1e-3)


def test_joint_step_excess_is_beyond_the_haptic_joint_or_one_degree(make_pack, make_run):
    flexion = np.zeros((6, 5, 3))
    flexion[2:, 1, 1] = np.radians(3)
    run = make_run(6, palm_position_m=away(6), flexion_rad=flexion)
    rows, _ = measure(run, make_pack(FAR), "thing")
    assert value(rows, "joint_step_excess", "max") == 0
    still = replace(run, haptic_flexion_rad=np.zeros_like(flexion))
    rows, series = measure(still, make_pack(FAR), "thing")
    assert value(rows, "joint_step_excess", "max") == pytest.approx(2, abs=1e-12)
    assert np.nanargmax(series["joint_step_excess"]) == 2
    named = replace(still, header={"phases": json.dumps([{"name": "recovery", "start_s": 0.0015, "end_s": 0.0035}])})
    rows, _ = measure(named, make_pack(FAR), "thing")
    assert value(rows, "joint_step_excess", "max") == 0
    assert value(rows, "joint_step_excess", "max_recovery") == pytest.approx(2, abs=1e-12)


def test_free_lag_counts_where_nothing_is_near_for_a_while_and_only_there(make_pack, make_run):
    n = 120
    run = make_run(n, palm_position_m=np.tile([0.0, -0.015, 0.1], (n, 1)))
    lagging = replace(
        run,
        haptic_palm_position_m=run.palm_position_m - np.array([0, 0, 1e-5]),
        haptic_abduction_rad=np.full((n, 5), 1e-4),
    )
    rows, _ = measure(lagging, make_pack(FAR), "thing")
    assert value(rows, "free_lag", "max_palm") == pytest.approx(0.01, abs=1e-12)
    assert value(rows, "free_lag", "max_joint") == pytest.approx(np.degrees(1e-4), abs=1e-12)
    # A swing back that is over in time is no lag.
    rows, _ = measure(replace(lagging, time_s=1e-4 * np.arange(n)), make_pack(FAR), "thing")
    assert "nothing near" in value(rows, "free_lag", "max_palm")
    # The same lag with a sphere nearer than the haptic hand is: nothing to blame the hand for.
    touched = make_pack([[-0.02, -0.015, 0.08, 0.01 - 5e-6]])
    rows, _ = measure(lagging, touched, "thing")
    assert "nothing near" in value(rows, "free_lag", "max_palm")


def test_frozen_steps_are_counted_and_the_longest_timed(make_pack, make_run):
    status = np.zeros(100, dtype=np.uint32)
    status[[10, 11, 12, 40, 41]] = 8
    status[60] = 2
    rows, _ = measure(make_run(100, palm_position_m=away(100), status=status), make_pack(FAR), "thing")
    assert value(rows, "frozen_steps", "sum") == 5
    assert value(rows, "frozen_steps", "longest") == pytest.approx(3, abs=1e-9)  # ms


def test_step_times_are_summed_up_over_all_steps_and_over_steps_in_contact(make_pack, make_run):
    run = make_run(100, palm_position_m=away(100), cpu_us=np.arange(100.0), wall_us=20.0 * np.arange(100))
    rows, _ = measure(replace(run, contacts=(np.arange(100) >= 90).astype(np.uint32)), make_pack(FAR), "thing")
    assert value(rows, "step_cpu", "p50") == 49.5 and value(rows, "step_cpu", "max") == 99
    assert value(rows, "step_cpu", "p50_contact") == 94.5
    assert value(rows, "step_wall", "share_above_1ms") == 0.49
    assert value(rows, "contacts", "mean") == 0.1
    rows, _ = measure(replace(run, cpu_us=np.full(100, np.nan)), make_pack(FAR), "thing")
    assert "no timing" in value(rows, "step_cpu", "p99") and "no step in contact" in value(
        rows, "step_cpu", "p99_contact"
    )


def test_figures_of_the_model_come_from_the_pack_and_widen_the_mesh_limit(make_pack, make_run):
    rows, _ = measure(make_run(2, palm_position_m=away(2)), make_pack(FAR), "thing")
    assert (value(rows, "gap", "max"), value(rows, "protrusion", "p99"), value(rows, "normal_error", "p95")) == (
        0.4,
        0.05,
        9,
    )
    limits = {(row["metric"], row["stat"]): row["limit"] for row in rows}
    assert limits["penetration_mesh", "max"] == pytest.approx(0.5)
    assert limits["gap", "p99"] == limits["protrusion", "p99"] == 0.5
    rows, _ = measure(make_run(2, palm_position_m=away(2)), make_pack(FAR, about={"levels": [{}]}), "thing")
    assert "does not state" in value(rows, "gap", "max")
    assert next(row for row in rows if row["metric"] == "penetration_mesh")["limit"] is None


def jumping(make_run, hand, at, phases, **header):
    """A hand at rest, 2 N at each fingertip, whose force jumps by 0.3 N in the steps `at`."""
    run = with_forces(held(make_run), hand)
    force = run.fingertip_force_n.copy()
    for step in at:
        force[step:, 0, 2] += 0.3
    named = [{"name": name, "start_s": start, "end_s": end} for name, start, end in phases]
    return replace(run, fingertip_force_n=force, header={"phases": json.dumps(named)} | header)


def test_recovery_is_the_time_to_the_last_step_outside_a_limit_before_the_next_disturbance(hand, make_pack, make_run):
    disturbed = [("disturbance", 0.0495, 0.0595), ("disturbance", 0.1195, 0.1295), ("disturbance", 0.1795, 0.1895)]
    run = jumping(make_run, hand, [55, 60, 72, 100, 125, 130], disturbed)
    rows, _ = measure(run, make_pack(FAR), "thing")
    # Step 100 ends 41.5 ms after the first disturbance, 130 1.5 ms after the second; nothing follows the third.
    assert value(rows, "recovery", "max") == pytest.approx(41.5, abs=1e-9)
    rows, _ = measure(jumping(make_run, hand, [30, 55], disturbed), make_pack(FAR), "thing")
    assert value(rows, "recovery", "max") == 0
    rows, _ = measure(jumping(make_run, hand, [30], []), make_pack(FAR), "thing")
    assert "disturbance" in value(rows, "recovery", "max")


def test_a_limit_of_the_scene_takes_the_place_of_the_default_and_its_reason_is_kept(hand, make_pack, make_run):
    own = {
        "excess_force_step max": {"limit": 0.5, "reason": "an edge"},
        "still_force_step max": {"limit": None, "reason": "a fault is planted"},
        "recovery max": {"limit": 20, "reason": "a tenth of a blink"},
    }
    trace = json.dumps({"limits": json.dumps(own)})
    run = jumping(make_run, hand, [100], [("disturbance", 0.05, 0.09)], trace_header=trace)
    rows, _ = measure(run, make_pack(FAR), "thing")
    by_key = {f"{row['metric']} {row['stat']}": row for row in rows}
    assert [by_key[key]["limit"] for key in own] == [0.5, None, 20]
    assert [by_key[key]["reason_limit"] for key in own] == ["an edge", "a fault is planted", "a tenth of a blink"]
    assert by_key["excess_force_step max"]["margin_db"] == pytest.approx(20 * np.log10(0.5 / 0.3), abs=1e-9)
    assert by_key["recovery max"]["value"] == 0  # by the scene's limits, not the default ones
    assert "reason_limit" not in by_key["hover p99"]
    assert verdict(rows)[0]


@pytest.mark.parametrize("text", ["[]", "{", '{"hover p99": 1}', '{"hover p99": {"limit": "x", "reason": ""}}'])
def test_limits_that_cannot_be_read_are_refused(make_pack, make_run, text):
    run = make_run(3, palm_position_m=away(3), header={"trace_header": json.dumps({"limits": text})})
    with pytest.raises(BadTrace, match="limits"):
        measure(run, make_pack(FAR), "thing")


def test_a_hand_gone_through_a_plate_is_on_the_wrong_side_in_every_step_that_it_stays_there(make_pack, make_run):
    plate = BOX * [1, 1, 0.05]  # 2 mm thick
    over = np.where(np.arange(30) < 10, 0.05, -0.05)  # jumps from 50 mm above to 50 mm below, and is free there
    at = np.stack([0 * over, 0 * over - 0.06, over], axis=1)
    region = [{"half_spaces": [[0, 0, -1, 0.001], [1, 0, 0, -0.02], [-1, 0, 0, -0.02]], "links": [7, 8, 9]}]
    for far_side, steps in (([], 1), (region, 20)):
        header = {"trace_header": json.dumps({"far_side": json.dumps(far_side)})}
        run = make_run(30, palm_position_m=at, header=header)
        rows, series = measure(run, make_pack(FAR, plate), "thing", only=("wrong_side",))
        assert value(rows, "wrong_side", "sum") == steps
        assert series["wrong_side"][10] == 1 and not series["wrong_side"][:10].any()


def test_only_the_metrics_asked_for_are_worked_out(make_pack, make_run):
    run = make_run(20, palm_position_m=away(20))
    rows, series = measure(run, make_pack(FAR), "thing", only=("palm_offset", "wrong_side"))
    assert {row["metric"] for row in rows} == set(series) == {"palm_offset", "wrong_side"}
    assert verdict(rows) == (True, "Keeps all 1 limits: wrong_side sum 0 steps; worst margin without bound (wrong_side "
                             "sum). Beside it: palm_offset p99 0 mm.")  # fmt: skip


def test_the_budget_of_operations_is_a_limit_where_the_solver_has_one(make_pack, make_run):
    used = np.array([10, 20, 30], dtype=np.uint32)
    run = make_run(3, palm_position_m=away(3), operations=used)
    budget = {"solver": "progressive", "operations": 25}
    for settings, limit in (({}, None), (budget, 25), (budget | {"solver": "paper"}, None)):
        rows, _ = measure(replace(run, header={"settings": json.dumps(settings)}), make_pack(FAR), "thing")
        row = next(row for row in rows if (row["metric"], row["stat"]) == ("step_operations", "max"))
        assert (row["value"], row["limit"]) == (30, limit)


def test_bytes_are_those_of_the_pack_file(make_pack, make_run):
    run = make_run(3, palm_position_m=away(3))
    assert value(measure(run, make_pack(FAR), "thing", pack_bytes=12345)[0], "bytes", "value") == 12345
    assert "not a file" in value(measure(run, make_pack(FAR), "thing")[0], "bytes", "value")


def test_margin_is_in_decibels_and_the_worst_one_is_named():
    assert margin_db(0.1, 1.0) == pytest.approx(20)
    assert margin_db(0.0, 1.0) is None and margin_db(1.0, 0.0) is None and margin_db(1.0, None) is None

    def row(metric, value, limit):
        return {
            "metric": metric,
            "stat": "max",
            "unit": "mm",
            "value": value,
            "limit": limit,
            "margin_db": margin_db(value, limit),
        }

    rows = [row("a", 0.1, 1.0), row("b", 0.5, 1.0), row("c", 0.0, 0.0), row("d", 9.0, None)]
    margin, worst = worst_margin(rows)
    assert worst["metric"] == "b" and margin == pytest.approx(6.0206, abs=1e-4)
    assert worst_margin([*rows, row("e", 1e-3, 0.0)])[0] == -np.inf
    # Of what is above 0 by rounding alone: a real failure says more, what holds says less.
    rounding = row("f", 1e-9, 0.0)
    assert worst_margin([rounding, row("g", 2.0, 1.0)])[1]["metric"] == "g"
    assert worst_margin([rounding, *rows]) == (-np.inf, rounding)


def test_a_good_run_passes_and_the_verdict_says_what_stands_beside_it(make_pack, make_run):
    rows, _ = measure(make_run(50, palm_position_m=away(50)), make_pack(FAR), "thing")
    passed, sentence = verdict(rows)
    assert passed
    for part in (
        "penetration_spheres max 0 mm",
        "worst margin",
        "gap max 0.4 mm",
        "palm_offset p99 0 mm",
        "frozen_steps sum 0",
    ):
        assert part in sentence


def test_metrics_json_is_plain_json_with_the_origin_of_every_run(make_pack, make_run):
    header = {
        "pack_sha256": "ab",
        "trace_sha256": "cd",
        "solver": "progressive",
        "level": "0",
        "settings": '{"iterations": 4}',
        "trace_header": '{"scene": "grasp"}',
    }
    run = make_run(3, palm_position_m=away(3), header=header)
    rows, _ = measure(run, make_pack(FAR), "thing")
    text = metrics_json([("first", run, rows), ("second", run, rows)])
    found = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert found["schema"] == "palmar.metrics/1"
    assert found["runs"][1] | {"build": 0, "machine": 0} == {
        "run": "second",
        "pack_sha256": "ab",
        "trace_sha256": "cd",
        "scene": "grasp",
        "object": None,
        "solver": "progressive",
        "level": 0,
        "settings": {"iterations": 4},
        "build": 0,
        "machine": 0,
    }
    assert {row["run"] for row in found["rows"]} == {"first", "second"}
    assert all({"metric", "stat", "unit", "value", "limit", "margin_db"} <= row.keys() for row in found["rows"])
    assert all((row["value"] is None) == ("reason" in row) for row in found["rows"])


def test_series_have_one_number_a_step(make_pack, make_run):
    _, series = measure(make_run(7, palm_position_m=away(7), contact_links={2: [4]}), make_pack(FAR), "thing")
    assert {"penetration_spheres", "penetration_mesh", "hover", "palm_offset", "step_cpu"} <= series.keys()
    assert all(values.shape == (7,) for values in series.values())


def test_a_run_that_cannot_be_judged_is_refused(make_pack, make_run):
    run = make_run(3, palm_position_m=away(3))
    with pytest.raises(BadPack, match="thing"):
        measure(run, make_pack(FAR), "cup")
    with pytest.raises(BadPack, match="levels 0 to 0"):
        measure(replace(run, header={"level": "6"}), make_pack(FAR), "thing")
    broken = run.fingertip_force_n.copy()
    broken[1, 2, 0] = np.nan
    with pytest.raises(BadTrace, match=re.escape("fingertip_force_n[1, 2, 0]")):
        measure(replace(run, fingertip_force_n=broken), make_pack(FAR), "thing")


def test_every_metric_and_stat_of_the_table_is_in_the_documents_and_no_other():
    text = (Path(__file__).resolve().parents[2] / "docs" / "metrics.md").read_text()
    documented = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) > 5 and re.fullmatch(r"`\w+`", cells[1]):
            documented[cells[1].strip("`")] = re.findall(r"`([\w.]+)`", cells[3])
    assert documented == {metric.name: [stat.name for stat in metric.stats] for metric in METRICS}
