"""Where two runs part, and which number of a pack is another."""

from dataclasses import replace

import numpy as np

from palmar.eval.compare import compare_runs, first_different, inputs, what_differs
from palmar.eval.matrix import worst_step
from palmar.eval.metrics import measure


def test_the_same_run_twice_is_equal(make_run):
    told = compare_runs(make_run(20), make_run(20))
    assert told["equal"] and told["first_step"] is None and told["first_asked"] is None and told["header"] == {}
    assert all(row["value"] == 0 for row in told["largest"].values())


def test_one_bit_of_a_pose_is_the_first_differing_step_and_the_largest_difference_is_named_with_its_step(make_run):
    flexion = np.zeros((20, 5, 3))
    flexion[7, 2, 1] = 5e-324  # the smallest number there is
    flexion[12, 1, 0] = np.radians(3)
    told = compare_runs(make_run(20), make_run(20, flexion_rad=flexion, haptic_flexion_rad=np.zeros((20, 5, 3))))
    assert not told["equal"] and told["first_step"] == 7 and told["first_asked"] is None
    assert told["largest"]["flexion"]["step"] == 12 and abs(told["largest"]["flexion"]["value"] - 3) < 1e-12


def test_runs_of_other_length_differ_where_the_shorter_ends_and_headers_by_key(make_run):
    told = compare_runs(
        make_run(20, header={"settings": '{"iterations": 4, "rate_hz": 1000}', "solver": "a"}),
        make_run(15, header={"settings": '{"iterations": 8, "rate_hz": 1000}', "solver": "b"}),
    )
    assert told["first_step"] == 15 and told["steps"] == [20, 15]
    assert told["header"] == {"settings.iterations": [4, 8], "solver": ["a", "b"]}


def test_a_series_differs_by_more_than_its_tolerance_or_by_what_was_not_measured():
    a, b = np.array([0.0, 1.0, np.nan, 2.0]), np.array([0.05, 1.2, np.nan, np.nan])
    assert first_different(a, b) == 0
    assert first_different(a, b, 0.1) == 1
    assert first_different(a, b, 1.0) == 3
    assert first_different(a, a) is None


def test_the_number_of_the_hand_or_the_sphere_that_is_another_is_named(make_pack):
    leaves = np.array([[0, 0, 0.001 * k, 0.01] for k in range(5)])
    before = inputs(make_pack(leaves), "thing")
    moved = leaves.copy()
    moved[3, 3] += 1e-6
    assert what_differs(before, inputs(make_pack(leaves), "thing")) == []
    assert what_differs(before, inputs(make_pack(moved), "thing")) == ["object.spheres_m differs, of 5 first number 3"]
    pack = make_pack(leaves)
    limits = pack.hand.flexion_limit_rad.copy()
    limits[1, 0, 1] = 1.5
    pack = replace(pack, hand=replace(pack.hand, flexion_limit_rad=limits))
    assert what_differs(before, inputs(pack, "thing")) == ["hand.flexion_limit_rad[1, 0, 1] was 2, is 1.5"]


def test_friction_is_what_the_contacts_normals_leave_of_the_palms_force(make_pack, make_run):
    links = {step: [4, 7] for step in range(10)}
    normal = np.tile([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], (10, 1))
    force = np.tile([2.0, 0.5], 10)
    palm = np.tile([0.5, 0.0, 2.0], (10, 1))
    run = make_run(10, contact_links=links, contact_normal=normal, contact_force_n=force, palm_force_n=palm)
    pack = make_pack([[0, 0, 1, 0.01]])

    def p99(run):
        rows, _ = measure(run, pack, "thing", only=["friction_force"])
        return rows[1]["value"]

    assert p99(run) < 1e-12
    dragged = palm + np.array([0.0, 0.3, 0.0])  # across both normals
    run = make_run(10, contact_links=links, contact_normal=normal, contact_force_n=force, palm_force_n=dragged)
    assert abs(p99(run) - 0.3) < 1e-12


def test_the_worst_step_is_that_of_the_metric_or_else_of_the_largest_force_jump(make_run):
    force = np.zeros((20, 5, 3))
    force[11:, 0, 0] = 2.0
    run = make_run(20, fingertip_force_n=force)
    values = np.zeros(20)
    assert worst_step(run, "wrong_side", {"wrong_side": values}) == 11
    values[4] = 1
    assert worst_step(run, "wrong_side", {"wrong_side": values}) == 4
    assert worst_step(run, "end_offset", {}) == 19
