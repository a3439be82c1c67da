"""What goes wrong in a solver is planted in a real run, and the metric meant for it sees it.

The run is a hand that presses 3 mm into a ball of one sphere, slides over it, rests, and leaves.
"""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from palmar import _runtime, read_run, reference, save_pack
from palmar.eval import judge
from palmar.eval.case import Reference
from palmar.eval.metrics import measure
from palmar.model import load_pack
from palmar.records import Trace, write_trace

RADIUS_M = 0.02
POSE = reference.POSE
ALIKE = {"palm_priority": 1.0, "imposed_priority": 1.0}  # palm and fingers yield alike, as in the reference


@pytest.fixture
def pressed(make_pack, hand, tmp_path):
    """(run, pack, path of the pack)"""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    figures = {"max": 0.0, "p99": 0.0, "mean": 0.0}  # the mesh is inside the sphere
    about = {"levels": [{"protrusion_mm": figures, "gap_mm": figures, "normal_error_deg": {"median": 0.0, "p95": 0.0}}]}
    made = make_pack([[0, 0, 0, RADIUS_M]], ball.vertices, ball.faces.astype(np.int32), about)
    pack = tmp_path / "ball.pack"
    save_pack(pack, made)

    # The first phalanx of the middle finger comes down on the ball.
    key_s = [0.0, 0.2, 0.3, 0.7, 0.9, 1.1, 1.2]
    key_mm = np.array(
        [[0, -40, 45], [0, -40, 31], [0, -40, 25], [6, -46, 25], [6, -46, 25], [6, -46, 45], [0, -40, 45]]
    )
    time_s = 1e-3 * np.arange(1200)
    at = np.empty((len(time_s), 3))
    for (a, b), (p, q) in zip(pairwise(key_s), pairwise(key_mm), strict=True):
        u = np.clip((time_s - a) / (b - a), 0, 1)[:, None]
        inside = time_s >= a
        at[inside] = (1e-3 * (p + (q - p) * u * u * (3 - 2 * u)))[inside]
    phases = [("slide", 0.3, 0.7), ("hold", 0.7, 0.9)]
    count = len(time_s)
    trace = Trace(
        header={
            "schema": "palmar.trace/1",
            "device": "made",
            "hand": "made",
            "side": "right",
            "phases": json.dumps([{"name": name, "start_s": a, "end_s": b} for name, a, b in phases]),
        },
        time_s=time_s,
        palm_position_m=at,
        palm_rotation_wxyz=np.tile([1.0, 0, 0, 0], (count, 1)),
        flexion_rad=np.zeros((count, 5, 3)),
        abduction_rad=np.zeros((count, 5)),
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0, 0, 0], (count, 1)),
    )
    write_trace(tmp_path / "ball.mcap", trace)
    _runtime.replay(str(pack), str(tmp_path / "ball.mcap"), str(tmp_path / "ball.run.mcap"), "", ALIKE, {})
    return read_run(tmp_path / "ball.run.mcap"), load_pack(pack), pack


def outside(run, pack, path):
    """The numbers above their limit, as "metric stat"."""
    same_start = Reference(reference.same_start(run, path))
    rows, _ = measure(run, pack, "thing", reference=same_start)
    return {
        f"{row['metric']} {row['stat']}" for row in rows if row["limit"] is not None and row["value"] > row["limit"]
    }


def with_graphic(run, hand, steps, source):
    """The run with the graphic poses of `steps` taken from rows `source`, and the forces that follow from them."""
    changed = {}
    for name in POSE:
        changed[name] = getattr(run, name).copy()
        changed[name][steps] = getattr(run, name)[source]
    return with_forces(replace(run, **changed), hand)


def with_forces(run, hand):
    graphic, haptic = judge.graphic_poses(run), judge.haptic_poses(run)
    palm = hand.palm_stiffness_n_per_m * (run.palm_position_m - run.haptic_palm_position_m)
    return replace(run, fingertip_force_n=judge.fingertip_force(hand, graphic, haptic), palm_force_n=palm)


