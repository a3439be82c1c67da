import json
import tomllib

import numpy as np
import pytest

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS
from palmar.pack_check import HAND_SHAPES
from palmar.tools.hand_file import read_hand
from palmar.traces.adroit_hand import (
    FINGER_JOINTS,
    FROZEN_RAD,
    JOINTS,
    PALM_BODIES,
    adroit_hand_toml,
    chain_points,
    chain_poses,
    fit_angles,
    hand_model,
    load_chain,
)
from palmar.traces.kinematics import finger_points


@pytest.fixture(scope="module")
def json_path(shared):
    return shared / "traces" / "adroit_door" / "adroit_hand.json"


@pytest.fixture(scope="module")
def chain(json_path):
    return load_chain(json_path)[0]


@pytest.fixture(scope="module")
def adroit(json_path):
    return hand_model(*load_chain(json_path))


def random_angles(chain, count=50):
    """Angles uniform over the limits of every joint."""
    generator = np.random.default_rng(0)
    limits = {joint["column"][2:]: joint["range"] for body in chain for joint in body["joints"]}
    return {name: generator.uniform(*limits[name], count) for name in JOINTS}


def matrix(pos, quat):
    """4 x 4 transform, the rotation written out from w x y z."""
    w, x, y, z = np.array(quat) / np.linalg.norm(quat)
    m = np.eye(4)
    m[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    m[:3, 3] = pos
    return m


def test_chain_poses_are_products_of_transforms(chain):
    angles = {name: values[:3] for name, values in random_angles(chain).items()}
    poses = chain_poses(chain, angles)
    for i in range(3):
        world = {None: np.eye(4)}
        for body in chain:
            world[body["name"]] = world[body["parent"]] @ matrix(body["pos"], body["quat"])
            for joint in body["joints"]:
                half = angles[joint["column"][2:]][i] / 2
                axis = np.array(joint["axis"]) / np.linalg.norm(joint["axis"])
                turn = matrix([0, 0, 0], [np.cos(half), *(np.sin(half) * axis)])
                world[body["name"]] = world[body["name"]] @ turn
            # 1e-14 m: roundings along seven products
            np.testing.assert_allclose(poses[body["name"]][1][i], world[body["name"]][:3, 3], rtol=0, atol=1e-14)
            np.testing.assert_allclose(poses[body["name"]][0][i], world[body["name"]][:3, :3], rtol=0, atol=1e-14)


@pytest.mark.parametrize("finger", FINGERS)
def test_model_is_the_chain_while_the_missing_joints_stand_still(chain, adroit, finger):
    angles = random_angles(chain) | {name: np.full(50, value) for name, value in FROZEN_RAD.items()}
    model_angles = np.stack([sign * angles[name] for name, sign in FINGER_JOINTS[finger]], axis=1)
    expected = chain_points(chain, chain_poses(chain, angles), finger)
    # 1e-14 m: roundings; the two chains are the same
    np.testing.assert_allclose(finger_points(adroit, FINGERS.index(finger), model_angles), expected, rtol=0, atol=1e-14)


def test_fitted_angles_are_exact_while_the_missing_joints_stand_still(chain, adroit):
    angles = random_angles(chain) | {name: np.full(50, value) for name, value in FROZEN_RAD.items()}
    flexion, abduction, tip_error_m = fit_angles(chain, adroit, angles)
    for f, finger in enumerate(FINGERS):
        expected = np.stack([sign * angles[name] for name, sign in FINGER_JOINTS[finger]], axis=1)
        # 1e-13 rad: roundings of points of 0.1 m, of which the fitted fingers are made
        np.testing.assert_allclose(abduction[:, f], expected[:, 0], rtol=0, atol=1e-13)
        np.testing.assert_allclose(flexion[:, f], expected[:, 1:], rtol=0, atol=1e-13)
    assert tip_error_m.max() < 1e-14  # roundings


def test_positive_flexion_closes_every_finger(adroit):
    # Out of the palm is -y in the Adroit hand's palm frame.
    for f in range(1, 5):
        straight, bent = finger_points(adroit, f, np.array([[0.0, 0, 0, 0], [0, 0.5, 0.5, 0.5]]))[:, 2]
        assert bent[1] < straight[1]
    # The thumb's tip nears the little finger's knuckle.
    straight, bent = finger_points(adroit, 0, np.array([[0.0, 0.2, 0, 0], [0, 0.2, 0.5, 0.5]]))[:, 2]
    goal = adroit.joint_m[4, 0]
    assert np.linalg.norm(bent - goal) < np.linalg.norm(straight - goal)


def test_palm_balls_stay_inside_the_palm_boxes(chain, adroit):
    poses = chain_poses(chain, {name: np.array([value]) for name, value in FROZEN_RAD.items()})
    balls = adroit.palm_spheres_m
    room = np.full(len(balls), -np.inf)
    for body in chain:
        if body["name"] in PALM_BODIES:
            rotation, position = poses[body["name"]]
            for geom in body["collision_geoms"]:
                local = (balls[:, :3] - position[0]) @ rotation[0] - geom[
                    "pos"
                ]  # the palm's boxes are not turned in it
                room = np.maximum(room, (np.array(geom["size"]) - np.abs(local)).min(axis=1) - balls[:, 3])
    assert room.min() > -1e-15  # roundings: each ball touches two faces from inside


def test_toml_holds_the_model_to_the_bit(json_path, adroit):
    text = adroit_hand_toml(json_path)
    table = tomllib.loads(text)
    assert [finger["name"] for finger in table["finger"]] == list(FINGERS)
    np.testing.assert_array_equal(table["palm"]["spheres_m"], adroit.palm_spheres_m)
    for key, expected in {
        "joint_m": adroit.joint_m,
        "flexion_axis": adroit.flexion_axis,
        "abduction_axis": adroit.abduction_axis,
        "phalanx_m": adroit.phalanx_m,
        "radius_m": adroit.phalanx_radius_m,
        "flexion_limit_rad": adroit.flexion_limit_rad,
        "abduction_limit_rad": adroit.abduction_limit_rad,
    }.items():
        np.testing.assert_array_equal([finger[key] for finger in table["finger"]], expected)


def test_hand_file_reader_makes_the_same_model(tmp_path, json_path, adroit):
    path = tmp_path / "adroit.toml"
    path.write_text(adroit_hand_toml(json_path))
    read = read_hand(path)
    for name in HAND_SHAPES:
        # 1e-15: directions are scaled to unit length once more
        np.testing.assert_allclose(getattr(read, name), getattr(adroit, name), rtol=0, atol=1e-15)


def test_other_pitch_gives_other_balls_and_a_wrong_one_is_refused(json_path):
    fine = tomllib.loads(adroit_hand_toml(json_path, pitch_m=0.003))["palm"]["spheres_m"]
    coarse = tomllib.loads(adroit_hand_toml(json_path, pitch_m=0.012))["palm"]["spheres_m"]
    assert len(fine) > 2 * len(coarse)
    with pytest.raises(PalmarError, match="E-CONF pitch_m: 0"):
        adroit_hand_toml(json_path, pitch_m=0)


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"bodies": [{"name": "palm"}]}', '{"bodies": []}'])
def test_other_json_is_refused(tmp_path, content):
    path = tmp_path / "hand.json"
    path.write_text(content)
    with pytest.raises(BadTrace, match="E-TRACE-FORMAT"):
        load_chain(path)


def test_body_before_its_parent_is_refused(tmp_path, json_path):
    bodies = json.loads(json_path.read_text())["bodies"]
    path = tmp_path / "hand.json"
    path.write_text(json.dumps({"bodies": bodies[::-1]}))
    with pytest.raises(BadTrace, match="comes before its parent"):
        load_chain(path)
