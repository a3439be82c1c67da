"""Cost beside a reference: two springs of known length, and what has no reference."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.eval.case import Case, NotMeasured, Reference
from palmar.eval.cost import cost_excess, cost_excess_own

FAR = [[0, 0, -1.0, 0.01]]


def above(make_run, millimetres):
    """A graphic palm so many mm above the haptic one, step by step."""
    height = 1e-3 * np.asarray(millimetres, dtype=float)
    run = make_run(len(height), palm_position_m=height[:, None] * [0, 0, 1])
    return replace(run, haptic_palm_position_m=np.zeros((len(height), 3)))


def test_a_hand_held_farther_off_pays_the_square(make_pack, make_run):
    run, best = above(make_run, [2, 2.2, 3, 1]), above(make_run, [2, 2, 2, 2])
    case = Case(run, make_pack(FAR), "thing", reference=Reference(same_start=best))
    assert cost_excess(case) == pytest.approx([0, 21, 125, -75], abs=1e-9)
    with pytest.raises(NotMeasured, match="no reference was given"):
        cost_excess_own(case)


def test_a_hand_left_behind_with_nothing_in_the_way_pays_by_the_cost_of_one_newton(make_pack, make_run):
    case = Case(above(make_run, [4]), make_pack(FAR), "thing", reference=Reference(own_way=above(make_run, [0])))
    assert cost_excess_own(case)[0] == pytest.approx(100 * 4.0**2, abs=1e-9)


def test_fingers_that_are_spread_apart_cost_as_well(make_pack, make_run):
    spread = np.zeros((1, 5))
    spread[0, 3] = 0.1
    run = replace(above(make_run, [2]), abduction_rad=spread)
    case = Case(run, make_pack(FAR), "thing", reference=Reference(same_start=above(make_run, [2])))
    assert cost_excess(case)[0] == pytest.approx(100 * 0.5 * 0.1**2 / (1000 * 0.002**2), abs=1e-9)


def test_steps_without_an_answer_are_left_out_and_a_run_of_another_length_is_refused(make_pack, make_run):
    run, best = above(make_run, [3, 3, 3]), above(make_run, [2, np.nan, 2])
    run = replace(run, status=np.array([0, 0, 16], dtype=np.uint32))
    case = Case(run, make_pack(FAR), "thing", reference=Reference(same_start=best))
    assert cost_excess(case) == pytest.approx([125, np.nan, np.nan], nan_ok=True, abs=1e-9)
    short = Reference(same_start=above(make_run, [2]))
    with pytest.raises(NotMeasured, match="1 steps, the run 3"):
        cost_excess(Case(run, make_pack(FAR), "thing", reference=short))
