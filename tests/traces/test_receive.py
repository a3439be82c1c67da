"""What a device delivers against what a trace may hold: every rule that samples break, one by one."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.errors import BadTrace
from palmar.traces.receive import receive, take_rows

from .made_streams import assert_same, stream


def test_a_sound_stream_is_left_as_it_is_and_nothing_is_counted():
    said = stream()
    got, counts, sentences = receive(said.time_s, said)
    assert_same(got, said)
    assert counts == {} and sentences == []


def test_a_late_sample_is_dropped_and_never_goes_back_in_time():
    said = stream()
    arrived = take_rows(said, np.array([0, 1, 3, 2, 4, 4, 6, 7, 5, *range(8, 50)]))
    got, counts, _ = receive(0.01 * np.arange(len(arrived.time_s)), arrived)
    assert counts == {"late or double": 3}
    assert_same(got, take_rows(said, np.array([0, 1, 3, 4, 6, 7, *range(8, 50)])))


@pytest.mark.parametrize("leap_s", [-1.0, 3600.0, -4294.967296])
def test_a_clock_that_leaps_is_joined_once(leap_s):
    said = stream()
    arrival_s, leapt = said.time_s, said.time_s + leap_s * (np.arange(50) >= 20)
    got, counts, _ = receive(arrival_s, replace(said, time_s=leapt))
    assert counts == {"clock set anew": 1}
    # An hour has 4e3 s, of which a double keeps 5e-13 s.
    np.testing.assert_allclose(got.time_s, said.time_s, rtol=0, atol=1e-11)
    assert len(got.time_s) == 50


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("name", ["palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad"])
def test_what_is_no_pose_is_not_tracked_and_has_the_numbers_of_the_last_good_one(name, value):
    said = stream()
    broken = getattr(said, name).copy()
    broken[[0, 7, 8]] = value
    got, counts, _ = receive(said.time_s, replace(said, **{name: broken}))
    assert counts == {"not a pose": 3}
    assert np.flatnonzero(~got.tracked).tolist() == [0, 7, 8]
    for field in ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad"):
        rows = [1, *range(1, 7), 6, 6, *range(9, 50)]
        np.testing.assert_array_equal(getattr(got, field), getattr(said, field)[rows])


def test_zeros_after_a_pose_are_a_failed_read_and_a_hand_that_begins_at_zero_is_none():
    said = stream()
    zeros = {"palm_position_m": (3,), "flexion_rad": (5, 3), "abduction_rad": (5,)}
    failed = replace(said, **{name: getattr(said, name).copy() for name in zeros})
    for name in zeros:
        getattr(failed, name)[[20, 21]] = 0.0
    got, counts, _ = receive(said.time_s, failed)
    assert counts == {"not a pose": 2} and np.flatnonzero(~got.tracked).tolist() == [20, 21]
    for name in zeros:
        getattr(failed, name)[:22] = 0.0
    assert receive(said.time_s, failed)[0].tracked.all()


@pytest.mark.parametrize("times", [2, 3, 5])
def test_a_stream_that_was_padded_is_what_it_was(times):
    said = stream()
    padded = take_rows(said, np.repeat(np.arange(50), times))
    time_s = 0.01 / times * np.arange(50 * times)
    got, counts, _ = receive(time_s, replace(padded, time_s=time_s))
    assert counts == {"repeated by a padded stream": 50 * (times - 1)}
    np.testing.assert_array_equal(got.flexion_rad, said.flexion_rad)
    np.testing.assert_allclose(got.time_s, said.time_s, rtol=0, atol=1e-12)


def test_a_hand_at_rest_between_readings_that_come_once_is_not_thinned():
    said = stream()
    rests = take_rows(said, np.array([*range(20), *[20] * 10, *range(21, 41)]), said.time_s)
    got, counts, _ = receive(said.time_s, rests)
    assert counts == {} and len(got.time_s) == 50


def test_gaps_are_counted_and_a_stuck_joint_is_named():
    said = stream(500)
    kept = np.array([*range(100), *range(130, 500)])
    stuck = said.flexion_rad.copy()
    stuck[150:400, 1, 1] = stuck[150, 1, 1]
    stuck[:, 4] = 0.3  # never moves: not stuck, but not used
    _, counts, sentences = receive(said.time_s[kept], take_rows(replace(said, flexion_rad=stuck), kept))
    assert counts == {"gaps": 1, "longest gap, ms": 310.0}
    assert sentences == ["Stuck while other joints move: index PIP for 2.49 s."]


def test_a_stream_without_a_pose_is_refused():
    said = stream()
    with pytest.raises(BadTrace, match="E-TRACE-EMPTY"):
        receive(said.time_s, replace(said, tracked=np.zeros(50, bool)))
