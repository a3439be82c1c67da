"""Toggles of the contact set: counted where the input stands still, by which pairs touch and not by how many."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.eval.case import Case, NotMeasured
from palmar.eval.contact_set import changed, contact_toggles, contact_toggles_a_second

FAR = [[0, 0, -1.0, 0.01]]


def case_of(run, make_pack):
    return Case(run, make_pack(FAR), "thing")


def test_a_contact_dropped_once_in_fifty_steps_is_two_changes_each_time(make_pack, make_run):
    links = {step: [4, 7] if step % 50 else [7] for step in range(1000)}
    case = case_of(make_run(1000, contact_links=links), make_pack)
    # Steps 11 to 999 count; the drops at 50, 100, ... 950 go and come back.
    assert np.nansum(contact_toggles(case)) == 2 * 19
    assert contact_toggles_a_second(case)[0] == pytest.approx(2 * 19 / 0.989, rel=1e-12)


def test_another_sphere_is_another_set_and_another_order_is_not(make_pack, make_run):
    links = {step: [4, 4, 7] for step in range(6)}
    run = make_run(6, contact_links=links)
    sphere = np.tile([1, 2, 3], 6)
    sphere[6:9] = [2, 1, 3]  # step 2: the same pairs in another order
    sphere[12:15] = [1, 9, 3]  # step 4: one other sphere
    case = case_of(replace(run, contact_object_sphere=sphere.astype(np.uint32)), make_pack)
    assert changed(case).tolist() == [False, False, False, False, True, True]


def test_pairs_that_swap_links_are_another_set(make_pack, make_run):
    run = make_run(3, contact_links={0: [4, 7], 1: [7, 4], 2: [4, 7]})
    sphere = np.array([1, 2, 1, 2, 1, 2], dtype=np.uint32)  # link 4 on 1 and 7 on 2, then 7 on 1 and 4 on 2
    assert changed(case_of(replace(run, contact_object_sphere=sphere), make_pack)).tolist() == [False, True, True]


def test_a_contact_without_force_is_not_active_where_others_have_one(make_pack, make_run):
    links = {step: [4, 7] if step % 2 else [7] for step in range(40)}
    run = make_run(40, contact_links=links)
    pushes = np.where(run.contact_link == 7, 1.0, 0.0)
    assert not changed(case_of(replace(run, contact_force_n=pushes), make_pack)).any()
    assert changed(case_of(run, make_pack))[1:].all()  # a solver that states no force at all


def test_a_moving_hand_may_change_its_contacts(make_pack, make_run):
    run = make_run(40, contact_links={step: [step % 15 + 1] for step in range(40)})
    moving = replace(run, haptic_palm_position_m=1e-5 * np.arange(40)[:, None] * [0, 0, 1.0])
    with pytest.raises(NotMeasured, match="never constant"):
        contact_toggles(case_of(moving, make_pack))
