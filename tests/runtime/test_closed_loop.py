"""The solver in a loop with a hand that has mass: it swings no more than an ideal spring of the same stiffness does."""

import numpy as np
import pytest

from .closed_loop import Loop, make_pack, measure_wall, solver_force, still_swings, swing, wall_force


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    pack = make_pack(tmp_path_factory.mktemp("loop"))
    return pack, *measure_wall(pack)


@pytest.mark.parametrize(
    "loop",
    [
        Loop(200.0, 10.0, 0.001),
        Loop(800.0, 10.0, 0.005),
        Loop(800.0, 10.0, 0.001, 200.0),
        Loop(200.0, 10.0, 0.001, quantum_n=0.2),
    ],
)
def test_where_an_ideal_spring_comes_to_rest_the_solver_does(wall, loop):
    pack, touch_m, stiffness = wall
    ideal = swing(loop, wall_force(touch_m, stiffness), touch_m, 1.5)
    ours = swing(loop, solver_force(pack), touch_m, 1.5)
    # A quantum of the force leaves a cycle of its own, of what a quantum moves the arm's spring by.
    rest_m = 1e-5 + 2 * loop.quantum_n / (loop.spring_n_per_m + stiffness)
    assert still_swings(ideal) < rest_m and still_swings(ours) < rest_m
    assert np.abs(ours).max() < 0.1


def test_where_an_ideal_spring_swings_for_ever_the_test_can_tell(wall):
    _, touch_m, stiffness = wall
    assert still_swings(swing(Loop(50.0, 1.0, 0.02), wall_force(touch_m, stiffness), touch_m, 1.5)) > 1e-3
