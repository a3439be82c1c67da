"""Metrics of slides: what a user feels as roughness. Formulas: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from palmar.eval.case import Case, NotMeasured
from palmar.eval.force import FLOOR_N
from palmar.eval.judge import fingertips, haptic_poses, in_object_frame

Array = NDArray[np.float64]
CUTOFF_HZ = 20.0
SHORTEST_S = 0.2  # four cycles at the cut-off: two bins of Hann's window between the mean and what is counted
CONSTANT_DEPTH_M = 5e-5  # 0.05 N at 1 N/mm, a third of the ripple that is just noticed


def force_above_20hz(case: Case) -> Array:
    """(k,) N: of each slide the rms of a fingertip's force above 20 Hz, of the finger with the most."""
    values = []
    for slide in _slides(case):
        step_s = np.median(np.diff(case.run.time_s[slide])) if slide.stop - slide.start > 1 else 0.0
        if step_s * (slide.stop - slide.start) >= SHORTEST_S:
            values.append(rms_above(case.run.fingertip_force_n[slide], 1 / step_s).max())
    if not values:
        raise NotMeasured(f"no slide of {SHORTEST_S} s")
    return np.array(values)


def rms_above(force: Array, rate_hz: float, cutoff_hz: float = CUTOFF_HZ) -> Array:
    """(5,) N: rms above the cut-off of forces (n, 5, 3), all axes together, from a one-sided spectrum.

    The straight line through the samples is taken off and Hann's window w laid over them; power density is
    2 |X|^2 / (rate sum w^2), so a bin holds 2 |X|^2 / (n sum w^2).
    """
    count = len(force)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count) / count)
    spectrum = np.fft.rfft(detrend(force, axis=0) * window[:, None, None], axis=0)
    power = 2 * np.abs(spectrum) ** 2 / (count * (window**2).sum())
    if count % 2 == 0:
        power[-1] /= 2  # the bin at half the rate has no twin
    return np.sqrt(power[np.fft.rfftfreq(count, 1 / rate_hz) > cutoff_hz].sum(axis=(0, 2)))


def force_ripple(case: Case) -> Array:
    """(k,) N: of each slide, highest less lowest force of a fingertip in contact whose commanded depth is constant.

    Depth is that of the haptic fingertip's centre in the true mesh. Of several fingers the one with the most counts.
    """
    run = case.run
    values: list[float] = []
    for slide in _slides(case):
        tips = in_object_frame(run, fingertips(case.pack.hand, haptic_poses(run)))[slide]
        depth = case.mesh.closest(tips.reshape(-1, 3))[0].reshape(-1, 5)
        force = np.linalg.norm(run.fingertip_force_n[slide], axis=2)
        counts = (np.ptp(depth, axis=0) <= CONSTANT_DEPTH_M) & (force.max(axis=0) > FLOOR_N)
        values += np.ptp(force[:, counts], axis=0).max(keepdims=True).tolist() if counts.any() else []
    if not values:
        raise NotMeasured("no slide in which a fingertip in contact is asked to stay at one depth")
    return np.array(values)


def _slides(case: Case) -> list[slice]:
    slides = case.phase_slices("slide")
    if not slides:
        raise NotMeasured("no phase named slide")
    return slides
