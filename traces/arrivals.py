"""What times of arrival say: the rate of a device, how much its lines jitter, and how far its clock is off."""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LEARN = 200  # lines before there is a clock
RECENT = 200  # lines that the jitter of the moment is of
LONGEST_GAP = 20  # periods: after a longer silence the clock may stand anywhere, and a new stretch begins
SEARCHED = 0.06  # the period is this near to the usual interval
BLOCK = 100  # lines whose phase is looked at together first
LONGER = 4  # so many blocks make the next one
PARTS = 8  # of the recording, taken as independent of each other
JUDGED = 20  # lines whose phase is one point of the last straight line
FINE = 0.2  # of a turn: what a block ends ahead from one tried rate to the next
EARLY = 0.3  # periods before the usual lateness that still belong to a line: a machine makes lines late, none early
CERTAIN = 25.0  # arrivals at any time come so near to a clock's once in exp(25)
KEPT = 0.5  # of how sharp phases are in short blocks, over all: less, and it is no clock but intervals that add up


class Clock(NamedTuple):
    period_s: float  # of one line
    error_s: float  # standard error of the period: what the jitter leaves open
    jitter_s: float  # standard deviation of the lateness, as far as it is under a period


class Arrivals:
    """The times at which lines came."""

    def __init__(self) -> None:
        self._times_s = array("d")

    def add(self, time_s: float) -> None:
        """One line came. Times must not fall."""
        self._times_s.append(time_s)

    @property
    def count(self) -> int:
        return len(self._times_s)

    @property
    def recent_jitter_s(self) -> float:
        """Spread of the last intervals as a standard deviation of the lateness; NaN before enough have come."""
        if self.count <= RECENT:
            return math.nan
        apart = np.diff(np.array(self._times_s[-RECENT:]))
        return float(1.4826 / math.sqrt(2.0) * np.median(np.abs(apart - np.median(apart))))

    def clock(self) -> Clock | None:
        """The device's clock by this machine's; None if there are too few lines, or too wild ones, to tell."""
        return find_clock(np.array(self._times_s))


def find_clock(times_s: NDArray[np.float64]) -> Clock | None:
    """The period to which arrivals are most in step: that of the sharpest phase (Rayleigh's test).

    An arrival is later than the device's clock by a time that varies. Lines that are lost, doubled, held back and sent
    at once, or some periods late on a busy machine do not move the phase of the others, and which number a line has
    need not be known. Rates around the usual one are tried on short blocks of lines, then rates around the best on
    blocks four times as long, and so on up to whole stretches without a gap.
    """
    time_s = np.unique(times_s) - times_s[:1]  # lines that came at once say no more than one
    if len(time_s) < LEARN:
        return None
    apart_s = np.diff(time_s)
    usual_s = float(np.median(apart_s))
    # Where lines come in lots, intervals are too long; there are as many lines as there are, but for those lost.
    near = apart_s <= LONGEST_GAP * usual_s
    usual_s = min(usual_s, float(apart_s[near].sum()) / (len(times_s) - 1 - int((~near).sum())))
    stretch = np.concatenate([[0], np.cumsum(apart_s > LONGEST_GAP * usual_s)])
    longest_s = max(float(np.ptp(part)) for part in np.split(time_s, np.flatnonzero(np.diff(stretch)) + 1))
    rate, reach, length_s, in_short = 1.0 / usual_s, SEARCHED / usual_s, BLOCK * usual_s, 0.0
    at_s, where, turn, lines = time_s, stretch, np.exp(2j * np.pi * rate * time_s), np.ones(len(time_s))
    while True:
        starts = _block_starts(at_s, where, length_s)
        counts = np.add.reduceat(lines, starts)
        changes = np.arange(-reach, reach, FINE / length_s)
        turned = [np.add.reduceat(turn * np.exp(2j * np.pi * change * at_s), starts) for change in changes]
        # Of arrivals at any time each block has a power of 1.
        power = [float((np.abs(found) ** 2 / counts).sum()) - len(starts) for found in turned]
        best = int(np.argmax(power))
        in_short = power[best] if length_s == BLOCK * usual_s else in_short
        rate += changes[best]
        at_s, where = np.add.reduceat(lines * at_s, starts) / counts, where[starts]
        # Each block is as one line from here on: its sum, turned at its middle.
        turn, lines, reach = turned[best], counts, 0.5 / length_s
        if length_s > longest_s:
            break
        length_s *= LONGER
    certain = power[best] > max(CERTAIN, KEPT * in_short)
    return _judge(time_s, stretch, rate) if certain else None


def _judge(time_s: NDArray[np.float64], stretch: NDArray[np.int64], rate: float) -> Clock | None:
    """The clock by a straight line through the phases of short blocks, one slope for all stretches."""
    turn = np.exp(2j * np.pi * rate * time_s)
    mean = np.zeros(stretch[-1] + 1, dtype=complex)
    np.add.at(mean, stretch, turn)
    turn *= np.conj(mean / np.abs(mean))[stretch]
    starts = _block_starts(time_s, stretch, JUDGED * float(np.median(np.diff(time_s))))
    found, where = np.add.reduceat(turn, starts), stretch[starts]
    weight, phase = np.abs(found), np.angle(found) / (2 * np.pi)
    at_s = np.add.reduceat(time_s, starts) / np.diff(np.append(starts, len(time_s)))
    total = np.bincount(where, weight)
    off_s = at_s - (np.bincount(where, weight * at_s) / total)[where]
    off = phase - (np.bincount(where, weight * phase) / total)[where]
    moment = float((weight * off_s**2).sum())
    if moment <= 0:
        return None
    slope = float((weight * off_s * off).sum()) / moment
    left = weight * off_s * (off - slope * off_s)
    lateness = (np.angle(turn) / (2 * np.pi) - slope * (time_s - time_s.mean()) + EARLY) % 1.0
    period_s = float(1.0 / (rate - slope))
    # What is left over is not independent from block to block where a machine was busy for a while, or a clock wanders.
    together = np.array([part.sum() for part in np.array_split(left, PARTS)])
    error_s = period_s**2 * float(max(np.linalg.norm(left), np.linalg.norm(together))) / moment
    return Clock(period_s, error_s, float(np.std(lateness)) * period_s)


def _block_starts(at_s: NDArray[np.float64], where: NDArray[np.int64], length_s: float) -> NDArray[np.int64]:
    """First rows of the blocks of a length in each stretch, times rising."""
    block = np.floor(at_s / length_s)
    return np.concatenate([[0], np.flatnonzero(np.diff(block) + np.diff(where)) + 1])
