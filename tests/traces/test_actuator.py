"""Forces as an actuator can give them."""

import math

import numpy as np
import pytest

from palmar.errors import PalmarError
from palmar.traces.actuator import Actuator, Feedback, actuator_of


def forces(newtons: list[float]) -> np.ndarray:
    return np.array(newtons)[:, None] * np.array([0.6, 0.0, 0.8])


OPENS = np.full((5, 3), -0.1)


def test_levels_are_shares_of_the_cap_and_more_is_clipped_not_wrapped():
    feedback = Feedback(Actuator(cap_n=20.0))
    assert feedback.levels(0.0, forces([0, 5, 20, 60, 1e6]), OPENS) == [0, 250, 1000, 1000, 1000]
    assert feedback.clipped == 1 and feedback.largest_n == pytest.approx(1e6)


def test_a_brake_gives_nothing_where_the_force_would_close_the_finger():
    closes = OPENS.copy()
    closes[2] *= -1
    assert Feedback(Actuator()).levels(0.0, forces([10] * 5), closes) == [500, 500, 0, 500, 500]
    assert Feedback(Actuator(brake_only=False)).levels(0.0, forces([10] * 5), closes) == [500] * 5


def test_force_follows_at_the_rate_and_is_let_go_at_once():
    feedback = Feedback(Actuator(rate_n_per_s=100.0))
    assert feedback.levels(0.0, forces([10] * 5), OPENS) == [0] * 5
    assert feedback.levels(0.01, forces([10] * 5), OPENS) == [50] * 5
    assert feedback.levels(0.05, forces([10] * 5), OPENS) == [250] * 5
    assert feedback.levels(0.06, forces([0] * 5), OPENS) == [200] * 5
    feedback.let_go()
    assert feedback.levels(0.07, forces([10] * 5), OPENS) == [0] * 5


def test_steps_of_the_quantum_are_rounded_down():
    feedback = Feedback(Actuator(quantum_n=0.2))
    # 0.6 is three steps, though 0.6 / 0.2 is a little less in binary.
    assert feedback.levels(0.0, forces([0.19, 0.2, 0.59, 0.6, 20]), OPENS) == [0, 10, 20, 30, 1000]


def test_what_is_not_finite_is_no_force():
    broken = forces([0, 0, 5, 5, 5])
    broken[:2, 0] = math.nan, math.inf
    torque = OPENS.copy()
    torque[4] = math.nan
    assert Feedback(Actuator()).levels(0.0, broken, torque) == [0, 0, 250, 250, 0]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"cap": 20}, r"E-CONF --actuator cap: unknown key \(nearest: cap_n\); known are cap_n, brake_only"),
        ({"cap_n": 0}, r"E-CONF --actuator cap_n: 0; 0.01 to 1000 is allowed"),
        ({"brake_only": 1}, "true or false is allowed"),
        ({"rate_n_per_s": "fast"}, "0 to 1e\\+06 is allowed"),
    ],
)
def test_wrong_keys_and_values_are_refused(values, said):
    with pytest.raises(PalmarError, match=said):
        actuator_of(values)
