"""Roughness of a slide against closed forms: a sine's rms, and the ripple of a ball that rolls over a row of balls."""

import json
from dataclasses import replace

import numpy as np
import pytest

from palmar.eval.case import Case, NotMeasured
from palmar.eval.slide import force_above_20hz, force_ripple, rms_above

FAR = [[0, 0, -1.0, 0.01]]
MIDDLE = 2
TOUCHED_M = 0.006 * np.sqrt(1 + (0.001 / 0.03) ** 2)  # radius of the fingertip's ball


def slide(n):
    return [{"name": "slide", "start_s": 0.0, "end_s": 1e-3 * n}]


def test_a_sine_has_its_rms_and_what_is_slower_has_none(make_pack, make_run):
    n = 1000
    t = 1e-3 * np.arange(n)
    force = np.zeros((n, 5, 3))
    force[:, MIDDLE, 0] = 2 + 3 * t + 0.5 * np.sin(2 * np.pi * 10 * t)
    force[:, MIDDLE, 2] = 0.3 * np.sin(2 * np.pi * 150 * t + 0.4)
    force[:, 0, 1] = 0.2 * np.cos(2 * np.pi * 60 * t)
    case = Case(make_run(n, slide(n), fingertip_force_n=force), make_pack(FAR), "thing")
    # 0.3 / sqrt(2). A thousandth is for the window's tail of the line and of the 10 Hz.
    assert force_above_20hz(case)[0] == pytest.approx(0.3 / np.sqrt(2), rel=1e-3)


def test_all_the_power_of_noise_is_in_the_spectrum():
    force = np.random.default_rng(2).normal(size=(4000, 5, 3))
    found = rms_above(force, 1000.0, cutoff_hz=-1.0)
    # Three axes of variance 1; 4000 samples under Hann's window scatter by about 2 per cent.
    assert found == pytest.approx(np.full(5, np.sqrt(3)), rel=0.05)
    above = rms_above(force, 1000.0)
    assert above == pytest.approx(found * np.sqrt(1 - 20 / 500), rel=0.02)  # white: power as the width of the band


def test_the_worst_of_several_slides_counts_and_a_short_one_does_not(make_pack, make_run):
    n = 1600
    t = 1e-3 * np.arange(n)
    force = np.zeros((n, 5, 3))
    force[:, 1, 2] = np.where(t < 0.7, 0.1, 0.4) * np.sin(2 * np.pi * 100 * t)
    force[1500:, 1, 2] *= 10
    starts = ((0.0, 0.7), (0.7, 1.5), (1.5, 1.6))
    phases = [{"name": "slide", "start_s": a, "end_s": b} for a, b in starts]
    case = Case(make_run(n, phases, fingertip_force_n=force), make_pack(FAR), "thing")
    # Bins of 1/0.7 Hz and the line through a sine: within a per cent.
    assert force_above_20hz(case) == pytest.approx(np.array([0.1, 0.4]) / np.sqrt(2), rel=1e-2)


@pytest.mark.parametrize(("radius_m", "pitch_m"), [(0.003, 0.003), (0.003, 0.005), (0.006, 0.0072)])
def test_ripple_over_a_row_of_balls_is_that_of_two_rolling_circles(make_pack, make_run, radius_m, pitch_m):
    run, expected = over_a_row(make_run, radius_m, pitch_m)
    # Steps of 4 um meet every top and every valley; rounding is left.
    assert force_ripple(Case(run, make_pack(FAR), "thing"))[0] == pytest.approx(expected, abs=1e-9)


def over_a_row(make_run, radius_m, pitch_m):
    """The middle fingertip from x = -8 to 8 mm, 2 mm deep in a row of balls under the top face of the box."""
    n = 4001
    rho = radius_m + TOUCHED_M
    x = np.linspace(-0.008, 0.008, n)
    rise = np.sqrt(rho**2 - (x - pitch_m * np.round(x / pitch_m)) ** 2)
    height = 0.02 + rise - rho + TOUCHED_M
    force = np.zeros((n, 5, 3))
    force[:, MIDDLE, 2] = 1000 * (height - (0.02 + TOUCHED_M - 0.002 - pitch_m**2 / 8 / rho))
    # The fingertip's ball is at y = 140 mm less 6 mm tan(phi): over the middle of the face.
    haptic = np.stack([x, np.full(n, -0.14), np.full(n, 0.02 + TOUCHED_M - 0.002)], axis=1)
    run = make_run(n, slide(n), haptic_palm_position_m=haptic, fingertip_force_n=force)
    return run, 1000 * (rho - np.sqrt(rho**2 - pitch_m**2 / 4))


def test_a_finger_whose_depth_is_changed_on_purpose_has_no_ripple(make_pack, make_run):
    run, _ = over_a_row(make_run, 0.003, 0.003)
    n = len(run.time_s)
    deeper = run.haptic_palm_position_m - np.linspace(0, 1e-4, n)[:, None] * [0, 0, 1]
    with pytest.raises(NotMeasured, match="at one depth"):
        force_ripple(Case(replace(run, haptic_palm_position_m=deeper), make_pack(FAR), "thing"))


def test_without_a_slide_there_is_a_reason(make_pack, make_run):
    run = make_run(300)
    for header in ({}, {"phases": json.dumps([{"name": "slide", "start_s": 5.0, "end_s": 6.0}])}):
        with pytest.raises(NotMeasured, match="no phase named slide"):
            force_ripple(Case(replace(run, header=header), make_pack(FAR), "thing"))
