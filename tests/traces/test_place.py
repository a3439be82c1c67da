import numpy as np
import pytest

from palmar.errors import PalmarError
from palmar.profile import palm_axes
from palmar.traces.kinematics import phalanges_in_palm
from palmar.traces.place import Closing, place_grasp

OPENED = np.array([[0.0, 0.05, 0.05], *[[0.1, 0.1, 0.08]] * 4])
FIST = np.array([[0.8, 0.8, 0.8], *[[1.45, 1.65, 1.0]] * 4])
PRESS_M, SQUEEZE_M = 0.0025, 0.010


def place(hand, leaves, vary_m=(0.0, 0.0), vary_rad=(0.0, 0.0, 0.0)):
    return place_grasp(
        Closing(hand, OPENED, FIST, np.zeros(5), PRESS_M, SQUEEZE_M), leaves, np.array(vary_m), np.array(vary_rad)
    )


@pytest.fixture(scope="module")
def grasps(hand, trees):
    return {name: place(hand, tree.leaves) for name, tree in trees.items()}


def palm_depth(hand, leaves, grasp):
    balls = hand.palm_spheres_m[:, :3] @ grasp.rotation.T + grasp.position_m
    apart = np.linalg.norm(balls[:, None] - leaves[None, :, :3], axis=2)
    return float((hand.palm_spheres_m[:, 3, None] + leaves[:, 3] - apart).max())


def finger_depth(hand, leaves, grasp, flexion):
    """Depth of points along the phalanges, each with the phalanx's mean radius: (5,) metres."""
    ends = phalanges_in_palm(hand, flexion[None], np.zeros((1, 5)))[0] @ grasp.rotation.T + grasp.position_m
    part = np.linspace(0, 1, 201)[:, None]
    points = ends[:, :, None, 0] + part * (ends[:, :, None, 1] - ends[:, :, None, 0])  # (5, 3, 201, 3)
    apart = np.linalg.norm(points[..., None, :] - leaves[:, :3], axis=-1) - leaves[:, 3]
    return (hand.phalanx_radius_m.mean(2) - apart.min((2, 3))).max(1)


def test_axes_of_the_reference_palm_are_those_it_is_defined_with(hand):
    palmar, distal, radial = palm_axes(hand).T
    np.testing.assert_array_equal(palmar, [0, 0, -1])
    np.testing.assert_array_equal(distal, [0, 1, 0])
    np.testing.assert_array_equal(radial, [1, 0, 0])


@pytest.mark.parametrize("name", ["rod", "marble"])
def test_palm_is_pressed_in_by_no_more_than_asked(hand, trees, name):
    leaves = trees[name].leaves
    grasp = place(hand, leaves, (0.004, -0.003), (0.05, -0.04, 0.03))
    # Along the normal the palm goes in by the press; across it, where it meets a slope, by less.
    assert 0 < palm_depth(hand, leaves, grasp) <= PRESS_M + 1e-12  # 1e-12 m: roundings


def test_palm_faces_what_it_is_pressed_on(trees, grasps):
    for name, grasp in grasps.items():
        tree = trees[name]
        back = grasp.middle_m - 0.12 * grasp.palmar
        assert np.linalg.norm(tree.leaves[:, :3] - back, axis=1).min() > 0.1
        assert np.linalg.det(grasp.rotation) == pytest.approx(1)


@pytest.mark.parametrize("name", ["rod", "ball", "ring"])
def test_all_fingers_take_hold_of_what_fits_a_hand(hand, trees, grasps, name):
    grasp = grasps[name]
    assert (grasp.hold > 0).all()
    deep = finger_depth(hand, trees[name].leaves, grasp, grasp.flexion_rad)
    assert (deep > 0).all()


def test_a_finger_stops_closing_when_it_is_deep_enough(hand, trees, grasps):
    leaves, grasp = trees["ball"].leaves, grasps["ball"]
    full = np.isclose(grasp.flexion_rad, FIST).all(axis=1)
    deep = finger_depth(hand, leaves, grasp, grasp.flexion_rad)
    assert (deep[~full] >= SQUEEZE_M - 1e-5).all()  # 1e-5 m: the points along a phalanx are 0.2 mm apart
    before = grasp.flexion_rad - (FIST - OPENED) / 64
    assert (finger_depth(hand, leaves, grasp, before)[~full] < SQUEEZE_M).all()


def test_grasp_moves_with_the_object(hand, trees, grasps):
    leaves = trees["rod"].leaves
    shift = np.array([0.3, -0.2, 0.5])
    here, there = grasps["rod"], place(hand, leaves + np.append(shift, 0))
    np.testing.assert_allclose(there.position_m, here.position_m + shift, rtol=0, atol=1e-12)  # roundings
    np.testing.assert_array_equal(there.flexion_rad, here.flexion_rad)


def test_an_object_out_of_every_reach_is_refused(hand):
    nothing = hand.palm_spheres_m.copy()
    nothing[:, :3] += [5.0, 0, 0]  # a palm far from its fingers meets nothing
    away = type(hand)(**{k: getattr(hand, k) for k in hand.__dataclass_fields__} | {"palm_spheres_m": nothing})
    with pytest.raises(PalmarError, match="E-CONF object: the palm meets it from no side"):
        place(away, np.array([[0.0, 0.0, 0.0, 0.03]]))
