"""Bytes of a serial port as lines, with the time of arrival of each, whatever comes in between."""

from __future__ import annotations


class LineBuffer:
    """Whole lines out of chunks of bytes. Holds at most `longest` bytes; what is longer is dropped and counted."""

    def __init__(self, longest: int) -> None:
        self.longest = longest
        self.overlong = 0  # lines that were dropped
        self._begun = b""
        self._skipping = False  # inside a line that is too long

    def feed(self, chunk: bytes) -> list[bytes]:
        """The lines that end in this chunk, without their ends (LF, with any CR before it)."""
        *whole, begun = (self._begun + chunk).split(b"\n")
        lines = []
        for line in whole:
            if self._skipping or len(line) > self.longest:
                self.overlong += not self._skipping
                self._skipping = False
            else:
                lines.append(line.rstrip(b"\r"))
        if self._skipping or len(begun) > self.longest:
            self.overlong += not self._skipping
            self._skipping, begun = True, b""
        self._begun = begun
        return lines

    def begin_anew(self) -> bool:
        """Forget the line that was begun, since its end will not come. Returns whether there was one."""
        lost = bool(self._begun) or self._skipping
        self._begun, self._skipping = b"", False
        return lost
