"""What goes wrong in a solver is planted in a real run, and the metric meant for it sees it."""

import numpy as np
import pytest
from planted import FAULTS, judged, outside, press, sunk

from palmar import reference
from palmar.eval.case import Case
from palmar.eval.recompute import recompute


@pytest.fixture
def pressed(tmp_path):
    """(run, pack, path of the pack)"""
    return press(tmp_path)


def test_the_run_as_it_is_keeps_every_limit(pressed):
    run, pack, path = pressed
    assert run.contacts[400:900].all() and run.fingertip_force_n[700].any()  # it does touch
    assert outside(judged(run, pack, path)) == set()


def test_a_converged_run_is_its_own_reference(pressed):
    run, _, path = pressed
    answer = reference.same_start(run, path)
    known = np.isfinite(answer.palm_position_m).all(axis=1)
    assert known.sum() == reference.MOST_STEPS
    assert run.contacts[known].all()  # it is asked where something holds the hand
    # metres; the run's own steps end when a round moves the hand by less than 5 um
    assert answer.palm_position_m[known] == pytest.approx(run.palm_position_m[known], abs=1e-6)
    assert answer.flexion_rad[known] == pytest.approx(run.flexion_rad[known], abs=1e-5)  # rad


def test_a_hand_that_sinks_in_all_the_time_has_no_reference(pressed, hand):
    run, _, path = pressed
    answer = reference.same_start(sunk(run, hand, np.arange(1200)[run.contacts > 0]), path)
    assert np.isnan(answer.palm_position_m).all()


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_seen_by_the_metrics_meant_for_it_and_by_no_other(pressed, name):
    run, pack, path = pressed
    plant, seen = FAULTS[name]
    assert outside(judged(*plant(run, pack), path)) == seen


def test_the_list_of_contacts_is_what_the_judge_finds(pressed):
    run, pack, _ = pressed
    found = recompute(Case(run, pack, "thing"))
    # mm; both work in float64 on lengths of 0.1 m
    assert found.same and found.contacts >= found.steps > 500 and found.gap_mm < 1e-9


def test_a_gap_that_is_not_what_it_is_said_to_be_is_found(pressed):
    run, pack, _ = pressed
    plant, _ = FAULTS["0.2 mm of depth stated as gap 0"]
    found = recompute(Case(*plant(run, pack), "thing"))
    assert not found.same and found.gap_mm == pytest.approx(0.2, rel=0.2)  # pushed down, felt along the normal
