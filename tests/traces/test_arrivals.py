"""Rate, jitter and drift from times of arrival alone."""

import math
import random

import pytest

from palmar.traces.arrivals import Arrivals


def arrivals_of(count: int, period_s: float, seed: int, *, faulty: bool) -> Arrivals:
    """Lines of a clock, each late by the absolute value of a normal of 0.6 ms; with faults as a port has them."""
    generator, offset, times = random.Random(seed), 0.0, []
    for number in range(count):
        if faulty and generator.random() < 0.0005:
            offset += generator.uniform(0.1, 2.0)  # a silence, after which the clock stands anywhere
        if faulty and generator.random() < 0.02:
            continue
        time_s = number * period_s + offset + abs(generator.gauss(0.0, 0.6e-3))
        times += [time_s] * (2 if faulty and generator.random() < 0.01 else 1)
        if faulty and generator.random() < 0.003:
            times += [time_s + 0.04] * 8  # held back, then all at once
    arrivals = Arrivals()
    for time_s in sorted(times):
        arrivals.add(time_s)
    return arrivals


@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize("ppm", [-150.0, 0.0, 80.0])
def test_period_is_found_to_a_few_standard_errors_whatever_is_lost(ppm, faulty):
    arrivals = arrivals_of(20_000, 0.005 * (1 + ppm * 1e-6), 1, faulty=faulty)
    # Faults leave lines late that count like others, so their errors are wider than the plain formula says.
    tolerance = (10 if faulty else 4) * arrivals.period_error_s
    assert abs(arrivals.period_s - 0.005 * (1 + ppm * 1e-6)) < tolerance
    assert tolerance < 0.005 * 20e-6


def test_jitter_is_the_spread_of_the_lateness():
    # Of the absolute value of a normal: sigma sqrt(1 - 2 / pi); 20,000 draws know it to a percent.
    expected = 0.6e-3 * math.sqrt(1 - 2 / math.pi)
    assert arrivals_of(20_000, 0.005, 2, faulty=False).jitter_s == pytest.approx(expected, rel=0.03)


def test_a_gap_among_the_first_lines_is_no_jitter():
    arrivals = Arrivals()
    for number in range(1000):
        arrivals.add(0.005 * number + (0.7 if number > 90 else 0.0))
    assert arrivals.period_s == pytest.approx(0.005, rel=1e-9) and arrivals.jitter_s < 1e-6


def test_few_lines_have_no_period_and_none_at_once_neither():
    arrivals = Arrivals()
    for _ in range(200):
        arrivals.add(1.0)
    assert arrivals.count == 200 and math.isnan(arrivals.period_s) and math.isnan(arrivals.jitter_s)


def test_a_busy_machine_does_not_make_it_count_wrong():
    # Half of the lines of the first second come as late as a busy machine makes them; the rest is as above.
    generator, arrivals, period_s = random.Random(4), Arrivals(), 0.005 * (1 + 80e-6)
    times = []
    for number in range(20_000):
        busy = number < 400 and generator.random() < 0.5
        times.append(number * period_s + abs(generator.gauss(0.0, 2e-3 if busy else 0.6e-3)))
    for time_s in sorted(times):
        arrivals.add(time_s)
    assert abs(arrivals.period_s - period_s) < 10 * arrivals.period_error_s < 0.005 * 20e-6
