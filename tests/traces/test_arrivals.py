"""Rate, jitter and drift from times of arrival alone."""

import math
import random

import numpy as np
import pytest

from palmar.traces.arrivals import Arrivals, find_clock


def arrivals_of(count: int, period_s: float, seed: int, *, faulty: bool) -> np.ndarray:
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
    return np.array(sorted(times))


@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize("ppm", [-200.0, 0.0, 80.0])
def test_period_is_found_to_a_few_standard_errors_whatever_is_lost(ppm, faulty):
    clock = find_clock(arrivals_of(20_000, 0.005 * (1 + ppm * 1e-6), 1, faulty=faulty))
    assert clock is not None
    # With 10 stretches that stand anywhere the error itself is known to a third.
    assert abs(clock.period_s - 0.005 * (1 + ppm * 1e-6)) < (5 if faulty else 4) * clock.error_s
    assert clock.error_s < 0.005 * (2e-6 if faulty else 0.2e-6)


def test_jitter_is_the_spread_of_the_lateness():
    # Of the absolute value of a normal: sigma sqrt(1 - 2 / pi); 20,000 draws know it to a percent.
    expected = 0.6e-3 * math.sqrt(1 - 2 / math.pi)
    times = arrivals_of(20_000, 0.005, 2, faulty=False)
    assert find_clock(times).jitter_s == pytest.approx(expected, rel=0.03)
    recent = Arrivals()
    for time_s in times[:1000]:
        recent.add(time_s)
    # 199 intervals, their median deviation taken for a normal's: to a fifth.
    assert recent.recent_jitter_s == pytest.approx(expected, rel=0.2)


def test_a_gap_among_the_first_lines_is_no_jitter():
    clock = find_clock(0.005 * np.arange(1000) + np.where(np.arange(1000) > 90, 0.7, 0.0))
    assert clock.period_s == pytest.approx(0.005, rel=1e-9) and clock.jitter_s < 1e-6


def test_lines_that_are_some_periods_late_do_not_hide_the_others():
    # A busy machine: half of the lines come late by 4 ms on average, some by 30; each batch with the line that held it.
    generator = np.random.default_rng(4)
    late = np.abs(generator.normal(0, 0.3e-3, 60_000)) + np.where(generator.random(60_000) < 0.5, 1, 0) * (
        generator.exponential(4e-3, 60_000)
    )
    clock = find_clock(np.maximum.accumulate(0.005 * (1 + 80e-6) * np.arange(60_000) + late))
    assert abs(clock.period_s / 0.005 - 1 - 80e-6) < min(5 * clock.error_s / 0.005, 3e-6)


def test_lines_that_come_in_lots_are_counted_as_lines():
    # A machine that looks every 4 to 20 ms, and takes what has come by then at once.
    generator = np.random.default_rng(5)
    due = 0.005 * (1 - 200e-6) * np.arange(60_000)
    looks = np.cumsum(generator.uniform(0.004, 0.02, 40_000))
    clock = find_clock(looks[np.searchsorted(looks, due)])
    assert clock is None or abs(clock.period_s / 0.005 - 1 + 200e-6) < 20e-6


def test_what_is_no_clock_has_none():
    generator = np.random.default_rng(6)
    assert Arrivals().clock() is None
    assert find_clock(np.zeros(300)) is None  # all at once
    assert find_clock(0.005 * np.arange(150)) is None  # few
    assert find_clock(np.sort(generator.uniform(0, 100, 20_000))) is None
    for _ in range(10):  # intervals that add up have a rate, but no phase to hold on to
        assert find_clock(np.cumsum(generator.uniform(0.004, 0.006, 20_000))) is None
