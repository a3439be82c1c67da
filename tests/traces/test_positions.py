"""Recordings of positions whose angles are known: read, calibrated, solved."""

import json
from dataclasses import replace

import numpy as np
import pytest

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS
from palmar.profile import Profile, bone_vectors, fit_to_profile
from palmar.records import read_trace
from palmar.tools.hand_file import default_hand
from palmar.traces.calibrate import calibrate_recording, spread_frames
from palmar.traces.device import import_file, read_device
from palmar.traces.kinematics import phalanges_in_palm, rotate
from palmar.traces.palm_frame import rigid_between
from palmar.traces.solve import bridge, solve_recording

from .made_logs import (
    FRAMES,
    joints_in_palm,
    leap_log,
    made_angles,
    made_hand,
    made_palm,
    optical_log,
    to_world,
    webxr_log,
)

LOGS = {"webxr": webxr_log, "leap": leap_log}


def lengths(hand):
    return np.stack([np.linalg.norm(bone_vectors(hand, f), axis=1) for f in range(5)])


def joints_in_world(hand, trace):
    angles = np.concatenate([trace.abduction_rad[..., None], trace.flexion_rad], axis=2)
    points = joints_in_palm(hand, angles)
    turn = trace.palm_rotation_wxyz.reshape(-1, 1, 1, 4)
    return rotate(turn, points) + trace.palm_position_m.reshape(-1, 1, 1, 3)


