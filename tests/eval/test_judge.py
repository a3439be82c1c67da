"""The judge against constructions of another kind, and planted faults that it must see as exactly what they are."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from palmar.eval import judge
from palmar.eval.gap import Mesh


def some_hand(hand):
    """The hand with every axis, joint and angle general, so that no error of order or sign can hide."""
    rng = np.random.default_rng(3)

    def units(*shape):
        axes = rng.normal(size=(*shape, 3))
        return axes / np.linalg.norm(axes, axis=-1, keepdims=True)

    phalanx = hand.phalanx_m + 0.004 * rng.normal(size=hand.phalanx_m.shape)
    return replace(hand, flexion_axis=units(5, 3), abduction_axis=units(5), phalanx_m=phalanx)


def some_poses(n, seed=4):
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=(n, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return judge.Poses(0.1 * rng.normal(size=(n, 3)), turn, rng.normal(size=(n, 5, 3)), rng.normal(size=(n, 5)))


def test_kinematics_equal_turns_about_carried_axes(hand):
    hand = some_hand(hand)
    poses = some_poses(3)
    centres, _ = judge._capsules_at_rest(hand)
    c1, _, c2, _ = judge.phalanx_capsules(hand, poses)
    w, x, y, z = poses.palm_rotation_wxyz.T
    palm = Rotation.from_quat(np.stack([x, y, z, w], axis=1))
    for i in range(3):
        for f in range(5):
            # From the palm outwards: each turn carries every later joint, axis and point along.
            joints, axes, points = hand.joint_m[f].copy(), hand.flexion_axis[f].copy(), centres[f].copy()
            first = Rotation.from_rotvec(poses.abduction_rad[i, f] * hand.abduction_axis[f])
            joints, axes = first.apply(joints - joints[0]) + joints[0], first.apply(axes)
            points = first.apply(points.reshape(-1, 3) - hand.joint_m[f, 0]).reshape(3, 2, 3) + hand.joint_m[f, 0]
            for j in range(3):
                turn = Rotation.from_rotvec(poses.flexion_rad[i, f, j] * axes[j])
                points[j:] = (turn.apply(points[j:].reshape(-1, 3) - joints[j]) + joints[j]).reshape(-1, 2, 3)
                axes[j:] = turn.apply(axes[j:])
                joints[j:] = turn.apply(joints[j:] - joints[j]) + joints[j]
            world = palm[i].apply(points.reshape(-1, 3)).reshape(3, 2, 3) + poses.palm_position_m[i]
            # metres; rounding of a few products of numbers below 1
            assert c1[i, 3 * f : 3 * f + 3] == pytest.approx(world[:, 0], abs=1e-15)
            assert c2[i, 3 * f : 3 * f + 3] == pytest.approx(world[:, 1], abs=1e-15)


def test_tapered_capsule_touches_the_frustum_side_from_rim_to_rim(hand):
    at_rest = judge.Poses(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 5, 3)), np.zeros((1, 5)))
    c1, r1, c2, r2 = judge.phalanx_capsules(hand, at_rest)
    d, e = hand.phalanx_m[2, 2]
    for k in np.linspace(0, 1, 5):
        rim = (1 - k) * d + k * e + ((1 - k) * 0.007 + k * 0.006) * np.array([0.6, 0, 0.8])
        gap = judge.capsule_point_gap(c1[0, 8], r1[8], c2[0, 8], r2[8], rim)
        assert gap == pytest.approx(0, abs=1e-16)  # metres


def wandering_run(make_run, n=400, seed=5):
    """A hand that wanders away from the origin with a jump now and then, and an object that moves too."""
    rng = np.random.default_rng(seed)

    def walk(size, *shape):
        return size * np.cumsum(rng.normal(size=(n, *shape)), axis=0) / np.sqrt(n)

    jumps = np.where(rng.random((n, 1)) < 0.02, 0.02 * rng.normal(size=(n, 3)), 0)
    turns = Rotation.from_rotvec(walk(0.7, 3)).as_quat()[:, [3, 0, 1, 2]]
    return make_run(
        n,
        palm_position_m=walk(0.04, 3) + np.cumsum(jumps, axis=0) + np.linspace([0, -0.06, 0], [0, -0.06, 0.1], n),
        palm_rotation_wxyz=turns,
        flexion_rad=walk(0.5, 5, 3),
        abduction_rad=walk(0.2, 5),
        object_position_m=walk(0.01, 3),
        object_rotation_wxyz=Rotation.from_rotvec(walk(0.3, 3)).as_quat()[:, [3, 0, 1, 2]],
    )


def test_sphere_gap_equals_every_pair_at_every_step(hand, make_run):
    run = wandering_run(make_run, n=150)
    rng = np.random.default_rng(6)
    leaves = np.hstack([0.02 * rng.normal(size=(60, 3)), rng.uniform(0.0005, 0.01, (60, 1))])
    shape = judge.shape_in_object(hand, judge.graphic_poses(run), run)
    phalanges = judge.capsule_point_gap(
        shape.c1[:, :, None], shape.r1[:, None], shape.c2[:, :, None], shape.r2[:, None], leaves[:, :3]
    )
    palm = np.linalg.norm(shape.palm[:, :, None] - leaves[:, :3], axis=-1) - shape.palm_radius[:, None]
    every = np.concatenate([phalanges, palm], axis=1) - leaves[:, 3]
    for band in (0.001, 0.05):
        judged = judge.sphere_gap(shape, leaves, band_m=band)
        assert judged == pytest.approx(np.minimum(every.min(axis=(1, 2)), band), abs=1e-15)
    assert (every.min(axis=(1, 2)) > 0.001).any() and (every.min(axis=(1, 2)) < 0).any()


def test_skipping_steps_loses_no_gap_to_the_mesh(hand, make_run):
    run = wandering_run(make_run, n=200)
    mesh_of_ball = trimesh.creation.icosphere(subdivisions=2, radius=0.025)
    mesh = Mesh(mesh_of_ball.vertices, mesh_of_ball.faces)
    shape = judge.shape_in_object(hand, judge.graphic_poses(run), run)
    phalanges, palm = judge.mesh_gap(shape, mesh, band_m=0.0005)
    each = judge.gap_to_mesh(shape, mesh, np.ones((200, 15), dtype=bool))
    centres = mesh.closest(shape.palm.reshape(-1, 3))[0].reshape(200, -1) - shape.palm_radius
    # metres; either search stops within its tolerance
    assert phalanges == pytest.approx(np.minimum(each, 0.0005), abs=judge.TOLERANCE_M)
    assert palm == pytest.approx(np.minimum(centres, 0.0005), abs=1e-15)
    assert (each < 0).any() and (each > 0.0005).any()


def test_gaps_do_not_change_when_hand_and_object_are_moved_together(hand, make_pack, make_run):
    run = wandering_run(make_run, n=50)
    far = Rotation.from_rotvec([0.3, -2.0, 1.1])

    def turned(wxyz):
        return (far * Rotation.from_quat(wxyz[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]

    shift = np.array([0.3, 0.5, -0.2])
    moved = replace(
        run,
        palm_position_m=far.apply(run.palm_position_m) + shift,
        palm_rotation_wxyz=turned(run.palm_rotation_wxyz),
        object_position_m=far.apply(run.object_position_m) + shift,
        object_rotation_wxyz=turned(run.object_rotation_wxyz),
    )
    pack = make_pack([[0, 0, 0, 0.02], [0.01, 0, 0.01, 0.02]])
    for depth, tolerance in ((judge.penetration_spheres, 1e-15), (judge.penetration_mesh, judge.TOLERANCE_M)):
        assert depth(pack, moved, "thing") == pytest.approx(depth(pack, run, "thing"), abs=tolerance)
    assert judge.penetration_mesh(pack, run, "thing").max() > 0


def resting_on_top(make_run, n=5, lift=0.0):
    """The palm spheres of the hand rest on the plane z = 20 mm: palm at z = 30 mm, fingers bent up and away."""
    return make_run(
        n,
        palm_position_m=np.tile([0.0, -0.015, 0.03 + lift], (n, 1)),
        flexion_rad=np.full((n, 5, 3), [-0.5, -0.3, -0.3]),
    )


def test_a_run_shifted_into_the_object_is_seen_as_exactly_that(hand, make_pack, make_run):
    # A sphere under each palm sphere, its top at z = 20 mm as the box's.
    pack = make_pack([[x, y - 0.015, 0.01, 0.01] for x in (-0.02, 0.02) for y in (0, 0.03)])
    touching = resting_on_top(make_run)
    assert judge.penetration_spheres(pack, touching, "thing").max() < 1e-15  # metres, rounding
    assert judge.penetration_mesh(pack, touching, "thing").max() < 1e-15
    shift = np.array([0, 1, 0, 2, 0]) * 5e-5
    shifted = replace(touching, palm_position_m=touching.palm_position_m - shift[:, None] * [0, 0, 1])
    assert judge.penetration_spheres(pack, shifted, "thing") == pytest.approx(shift, abs=1e-15)
    assert judge.penetration_mesh(pack, shifted, "thing") == pytest.approx(shift, abs=1e-15)


def finger_over_plate(make_run, heights):
    """The hand flat over the plate with its palm far off to the side, at given heights of the fingers' axes."""
    heights = np.asarray(heights, dtype=float)
    return make_run(len(heights), palm_position_m=np.stack([0 * heights, 0 * heights - 0.1, heights], axis=1))


