"""Traces of the paper's figures: fingers in turn, and the noise of a sensor."""

import numpy as np
import pytest

from palmar.errors import PalmarError
from palmar.model import FINGERS
from palmar.tools.hand_file import default_hand
from palmar.tools.shapes import SHAPES
from palmar.tools.spread import spread_levels
from palmar.traces.in_turn import STATES, in_turn, shaken
from palmar.traces.scripted import load_scene, script_trace


@pytest.fixture(scope="module")
def grasp():
    tree = spread_levels(*SHAPES["cube"](), [200], {"source": "", "sha256": ""})
    return script_trace(load_scene("five_finger_grasp")[0], default_hand(), tree, 0)


def test_fingers_close_and_open_in_the_order_of_the_states(grasp):
    trace = in_turn(grasp)
    opened = trace.flexion_rad[0]
    names = [phase["name"] for phase in trace.phases]
    assert names == ["none", *(name for name, _ in STATES)]
    for phase, (_, fingers) in zip(trace.phases[1:-1], STATES[:-1], strict=True):
        at = np.searchsorted(trace.time_s, phase["end_s"]) - 1  # at rest
        closed = [name for f, name in enumerate(FINGERS) if (trace.flexion_rad[at, f] != opened[f]).any()]
        assert closed == [name for name in FINGERS if name in fingers]
    assert (trace.flexion_rad[-1] == opened).all()
    # No joint leaps: the fastest minimum-jerk move has 1.875 times the mean speed.
    step = np.abs(np.diff(trace.flexion_rad, axis=0)).max()
    assert step < 1.9 * np.abs(grasp.flexion_rad.max(axis=0) - opened).max() / 400
    assert np.allclose(np.diff(trace.time_s), 1e-3)


def test_a_trace_without_the_phases_is_refused(grasp):
    with pytest.raises(PalmarError, match="E-CONF trace: has no phase named approach"):
        in_turn(type(grasp)(**{**grasp.__dict__, "header": {**grasp.header, "phases": "[]"}}))


def test_noise_has_the_size_that_was_asked_for_and_the_same_seed_the_same_bytes(grasp):
    noisy = shaken(grasp, position_m=1e-4, joint_rad=1e-3, seed=1)
    # 5 %: of 12,000 draws and more
    assert (noisy.palm_position_m - grasp.palm_position_m).std() == pytest.approx(1e-4, rel=0.05)
    assert (noisy.flexion_rad - grasp.flexion_rad).std() == pytest.approx(1e-3, rel=0.05)
    assert (shaken(grasp, 1e-4, 1e-3, 1).flexion_rad == noisy.flexion_rad).all()
