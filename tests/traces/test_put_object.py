"""An object is put where a recorded hand closes on it."""

import json
from dataclasses import replace

import numpy as np

from palmar.traces.device import read_device
from palmar.traces.kinematics import phalanges_in_palm, rotate
from palmar.traces.put_object import SQUEEZE_M, put_object
from palmar.traces.solve import solve_recording

from .made_logs import leap_log, made_angles, made_hand


def test_fingers_are_out_of_the_object_while_open_and_in_it_when_closed(tmp_path, trees):
    hand = made_hand()
    trace = solve_recording(read_device(leap_log(tmp_path / "log.csv", hand, made_angles())), hand, None)
    leaves = trees["rod"].leaves
    put = put_object(trace, hand, leaves, "rod")
    assert put.header["object"] == "rod" and "was not there" in json.loads(put.header["assumptions"])[-1]
    # The hand's own motion is untouched: only the frame it is given in is another.
    np.testing.assert_array_equal(put.flexion_rad, trace.flexion_rad)
    step = np.linalg.norm(np.diff(put.palm_position_m, axis=0), axis=1)
    np.testing.assert_allclose(step, np.linalg.norm(np.diff(trace.palm_position_m, axis=0), axis=1), atol=1e-12)

    palms = phalanges_in_palm(hand, put.flexion_rad, put.abduction_rad)
    turn = put.palm_rotation_wxyz.reshape(-1, 1, 1, 1, 4)
    tips = (rotate(turn, palms) + put.palm_position_m.reshape(-1, 1, 1, 1, 3))[:, 1:, 2, 1]
    gap = (
        np.linalg.norm(tips[:, :, None] - leaves[:, :3], axis=-1) - leaves[:, 3] - hand.phalanx_radius_m[1:, 2, 1, None]
    )
    closed = int(put.flexion_rad[:, 1:].sum(axis=(1, 2)).argmax())
    assert gap[closed].min() < 0 and SQUEEZE_M > 0
    assert gap[0].min() > 0.01


def test_an_untracked_sample_does_not_place_it(tmp_path, trees):
    hand = made_hand()
    trace = solve_recording(read_device(leap_log(tmp_path / "log.csv", hand, made_angles(40))), hand, None)
    spoilt = trace.flexion_rad.copy()
    spoilt[5] = 3.0
    lost = replace(trace, flexion_rad=spoilt, tracked=np.arange(40) != 5)
    a, b = (put_object(t, hand, trees["rod"].leaves, "rod").palm_position_m for t in (trace, lost))
    np.testing.assert_array_equal(a, b)
