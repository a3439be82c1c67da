"""What times of arrival say: the rate of a device, how much its lines jitter, and how far its clock is off."""

from __future__ import annotations

import itertools
import math
import statistics

LEARN = 200  # intervals before there is a period
LOOK_EVERY = 400  # lines
# Standard deviation of a wrong count of lines is 0.29 periods: whatever is farther out than this is counted anew.
WRONG = 0.26
EARLY = 0.3  # periods before the line that still belong to it; a busy machine makes lines late, none early
LONGEST_GAP = 20  # periods: after a longer silence the count of lines is not to be known, and a new stretch begins


class Arrivals:
    """Straight lines through time of arrival against number of line, one slope for all stretches without a gap.

    Which number a line has follows from its time, so lines that are lost, doubled or held back and sent at once do not
    turn the slope. The arrival is later than the device's clock by a time that varies, never earlier: what varies is
    the jitter, and the slope is the device's period by the clock of this machine.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first: list[float] = []
        self._period = math.nan  # of the first intervals, then of the fit
        self._slope_top = self._slope_bottom = 0.0  # of the stretches that are over
        self._squares = 0.0
        self._points = 0
        self._begin(0.0)

    def add(self, time_s: float) -> None:
        """One line came. Times must not fall."""
        self.count += 1
        if math.isnan(self._period):
            self._learn(time_s)
            return
        number = math.floor((time_s - self._line_at_zero()) / self._period + EARLY) if self._n else 0
        if self._n and number - self._number > LONGEST_GAP:
            self._end_stretch()
            self._begin(time_s)
            number = 0
        if self._n and number <= self._number:
            return  # sent twice, or late together with others
        self._take(number, time_s - self._zero)

    @property
    def period_s(self) -> float:
        """Of one line; NaN before enough have come."""
        top, bottom = self._slopes()
        return top / bottom if bottom > 0 else self._period

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the arrivals about the line; NaN before enough have come."""
        top, bottom = self._slopes()
        points = self._points + self._n
        if points < LEARN or bottom <= 0:
            return math.nan
        squares = self._squares + self._ctt - top * top / bottom
        return math.sqrt(max(squares, 0.0) / points)

    @property
    def is_known(self) -> bool:
        """Whether the arrivals are so near to a clock's that the period means something."""
        return self.jitter_s < WRONG * self.period_s

    @property
    def period_error_s(self) -> float:
        """Standard error of the period: what the jitter leaves open."""
        bottom = self._slopes()[1]
        return self.jitter_s / math.sqrt(bottom) if bottom > 0 else math.nan

    def _learn(self, time_s: float) -> None:
        self._first.append(time_s)
        if len(self._first) > LEARN:
            first, self._first = self._first, []
            steps = [b - a for a, b in itertools.pairwise(first)]
            usual = statistics.median([step for step in steps if step > 0] or [math.nan])
            if math.isnan(usual):
                return
            # How many lines each interval is, from the interval alone: an error of the usual one does not add up.
            self._begin(first[0])
            self._period = usual
            number = 0
            self._take(0, 0.0)
            for time, step in zip(first[1:], steps, strict=True):
                number += min(round(step / usual), LONGEST_GAP + 1)
                if number - self._number > LONGEST_GAP:
                    self._end_stretch()
                    self._begin(time)
                    number = 0
                    self._take(0, 0.0)
                elif number > self._number:
                    self._take(number, time - self._zero)
            self._period = self.period_s

    def _begin(self, zero_s: float) -> None:
        self._zero, self._n, self._number = zero_s, 0, 0
        self._mean_k = self._mean_t = 0.0
        self._ckk = self._ckt = self._ctt = 0.0  # sums of products about the means (Welford 1962)

    def _take(self, number: int, after_s: float) -> None:
        self._n += 1
        self._number = number
        off_k, off_t = number - self._mean_k, after_s - self._mean_t
        self._mean_k += off_k / self._n
        self._mean_t += off_t / self._n
        self._ckk += off_k * (number - self._mean_k)
        self._ckt += off_k * (after_s - self._mean_t)
        self._ctt += off_t * (after_s - self._mean_t)
        if self._ckk > 0 and self._points + self._n > LEARN:
            self._period = self.period_s
            if self._n % LOOK_EVERY == 0 and self.jitter_s > WRONG * self._period:
                self._forget()

    def _forget(self) -> None:
        self._period, self._first = math.nan, []
        self._slope_top = self._slope_bottom = self._squares = 0.0
        self._points = 0
        self._begin(0.0)

    def _line_at_zero(self) -> float:
        return self._zero + self._mean_t - self._period * self._mean_k

    def _slopes(self) -> tuple[float, float]:
        return self._slope_top + self._ckt, self._slope_bottom + self._ckk

    def _end_stretch(self) -> None:
        self._slope_top += self._ckt
        self._slope_bottom += self._ckk
        self._squares += self._ctt
        self._points += self._n
