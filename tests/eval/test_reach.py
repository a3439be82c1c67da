"""What hands came near, how far runs differ, and how limits are set: each held against a case that is known."""

import dataclasses

import numpy as np
import pytest
from made_trace import make_trace

from palmar import load_pack, read_run
from palmar.eval.gap import capsule_point_gap
from palmar.eval.judge import graphic_poses, shape_in_object
from palmar.eval.reach import SLACK_M, find_reach, part_gap
from palmar.eval.tuned import RULES, broken, combined, held, judge_answer
from palmar.model import FINGERS
from palmar.records import write_trace
from palmar.replay import replay_file
from palmar.seen import beyond, pack_balls, unpack_balls
from palmar.tools.lean import balls_over
from palmar.tools.pack import build
from palmar.tools.region import Regions


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """A pack with a coarse cube, and a short run of a hand that comes down onto it."""
    folder = tmp_path_factory.mktemp("reach")
    rows = [f"{x},{y},{z},0.02" for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.02, 0.02)]
    (folder / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    build(["shape:cube"], folder / "cube.pack", spheres_csv=folder / "cube.csv")
    write_trace(folder / "down.mcap", make_trace(80))
    replay_file(folder / "cube.pack", folder / "down.mcap", folder / "a.run.mcap")
    return folder, load_pack(folder / "cube.pack"), read_run(folder / "a.run.mcap")


def test_no_point_near_the_hand_is_missed_and_none_far_from_it_counts(pressed):
    _, pack, run = pressed
    points = np.random.default_rng(1).uniform(-0.12, 0.12, (400, 3))
    shape = shape_in_object(pack.hand, graphic_poses(run), run)
    gap = np.full(len(points), np.inf)
    by_part = dict.fromkeys(FINGERS, np.inf)
    for k in range(15):
        c1, c2 = shape.c1[:, k, None], shape.c2[:, k, None]
        away = capsule_point_gap(c1, shape.r1[k], c2, shape.r2[k], points[None]).min(axis=0)
        gap = np.minimum(gap, away)
        by_part[FINGERS[k // 3]] = min(by_part[FINGERS[k // 3]], away.min())
    palm = np.linalg.norm(shape.palm[:, :, None] - points, axis=3) - shape.palm_radius[:, None]
    gap = np.minimum(gap, palm.min(axis=(0, 1)))

    reach = find_reach([run], pack, points, 0.01)
    assert reach.reached[gap <= 0.01].all()
    # Balls bulge out of a capsule by 0.15 mm, radii are rounded up by 0.25, a place stands for others SLACK_M off.
    assert not reach.reached[gap > 0.01 + SLACK_M + 6e-4].any()
    assert 0 < reach.reached.sum() < len(points)
    for finger, least in by_part.items():
        if least < 0.01:
            assert max(least - SLACK_M - 6e-4, 0) <= reach.part_m[finger] + 1e-12 <= max(least, 0) + 1e-12


def test_balls_hold_all_that_was_reached_and_little_else():
    points = np.stack(np.meshgrid(*[np.linspace(0, 0.1, 81)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    reached = np.linalg.norm(points - [0.03, 0.05, 0], axis=1) < 0.025
    balls = balls_over(points, reached, 0.005)
    away = np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    held_by = (away <= 0).any(axis=1)
    assert held_by[reached].all()
    from_reached = np.linalg.norm(points - [0.03, 0.05, 0], axis=1) - 0.025
    assert from_reached[held_by].max() <= 0.005  # a guard
    assert len(balls) < 60
    again = unpack_balls(pack_balls(balls))
    assert (np.linalg.norm(again[:, :3] - balls[:, :3], axis=1) + balls[:, 3] <= again[:, 3] + 1e-12).all()
    assert Regions(balls, np.full(len(balls), 0.5)).zone_of(points).astype(bool).tolist() == held_by.tolist()


def test_how_far_a_contact_lies_outside_is_its_distance_from_what_was_seen(pressed):
    _, _, run = pressed
    assert run.contacts.any()
    ball = {"seen": [0, 0, 0, 10_000]}  # a metre about the object
    assert beyond(run, ball).max() == 0
    moved = dataclasses.replace(run, object_position_m=run.object_position_m + np.array([0, 0, -2.0]))
    at = moved.contact_start[np.flatnonzero(np.diff(moved.contact_start) == 1)[0]]
    step = np.flatnonzero(np.diff(moved.contact_start) == 1)[0]
    point = moved.contact_point_m[at] - moved.object_position_m[step]
    assert beyond(moved, ball)[step] == pytest.approx(np.linalg.norm(point) - 1.0, abs=1e-12)
    assert (beyond(moved, ball)[np.diff(moved.contact_start) == 0] == 0).all()


def test_differences_are_those_that_were_made(pressed):
    _, pack, run = pressed
    same = judge_answer(run, run, pack)["values"]
    assert set(same.values()) == {0.0}
    moved = dataclasses.replace(run, palm_position_m=run.palm_position_m + np.array([0.003, 0, 0]))
    assert judge_answer(moved, run, pack)["values"]["pose_difference mean"] == pytest.approx(3.0, abs=1e-9)
    stronger = dataclasses.replace(
        run, palm_force_n=run.palm_force_n * 1.1, fingertip_force_n=run.fingertip_force_n * 1.1
    )
    values = judge_answer(stronger, run, pack)["values"]
    assert 0 < values["force_difference mean"] <= values["force_difference max"] <= 10 + 1e-9


def test_a_part_that_is_left_out_touches_nothing_and_the_rest_is_as_before(pressed):
    folder, pack, run = pressed
    settings = {"leave_out": "palm+thumb+index+middle+ring+little"}
    replay_file(folder / "cube.pack", folder / "down.mcap", folder / "b.run.mcap", settings=settings)
    free = read_run(folder / "b.run.mcap")
    assert free.contacts.max() == 0 and free.status.max() == 0
    assert np.abs(free.flexion_rad - free.haptic_flexion_rad).max() < 1e-9
    assert np.abs(free.palm_position_m - free.haptic_palm_position_m).max() < 1e-9
    # What never touches may be left out, to the bit.
    far = [finger for k, finger in enumerate(FINGERS) if not np.isin(run.contact_link, 1 + 3 * k + np.arange(3)).any()]
    idle = [part for part in far if part_gap(run, pack, "cube", [part]).min() > 0.004]
    if idle:
        settings = {"leave_out": "+".join(idle)}
        replay_file(folder / "cube.pack", folder / "down.mcap", folder / "c.run.mcap", settings=settings)
        assert np.array_equal(read_run(folder / "c.run.mcap").flexion_rad, run.flexion_rad)


def test_a_share_of_the_room_up_to_each_limit_stays_unused():
    own = {rule.name: 0.0 for rule in RULES}
    own |= {"hover p99": 0.15, "penetration_mesh max": 0.3, "excess_force_step max": 2.0, "joint_step_excess max": 0.2}
    own["force_ripple value"] = None
    rows = {row.rule.name: row for row in held(own, {}, 0.2)}
    assert rows["hover p99"].allowed == pytest.approx(0.15 + 0.8 * 0.1)
    assert (rows["penetration_mesh max"].limit, rows["penetration_mesh max"].allowed) == pytest.approx((0.4, 0.38))
    assert rows["wrong_side sum"].allowed == 0
    assert rows["force_ripple value"].allowed is None and rows["force_ripple value"].why
    assert rows["excess_force_step max"].allowed is None  # no default limit
    assert rows["joint_step_excess max"].allowed is None and "full model" in rows["joint_step_excess max"].why
    asked = {row.rule.name: row for row in held(own, {"excess_force_step max": 3.0}, 0.5)}
    assert asked["excess_force_step max"].allowed == pytest.approx(2.5)

    values = combined([own | {"hover p99": 0.22}, own | {"hover p99": 0.24}])
    assert [row.rule.name for row in broken(list(rows.values()), values)] == ["hover p99"]
    means = combined([own | {"force_difference mean": value} for value in (10.0, 20.0)])
    assert means["force_difference mean"] == pytest.approx(15)
