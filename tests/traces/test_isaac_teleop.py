"""Recordings of Isaac Teleop: the joints that come out, and files that are of another version, cut or damaged."""

import numpy as np
import pytest
from mcap.writer import CompressionType

from palmar.errors import BadTrace, PalmarError
from palmar.records import read_trace
from palmar.tools.hand_file import default_hand
from palmar.traces.device import import_file, read_device
from palmar.traces.isaac_teleop import CHAINS, JOINT, WRIST
from palmar.traces.webxr import read_webxr

from .made_logs import made_angles, webxr_log
from .made_teleop import STRUCTS, teleop_file

COUNT = 60
RECORDS = "hands/right_hand"


@pytest.fixture
def hand_log(tmp_path):
    """The same motion as WebXR gives it, for comparison, and as records of 26 joints."""
    log = webxr_log(tmp_path / "webxr.csv", default_hand(), made_angles(COUNT))
    columns = np.genfromtxt(log, delimiter=",", names=True, deletechars="")
    recording = read_webxr(log)
    joints = np.zeros((COUNT, 26), JOINT)
    joints["valid"], joints["radius_m"] = 1, 0.01
    joints["rotation_xyzw"][..., 3] = 1
    joints["position_m"][:, WRIST] = recording.palm_position_m
    joints["rotation_xyzw"][:, WRIST] = np.roll(recording.palm_rotation_wxyz, -1, axis=1)
    from palmar.traces.webxr import CHAINS as NAMES

    for names, numbers in zip(NAMES, CHAINS, strict=True):
        for name, number in zip(names, numbers, strict=True):
            joints["position_m"][:, number] = np.column_stack([columns[f"{name}_p{axis}"] for axis in "xyz"])
    stamps = 9_000_000_000_000 + np.round(1e9 * recording.time_s).astype(np.int64)
    return log, list(zip(stamps.tolist(), joints, strict=True))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_angles_are_those_of_the_same_motion_as_webxr_gives_it(hand_log, tmp_path, compression):
    log, records = hand_log
    (tmp_path / "teleop.mcap").write_bytes(teleop_file({RECORDS: records}, compression=compression))
    answer = import_file(tmp_path / "teleop.mcap", tmp_path / "a.mcap", hand=default_hand())
    import_file(log, tmp_path / "b.mcap", hand=default_hand())
    assert answer["format"] == "isaac-teleop" and answer["samples"] == COUNT
    got, expected = read_trace(tmp_path / "a.mcap"), read_trace(tmp_path / "b.mcap")
    # Joints are float32 there: 1e-7 m at half a metre, and angles from points 2 cm apart, amplified by the solve.
    np.testing.assert_allclose(got.flexion_rad, expected.flexion_rad, rtol=0, atol=1e-4)
    np.testing.assert_allclose(got.palm_position_m, expected.palm_position_m, rtol=0, atol=1e-5)
    np.testing.assert_allclose(got.time_s, expected.time_s, rtol=0, atol=2e-9)
    assert got.tracked.all() and any("right_hand" in sentence for sentence in answer["assumptions"])


def test_a_hand_that_is_away_or_not_valid_is_not_tracked(hand_log, tmp_path):
    records = list(hand_log[1])
    records[10] = (records[10][0], None)
    bad = records[20][1].copy()
    bad["valid"][7] = 0
    records[20] = (records[20][0], bad)
    (tmp_path / "teleop.mcap").write_bytes(teleop_file({RECORDS: records, "hands/left_hand": [(1, None)]}))
    recording = read_device(tmp_path / "teleop.mcap", side="right")
    assert np.flatnonzero(~recording.palm_seen).tolist() == [10, 20]
    assert np.isnan(recording.points_m[[10, 20]]).all() and np.isfinite(recording.palm_position_m).all()
    with pytest.raises(BadTrace, match="E-TRACE-EMPTY"):
        read_device(tmp_path / "teleop.mcap", side="left")


def test_another_version_of_the_layout_is_refused_by_the_field_that_moved(hand_log, tmp_path):
    moved = {**STRUCTS, "core.HandJointPose": {"pose": 0, "is_tracked": 28, "is_valid": 29, "radius": 32}}
    (tmp_path / "teleop.mcap").write_bytes(teleop_file({RECORDS: hand_log[1]}, moved))
    with pytest.raises(BadTrace, match=r"E-TRACE-SCHEMA.*core\.HandJointPose\.is_valid is at 29, 28 is read"):
        read_device(tmp_path / "teleop.mcap")


def test_files_without_such_a_hand_and_clocks_that_go_back_are_refused(hand_log, tmp_path):
    records = hand_log[1]
    path = tmp_path / "teleop.mcap"
    for hands, said in (
        ({"hands/left_hand": records}, "no topic of core.HandPoseRecord that ends in right_hand"),
        ({RECORDS: records, "other/right_hand": records}, "2 such topics"),
        ({RECORDS: [records[0], (records[0][0], records[1][1])]}, "does not increase"),
    ):
        path.write_bytes(teleop_file(hands))
        with pytest.raises(BadTrace, match=said):
            read_device(path)
    with pytest.raises(PalmarError, match="allowed are right, left"):
        read_device(path, side="both")


def test_cut_and_damaged_files_are_refused_or_whole(hand_log, tmp_path):
    path = tmp_path / "teleop.mcap"
    whole = teleop_file({RECORDS: hand_log[1][:4]}, compression=CompressionType.NONE)
    path.write_bytes(whole)
    sound = read_device(path)
    rng = np.random.default_rng(0)
    for trial in range(400):
        content = bytearray(whole)
        if trial % 2:
            content = content[: rng.integers(len(whole))]
        else:
            content[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        try:
            got = read_device(path)
        except BadTrace as error:
            assert "\n" not in str(error)
            continue
        np.testing.assert_array_equal(got.points_m, sound.points_m)
        np.testing.assert_array_equal(got.time_s, sound.time_s)
