"""Faults put into a trace: that each does what its name says, and that what comes out is always a trace."""

import json

import numpy as np
import pytest

from palmar.errors import PalmarError
from palmar.records import read_trace, write_trace
from palmar.traces.disturb import FAULTS, disturb, disturb_file
from palmar.traces.scene_file import KEYS_OF_DISTURBANCE, Disturbance

from .made_streams import assert_same, stream

ALL = [
    {"kind": "spike", "at_s": 0.1, "for_s": 0.02, "move_m": [0.05, 0.0, 0.0], "turn_rad": [0.1, 0.0, 0.0]},
    {"kind": "frozen", "at_s": 0.1, "for_s": 0.1},
    {"kind": "untracked", "at_s": 0.1, "for_s": 0.1},
    {"kind": "zeros", "share": 0.3},
    {"kind": "broken", "share": 0.3, "of": "thumb", "value": "huge"},
    {"kind": "broken", "share": 0.3, "of": "palm", "value": "-inf"},
    {"kind": "stuck", "of": "fingers", "at_s": 0.1, "for_s": 0.2},
    {"kind": "dropped", "share": 0.5},
    {"kind": "doubled", "share": 0.4, "times": 3},
    {"kind": "doubled", "times": 4, "own_times": True},
    {"kind": "swapped", "share": 0.3},
    {"kind": "late", "share": 0.2, "by_s": 0.035},
    {"kind": "clock", "at_s": 0.2, "by_s": -1.0},
    {"kind": "sampled", "rate_hz": 730.0, "jitter": 0.3},
]


def faulty(trace, *faults, seed=0):
    return disturb(trace, [Disturbance(**fault) for fault in faults], np.random.default_rng(seed))


def counts(trace):
    return json.loads(trace.header.get("changed", "{}"))


def test_every_kind_has_its_function_its_keys_and_a_case_here():
    assert set(FAULTS) == set(KEYS_OF_DISTURBANCE) == {fault["kind"] for fault in ALL}


def test_without_faults_a_trace_stays_the_object_it_was():
    said = stream()
    assert disturb(said, [], np.random.default_rng(0)) is said


@pytest.mark.parametrize("number", range(len(ALL)))
def test_what_comes_out_can_be_written_and_the_seed_says_all(number, tmp_path):
    said = stream(200)
    once, again, other = (faulty(said, ALL[number], seed=seed) for seed in (1, 1, 2))
    assert_same(once, again)
    write_trace(tmp_path / "t.mcap", once)  # refuses whatever is no trace
    assert_same(read_trace(tmp_path / "t.mcap"), once)
    if ALL[number].get("share"):
        kept = [(trace.time_s.tolist(), trace.tracked.tolist(), counts(trace)) for trace in (once, other)]
        assert kept[0] != kept[1]


def test_faults_upon_faults_still_make_a_trace(tmp_path):
    rng = np.random.default_rng(5)
    for trial in range(40):
        chosen = [ALL[k] for k in rng.permutation(len(ALL))[: rng.integers(2, 7)]]
        write_trace(tmp_path / "t.mcap", faulty(stream(150), *chosen, seed=trial))


def test_doubles_and_swaps_leave_no_trace_but_a_count():
    said = stream(200)
    for fault in ({"kind": "doubled", "times": 5}, {"kind": "doubled", "times": 3, "own_times": True}):
        got = faulty(said, fault)
        np.testing.assert_array_equal(got.flexion_rad, said.flexion_rad)
    swapped = faulty(said, {"kind": "swapped", "share": 0.2})
    assert len(swapped.time_s) == 200 - counts(swapped)["late or double"] < 200
    assert (np.diff(swapped.time_s) > 0).all()


def test_the_window_the_share_and_the_phase_are_those_that_were_asked_for():
    said = stream(1000, 0.001)
    got = faulty(said, {"kind": "dropped", "at_s": 0.2, "for_s": 0.5, "share": 0.3})
    lost = np.setdiff1d(said.time_s, got.time_s)
    assert lost.min() >= 0.2 and lost.max() < 0.7
    assert 100 < len(lost) < 200  # of 500 draws at 0.3: ten standard deviations to either side
    assert got.phases == [{"name": "disturbance", "start_s": 0.2, "end_s": 0.7}]


def test_a_motion_sampled_at_another_rate_lies_on_the_straight_between_its_samples():
    said = stream(200)
    got = faulty(said, {"kind": "sampled", "rate_hz": 333.0, "jitter": 0.3})
    interval = np.diff(got.time_s) * 333.0
    assert interval.min() > 0.39 and interval.max() < 1.61  # 30 percent early to 30 percent late
    expected = np.interp(got.time_s, said.time_s, said.palm_position_m[:, 2])
    np.testing.assert_allclose(got.palm_position_m[:, 2], expected, rtol=0, atol=1e-15)
    assert np.abs(np.linalg.norm(got.palm_rotation_wxyz, axis=1) - 1).max() < 1e-12


def test_a_file_of_faults_is_applied_to_any_trace_and_mistakes_are_named(tmp_path):
    write_trace(tmp_path / "t.mcap", stream())
    faults = tmp_path / "faults.toml"
    faults.write_text('[[disturbance]]\nkind = "broken"\nof = "index"\nat_s = 0.1\nfor_s = 0.05\n')
    answer = disturb_file(tmp_path / "t.mcap", faults, tmp_path / "d.mcap")
    assert answer["not tracked"] == 5 and answer["changed"] == {"not a pose": 5}
    assert (~read_trace(tmp_path / "d.mcap").tracked).sum() == 5
    for text, said in (
        ('[[disturbance]]\nkind = "brokn"\n', "disturbance.0.kind"),
        ('[[disturbance]]\nkind = "late"\nby_s = 0.1\nmove_m = [0, 0, 1]\n', "with kind late, not move_m"),
        ('[[disturbance]]\nkind = "late"\nbys = 0.1\n', "nearest: by_s"),
        ("", "disturbance: key is missing"),
        ("[[disturbance]\n", "not a TOML file"),
    ):
        faults.write_text(text)
        with pytest.raises(PalmarError) as caught:
            disturb_file(tmp_path / "t.mcap", faults, tmp_path / "no.mcap")
        assert caught.value.code == "E-CONF" and said in str(caught.value)
        assert not (tmp_path / "no.mcap").exists()
