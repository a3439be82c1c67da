"""What a person sees while a glove is recorded or emulated: one line on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

TERMINAL_S = 0.1
ELSEWHERE_S = 10.0
BARS = " ▁▂▃▄▅▆▇█"


class LiveLine:
    """Shows the newest text on stderr: over the last one on a terminal, else one line every ten seconds."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._next_s = time.monotonic() + (0.0 if self._terminal else ELSEWHERE_S)

    def show(self, text: Callable[[], str]) -> None:
        """text is asked for only when it is time."""
        now = time.monotonic()
        if now < self._next_s:
            return
        self._next_s = now + (TERMINAL_S if self._terminal else ELSEWHERE_S)
        sys.stderr.write(f"\r\x1b[K{text()}" if self._terminal else f"{text()}\n")
        sys.stderr.flush()

    def close(self) -> None:
        if self._terminal:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


class RateMeter:
    """Events a second over the last two seconds, or since it was asked last if that is longer ago."""

    def __init__(self) -> None:
        self._marks: list[tuple[float, int]] = []

    def rate(self, time_s: float, count: int) -> float:
        recent = [mark for mark in self._marks if mark[0] > time_s - 2.0]
        self._marks = [*(recent or self._marks[-1:]), (time_s, count)]
        (first_s, first), (last_s, last) = self._marks[0], self._marks[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


def bars(shares: Sequence[float]) -> str:
    """One block a finger, thumb first, as high as its share of 0 to 1; a dot where there is none."""
    blocks = [
        "·" if share != share else BARS[round(min(max(share, 0.0), 1.0) * (len(BARS) - 1))] or " " for share in shares
    ]
    return "|" + "|".join(blocks) + "|"


def clock(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60.0)
    return f"{int(minutes):02d}:{rest:04.1f}"
