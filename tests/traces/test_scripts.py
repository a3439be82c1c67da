"""The built-in scripts: which fingers meet the object and when, that the others never do, and phases in their order."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.traces.kinematics import phalanges_in_palm
from palmar.traces.scene_file import check_scene
from palmar.traces.scripted import load_scene, script_trace

FINGERS = {
    "touch": [1],
    "tap": [1],
    "pinch": [0, 1],
    "five_finger_grasp": [0, 1, 2, 3, 4],
    "slide": [1],
    "squeeze_hold_slide": [0, 1, 2, 3, 4],
}


def gaps(hand, trace, leaves, rows):
    """Least gap of each finger to the leaves, as capsules of their thinnest radius, (rows, 5) metres."""
    phalanges = phalanges_in_palm(hand, trace.flexion_rad[rows], trace.abduction_rad[rows])
    turn = Rotation.from_quat(trace.palm_rotation_wxyz[rows], scalar_first=True).as_matrix()
    placed = np.einsum("nij,nfkej->nfkei", turn, phalanges) + trace.palm_position_m[rows, None, None, None]
    along = np.linspace(0.0, 1.0, 9)[:, None, None]
    found = np.full((len(rows), 5), np.inf)
    for f in range(5):
        for k in range(3):
            points = placed[:, f, k, 0] + along * (placed[:, f, k, 1] - placed[:, f, k, 0])  # (9, rows, 3)
            off = np.linalg.norm(points[:, :, None] - leaves[:, :3], axis=-1) - leaves[:, 3]
            found[:, f] = np.minimum(found[:, f], off.min(axis=(0, 2)) - hand.phalanx_radius_m[f, k].min())
    return found


@pytest.fixture(scope="module", params=list(FINGERS))
def made(request, hand, trees):
    trace = script_trace(load_scene(request.param)[0], hand, trees["ball"], seed=1)
    rows = np.arange(0, len(trace.time_s), 10)
    return request.param, trace, rows, gaps(hand, trace, trees["ball"].leaves, rows)


def test_every_finger_that_closes_gets_hold_and_the_others_stay_clear(made):
    name, trace, _, gap = made
    closing = FINGERS[name]
    said = json.loads(trace.header["assumptions"])[1]
    assert f"{len(closing)} of {len(closing)} fingers reach" in said
    # A mean radius places the fingers; the thinnest end may be a millimetre less deep.
    assert (gap[:, closing].min(axis=0) < -0.0015).all()
    others = [finger for finger in range(5) if finger not in closing]
    assert not others or gap[:, others].min() > 0


def test_nothing_is_met_before_the_hand_closes_and_after_it_opened(made):
    name, trace, rows, gap = made
    if name == "squeeze_hold_slide":
        return  # its palm is pressed in, fingers may lie on the ball before they close
    first = next(phase for phase in trace.phases if phase["name"] == "close")
    last = [phase for phase in trace.phases if phase["name"] == "open"][-1]
    away = (trace.time_s[rows] < first["start_s"]) | (trace.time_s[rows] > last["end_s"])
    assert gap[away].min() > 0


def test_phases_follow_each_other_and_a_hold_is_still_to_the_bit(made):
    name, trace, _, _ = made
    keys = load_scene(name)[0]
    assert [phase["name"] for phase in trace.phases] == keys["phases"]
    ends = [phase["end_s"] for phase in trace.phases]
    assert [phase["start_s"] for phase in trace.phases] == [0.0, *ends[:-1]]
    for phase in trace.phases:
        if phase["name"] == "hold":
            during = (trace.time_s >= phase["start_s"]) & (trace.time_s < phase["end_s"])
            assert np.ptp(trace.flexion_rad[during], axis=0).max() == 0
            assert np.ptp(trace.palm_position_m[during], axis=0).max() == 0
    # No step that a hand cannot make: five metres a second, and a fist in a tenth of a second.
    assert np.abs(np.diff(trace.palm_position_m, axis=0)).max() < 0.005
    assert np.abs(np.diff(trace.flexion_rad, axis=0)).max() < 0.05


def test_five_taps_are_five_touches(hand, trees):
    trace = script_trace(load_scene("tap")[0], hand, trees["ball"], seed=0)
    rows = np.arange(len(trace.time_s))
    inside = gaps(hand, trace, trees["ball"].leaves, rows)[:, 1] < 0
    assert (np.diff(inside.astype(int)) == 1).sum() == 5


@pytest.mark.parametrize(
    "phases",
    [
        ["close", "leave"],
        ["approach", "hold", "leave"],
        ["approach", "close", "close", "leave"],
        ["approach", "close", "open", "slide", "leave"],
        ["approach", "close", "open"],
    ],
)
def test_phases_that_make_no_motion_are_refused(phases):
    with pytest.raises(PalmarError, match="E-CONF"):
        check_scene(load_scene("touch")[0] | {"phases": phases}, "my.toml")