def sunk(run, hand, steps):
    """The run with the graphic hand at the haptic one, without contact, in `steps`; nothing said about it."""
    at = {name: getattr(run, name).copy() for name in POSE}
    for name in POSE:
        at[name][steps] = getattr(run, f"haptic_{name}")[steps]
    count = np.diff(run.contact_start)
    kept = ~np.repeat(np.isin(np.arange(len(count)), steps), count)
    contacts = {name: getattr(run, name)[kept] for name in run.__dataclass_fields__ if name.startswith("contact_")
                and name != "contact_start"}  # fmt: skip
    count[steps] = 0
    start = np.concatenate([[0], np.cumsum(count)])
    return with_forces(replace(run, **at, **contacts, contact_start=start, contacts=count.astype(np.uint32)), hand)


def test_the_run_as_it_is_keeps_every_limit(pressed):
    run, pack, path = pressed
    assert run.contacts[400:900].all() and run.fingertip_force_n[700].any()  # it does touch
    assert outside(run, pack, path) == set()


def test_a_converged_run_is_its_own_reference(pressed):
    run, _, path = pressed
    answer = reference.same_start(run, path)
    known = np.isfinite(answer.palm_position_m).all(axis=1)
    assert known.sum() == reference.MOST_STEPS
    assert run.contacts[known].all()  # it is asked where something holds the hand
    # metres; the run's own steps end when a round moves the hand by less than 5 um
    assert answer.palm_position_m[known] == pytest.approx(run.palm_position_m[known], abs=1e-6)
    assert answer.flexion_rad[known] == pytest.approx(run.flexion_rad[known], abs=1e-5)  # rad


def test_a_hand_that_sinks_in_all_the_time_has_no_reference(pressed, hand):
    run, _, path = pressed
    answer = reference.same_start(sunk(run, hand, np.arange(1200)[run.contacts > 0]), path)
    assert np.isnan(answer.palm_position_m).all()


def test_a_contact_dropped_one_step_in_fifty_is_seen_as_depth_as_force_and_as_toggles(pressed, hand):
    run, pack, path = pressed
    assert outside(sunk(run, hand, np.arange(325, 900, 50)), pack, path) == {
        "penetration_spheres max",
        "penetration_mesh max",
        "excess_force_step max",
        "still_force_step max",
        "contact_toggles sum",
        "force_above_20hz value",
        "energy_generated max",
    }


def test_a_hand_that_freezes_and_says_nothing_is_seen_by_what_it_costs(pressed, hand):
    run, pack, path = pressed
    frozen = with_graphic(run, hand, np.arange(600, 1200), 600)
    assert outside(frozen, pack, path) == {"cost_excess mean"}


def test_a_hand_five_steps_late_is_seen_by_its_lag_and_by_what_it_costs(pressed, hand):
    run, pack, path = pressed
    late = with_graphic(run, hand, np.arange(5, 1200), np.arange(1195))
    assert outside(late, pack, path) == {"free_lag max_palm", "cost_excess mean"}


@pytest.mark.parametrize(("up_m", "seen"), [(0.001, "penetration_mesh max"), (-0.001, "hover p99")])
def test_a_mesh_shifted_against_its_spheres_is_seen_as_depth_or_as_hover(pressed, up_m, seen):
    run, pack, path = pressed
    tree = pack.objects["thing"]
    moved = replace(tree, vertices_m=tree.vertices_m + np.array([0, 0, up_m]))
    assert outside(run, replace(pack, objects={"thing": moved}), path) == {seen}


def test_depth_that_the_solver_states_as_zero_is_depth(pressed, hand):
    run, pack, path = pressed
    down = 2e-4 * (run.contacts > 0)[:, None] * [0, 0, 1]
    deep = replace(run, palm_position_m=run.palm_position_m - down, contact_gap_m=np.zeros_like(run.contact_gap_m))
    found = outside(with_forces(deep, hand), pack, path)
    # It sinks in and comes out again at once, which is a jump of force, and one that nobody paid for.
    assert found == {
        "penetration_spheres max",
        "penetration_mesh max",
        "excess_force_step max",
        "energy_generated max",
    }