@pytest.mark.parametrize("name", LOGS)
def test_angles_and_palm_of_a_known_hand_come_back(name, tmp_path):
    hand, angles = made_hand(), made_angles()
    recording = read_device(LOGS[name](tmp_path / "log.csv", hand, angles))
    assert recording.device == name and recording.side == "right"
    trace = solve_recording(recording, hand, None)
    position, rotation = made_palm()
    # The log has nine decimals; the hold to the frame before weighs 1e-3 against levers of 0.02 m and more.
    np.testing.assert_allclose(trace.palm_position_m, position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(rotate(trace.palm_rotation_wxyz, np.eye(3)[0]), rotation.apply([1, 0, 0]), atol=1e-6)
    np.testing.assert_allclose(trace.flexion_rad, angles[:, :, 1:], rtol=0, atol=0.01)
    np.testing.assert_allclose(trace.abduction_rad, angles[:, :, 0], rtol=0, atol=0.01)
    np.testing.assert_array_equal(trace.time_s, recording.time_s)
    residual = json.loads(trace.header["residual_mm"])
    assert residual["fingertips"]["max"] <= 0.2  # mm: the hold, on fingers that turn by 0.1 rad a frame


@pytest.mark.parametrize("name", LOGS)
def test_lengths_of_a_noisy_recording_are_found(name, tmp_path):
    hand, angles = made_hand(), made_angles()
    log = LOGS[name](tmp_path / "log.csv", hand, angles, noise_m=0.0005)
    profile, told = calibrate_recording(read_device(log), default_hand(), "me")
    found = fit_to_profile(default_hand(), profile)
    # Median of 120 lengths between two points of 0.5 mm noise: 0.7 mm x 1.25 / sqrt(120) = 0.08 mm; the fit of axes and
    # knuckles shares in it. Five of these.
    np.testing.assert_allclose(lengths(found), lengths(hand), rtol=0, atol=0.0006)
    spread = np.array([m.length_spread_m for m in profile.fingers])
    assert (spread > 0.0004).all() and (spread < 0.0011).all()  # 0.7 mm, and what 120 samples say of it
    assert told["residual_mm"]["fingertips"]["p99"] <= 2.0  # mm: the noise in three directions, 99 of 100
    # The palm is off by how the recorded knuckles lie on the default hand's; the joints in the world are not.
    trace = solve_recording(read_device(log), found, profile)
    truth = to_world(joints_in_palm(hand, angles), made_palm())
    off = np.linalg.norm(joints_in_world(found, trace) - truth, axis=-1)
    assert np.percentile(off, 99) <= 0.0015
    assert trace.header["profile_sha256"] == profile.sha256


def test_a_left_hand_is_calibrated_from_a_right_one(tmp_path):
    log = leap_log(tmp_path / "log.csv", made_hand("left"), made_angles())
    recording = read_device(log)
    assert recording.side == "left"
    profile, told = calibrate_recording(recording, default_hand(), "me")
    assert profile.side == "left" and told["residual_mm"]["fingertips"]["p99"] <= 0.5
    with pytest.raises(PalmarError, match="right hand, but the recording is of a left"):
        solve_recording(recording, default_hand(), None)


def test_markers_of_a_glove_are_placed_bridged_and_counted(tmp_path):
    hand, angles = made_hand(), made_angles()
    missing = [(0, 1, 30, 40), (2, 1, 60, 100), (3, 0, 0, 5)]
    recording = read_device(optical_log(tmp_path / "log.csv", hand, angles, missing))
    profile, told = calibrate_recording(recording, default_hand(), "me")
    assert told["points not seen"] == 55 and told["of these bridged"] == 10
    assert told["residual_mm"]["fingertips"]["p99"] <= 2.0  # mm; the shape is held to another hand's
    trace = solve_recording(recording, fit_to_profile(default_hand(), profile), profile)
    assert json.loads(trace.header["changed"]) == {"points not seen": 55, "of these bridged": 10}
    assert trace.tracked.all()
    # Which joint bends is a matter of the coupling, how much a finger bends in all is not, but for frames in which one
    # of its markers was away. 0.2 rad: markers are 6 mm from where they are thought, on phalanges of 20 to 40 mm.
    bend = trace.flexion_rad[:, 1:].sum(axis=2) - angles[:, 1:, 1:].sum(axis=2)
    seen = np.ones(bend.shape, dtype=bool)
    seen[60:100, 1] = seen[:5, 2] = False
    assert np.abs(bend[seen]).max() <= 0.2


def test_without_the_back_a_frame_is_not_tracked_and_its_markers_are_bridged(tmp_path):
    log = optical_log(tmp_path / "log.csv", made_hand(), made_angles())
    lines = log.read_text().splitlines()
    for i in range(51, 57):
        lines[i] = ",".join(["" if 1 <= k <= 3 else field for k, field in enumerate(lines[i].split(","))])
    log.write_text("\n".join(lines) + "\n")
    recording = read_device(log)
    assert np.flatnonzero(~recording.palm_seen).tolist() == list(range(50, 56))
    profile, told = calibrate_recording(recording, default_hand(), "me")
    assert told["frames without the palm"] == 6 and told["points not seen"] == told["of these bridged"] == 60
    trace = solve_recording(recording, fit_to_profile(default_hand(), profile), profile)
    np.testing.assert_array_equal(trace.tracked, recording.palm_seen)
    # Between its neighbours: 7 frames of a palm that accelerates by 2 m/s^2, and no finger jumps.
    assert np.linalg.norm(trace.palm_position_m - made_palm()[0], axis=1)[50:56].max() <= 0.05
    assert np.abs(np.diff(trace.flexion_rad, axis=0)).max() <= 0.3


def test_a_glove_without_its_profile_is_refused(tmp_path):
    log = optical_log(tmp_path / "log.csv", made_hand(), made_angles(20))
    with pytest.raises(PalmarError, match="palmar calibrate"):
        import_file(log, tmp_path / "out.mcap", hand=default_hand())
    ruler = Profile("me", "right", "ruler", hand_length_m=0.18)
    with pytest.raises(PalmarError, match="palmar calibrate"):
        import_file(log, tmp_path / "out.mcap", hand=default_hand(), profile=ruler)
    assert not (tmp_path / "out.mcap").exists()


def test_positions_need_a_hand_and_say_how_far_they_are_from_it(tmp_path):
    log = leap_log(tmp_path / "log.csv", made_hand(), made_angles(40))
    with pytest.raises(PalmarError, match="whose fingers"):
        import_file(log, tmp_path / "out.mcap")
    answer = import_file(log, tmp_path / "out.mcap", hand=default_hand())
    assert answer["residual_mm"]["fingertips"]["max"] > 1.0  # another person's
    assert any("not of the person" in sentence for sentence in answer["assumptions"])
    assert read_trace(tmp_path / "out.mcap").header["hand"] == "median adult"


def test_frames_the_sensor_does_not_trust_count_less(tmp_path):
    hand, angles = made_hand(), made_angles()
    confidence = np.ones(len(angles))
    confidence[50:60] = 0.02
    log = leap_log(tmp_path / "log.csv", hand, angles, confidence)
    recording = read_device(log)
    spoilt = recording.points_m.copy()
    spoilt[50:60, :, 2] += 0.03
    recording = replace(recording, points_m=spoilt)
    profile, told = calibrate_recording(recording, default_hand(), "me")
    assert told["trusted"] == 110
    # 0.3 mm: a shape that is held to the default hand's, as without the spoilt frames.
    np.testing.assert_allclose(lengths(fit_to_profile(default_hand(), profile)), lengths(hand), rtol=0, atol=0.0003)


@pytest.mark.parametrize(
    ("column", "value", "found"),
    [
        ("confidence", "1.5", "column confidence"),
        ("is_right", "0", "one hand is needed"),
        ("hand_id", "8", "one hand is needed"),
        ("index_tip_x_m", "", "a finite number"),
        ("palm_dz", "nan", "a finite number"),
    ],
)
def test_a_leap_log_with_a_fault_names_the_line(column, value, found, tmp_path):
    log = leap_log(tmp_path / "log.csv", made_hand(), made_angles(20))
    lines = log.read_text().splitlines()
    fields = lines[10].split(",")
    fields[lines[0].split(",").index(column)] = value
    log.write_text("\n".join([*lines[:10], ",".join(fields), *lines[11:]]) + "\n")
    with pytest.raises(BadTrace, match=found) as caught:
        read_device(log)
    assert ":line 11" in caught.value.where


def test_few_frames_are_no_calibration(tmp_path):
    log = leap_log(tmp_path / "log.csv", made_hand(), made_angles(5))
    with pytest.raises(BadTrace, match="5 frames show the hand; 10 are needed"):
        calibrate_recording(read_device(log), default_hand(), "me")


def test_a_finger_that_is_never_seen_is_no_calibration(tmp_path):
    log = optical_log(tmp_path / "log.csv", made_hand(), made_angles(), [(3, 0, 0, FRAMES)])
    with pytest.raises(BadTrace, match="the ring's middle marker is seen in fewer than 10 frames"):
        calibrate_recording(read_device(log), default_hand(), "me")


def test_only_short_gaps_are_bridged():
    time_s = np.arange(100) * 0.01
    path = np.stack([np.sin(time_s), time_s, 1 - time_s], axis=1)
    points = path[:, None, None].copy()
    points[10:20] = np.nan  # 0.11 s from neighbour to neighbour
    points[40:70] = np.nan  # 0.31 s
    points[95:] = np.nan  # no neighbour after
    filled, weight = bridge(time_s, points)
    assert (weight[10:20] == 0.1).all() and (weight[40:70] == 0).all() and (weight[95:] == 0).all()
    np.testing.assert_array_equal(filled[20:40], points[20:40])
    # Pchip over a tenth of a second of a sine: 0.1^2 / 8 and its slope's own error.
    np.testing.assert_allclose(filled[10:20, 0, 0], path[10:20], rtol=0, atol=2e-3)


def test_frames_for_the_shape_are_different_and_in_order():
    points = np.zeros((100, 5, 3, 3))
    points[:, 0, 0, 0] = np.repeat(np.arange(10), 10)  # ten postures, ten frames each
    frames = spread_frames(points)
    assert (np.diff(frames) > 0).all()
    assert set(points[frames, 0, 0, 0]) == set(range(10))


def test_knuckles_are_laid_onto_knuckles():
    hand = default_hand()
    position, rotation = made_palm(3)
    moved = rotation[1].apply(hand.joint_m[:, 0]) + position[1]
    place, turn = rigid_between(moved, hand.joint_m[:, 0])
    np.testing.assert_allclose(rotate(turn, moved) + place, hand.joint_m[:, 0], rtol=0, atol=1e-12)


def test_named_points_are_those_of_the_model(hand):
    angles = made_angles(4)
    joints = joints_in_palm(hand, angles)
    ends = phalanges_in_palm(hand, angles[:, :, 1:], angles[:, :, 0])
    np.testing.assert_allclose(joints[:, :, 3], ends[:, :, 2, 1], rtol=0, atol=1e-15)
    assert FINGERS[0] == "thumb"
