"""A device that reads angles: its range of each joint, and a user's angles from it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from palmar.errors import BadTrace, PalmarError
from palmar.records import Trace
from palmar.tools.hand_file import default_hand
from palmar.traces.readings import apply_readings, calibrate_readings

HAND = default_hand()
OPEN, FIST = np.array([0.2, 0.1, 0.05]), np.array([0.9, 1.1, 0.05])  # the DIP is not read


def readings(closed, fist=FIST, tracked=None):
    """A trace whose readings go from open to fist as `closed` from 0 to 1."""
    count = len(closed)
    flexion = np.tile((OPEN + np.asarray(closed)[:, None] * (fist - OPEN))[:, None], (1, 5, 1))
    header = {"device": "glove", "hand": "any", "side": "right", "source": "log.csv", "assumptions": "[]"}
    still = np.tile([1.0, 0, 0, 0], (count, 1))
    return Trace(
        header=header,
        time_s=np.arange(count) * 0.01,
        palm_position_m=np.zeros((count, 3)),
        palm_rotation_wxyz=still,
        flexion_rad=flexion,
        abduction_rad=np.zeros((count, 5)),
        tracked=np.ones(count, dtype=bool) if tracked is None else tracked,
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=still,
    )


def recorded():
    """Open for a second, a fist for a second, one spike."""
    closed = np.concatenate([np.zeros(100), np.linspace(0, 1, 50), np.ones(100)])
    trace = readings(closed)
    trace.flexion_rad[30] = 9.0
    return trace


def test_open_hand_and_fist_are_the_range_whatever_one_sample_says():
    profile, told = calibrate_readings(recorded(), "me")
    for measures in profile.fingers:
        np.testing.assert_allclose(measures.reading_rad[:2], np.stack([OPEN, FIST], axis=1)[:2], rtol=0, atol=1e-12)
    assert told["joints not read"] == [f"{finger} DIP" for finger in ("thumb", "index", "middle", "ring", "little")]
    assert (profile.device, profile.side) == ("glove", "right")


def test_readings_become_angles_and_the_joint_not_read_follows():
    profile = replace(calibrate_readings(recorded(), "me")[0], sha256="abc")
    trace = apply_readings(readings([0.0, 0.5, 1.0, 1.2, -0.1]), HAND, profile)
    high, low = HAND.flexion_limit_rad[..., 1], HAND.flexion_limit_rad[..., 0]
    np.testing.assert_allclose(
        trace.flexion_rad[:3, :, :2], np.array([0, 0.5, 1])[:, None, None] * high[:, :2], atol=1e-12
    )
    dip = np.clip(trace.flexion_rad[:, :, 1] * HAND.flexion_coupling[:, 1], low[:, 2], high[:, 2])
    np.testing.assert_allclose(trace.flexion_rad[:, :, 2], dip, atol=1e-12)
    np.testing.assert_allclose(trace.flexion_rad[3, :, :2], high[:, :2], atol=1e-12)  # no farther than the joint goes
    assert (trace.flexion_rad[4] <= 1e-12).all()
    assert trace.header["profile_sha256"] == "abc" and "open hand" in json.loads(trace.header["assumptions"])[-1]


def test_a_recording_that_shows_no_fist_or_no_hand_is_refused():
    with pytest.raises(BadTrace, match="no joint of the thumb moves"):
        calibrate_readings(readings(np.zeros(50)), "me")
    with pytest.raises(BadTrace, match="3 tracked samples"):
        calibrate_readings(readings(np.linspace(0, 1, 20), tracked=np.arange(20) < 3), "me")


@pytest.mark.parametrize("change", [{"device": "other"}, {"side": "left"}])
def test_a_profile_of_another_device_or_side_is_refused(change):
    profile = replace(calibrate_readings(recorded(), "me")[0], **change)
    with pytest.raises(PalmarError, match="--profile"):
        apply_readings(recorded(), HAND, profile)