@pytest.fixture
def plate(make_pack):
    """2 mm thick, top at z = 1 mm, under the fingers only."""
    box = trimesh.creation.box((0.2, 0.05, 0.002))
    return make_pack([[0, 0, 0, 0.001]], box.vertices, box.faces)


def wrong_steps(pack, run):
    tree = pack.objects["thing"]
    mesh = Mesh(tree.vertices_m, tree.faces)
    shape = judge.shape_in_object(pack.hand, judge.graphic_poses(run), run)
    return np.flatnonzero(judge.wrong_side(shape, mesh, *judge.mesh_gap(shape, mesh))).tolist()


def test_a_link_that_went_through_a_plate_in_one_step_is_on_the_wrong_side(plate, make_run):
    # Between step 1 and 2 every axis jumps from clear above to clear below; nothing is ever inside the plate.
    assert wrong_steps(plate, finger_over_plate(make_run, [0.03, 0.02, -0.02, -0.03])) == [2]


def test_a_link_that_jumps_past_the_plate_beside_it_is_not(plate, make_run):
    run = finger_over_plate(make_run, [0.03, 0.02, -0.02, -0.03])
    beside = replace(run, palm_position_m=run.palm_position_m + np.array([0, 0.2, 0]))
    assert wrong_steps(plate, beside) == []


def test_an_axis_inside_the_plate_is_on_the_wrong_side_and_a_deep_press_is_not(plate, make_run):
    # Axes at 4 mm are 4 mm deep by their radius yet above the plate; at 0.5 mm they are inside it.
    assert wrong_steps(plate, finger_over_plate(make_run, [0.02, 0.004, 0.004, 0.0005, 0.004])) == [3, 4]


def test_a_plate_that_moves_through_a_still_hand_is_seen(plate, make_run):
    run = finger_over_plate(make_run, [0.02] * 4)
    moving = replace(run, object_position_m=np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.05], [0, 0, 0.05]], dtype=float))
    assert wrong_steps(plate, moving) == [2]


def test_a_palm_sphere_that_went_through_is_seen(plate, make_run):
    run = finger_over_plate(make_run, [0.03, 0.03, -0.03])
    over = replace(run, palm_position_m=run.palm_position_m + np.array([0, 0.085, 0]))
    # Without its palm spheres nothing of this hand crosses: the fingers are past the plate.
    assert wrong_steps(plate, over) == [2]
    bare = replace(plate, hand=replace(plate.hand, palm_spheres_m=np.array([[1.0, 0, 0, 0.01]])))
    assert wrong_steps(bare, over) == []
