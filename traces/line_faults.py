"""What can go wrong between a glove and its host, on demand and by a seed: bad lines, and times without any."""

from __future__ import annotations

import json
import random
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from palmar.errors import PalmarError
from palmar.traces.columns import nearest

BANNER = (
    b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    b"configsip: 0, SPIWP:0xee\r\nmode:DIO, clock div:1\r\nload:0x3fff0030,len:1184\r\nentry 0x400805f0\r\n"
)


class Fault(NamedTuple):
    """share: of lines, where `--fault all` asks for it. amount: what may stand behind the colon."""

    share: float
    about: str
    amount: float | None = None
    amount_of: str = ""


FAULTS: dict[str, Fault] = {
    "garbage": Fault(0.01, "random bytes before the line, without an end of their own"),
    "banner": Fault(0.0005, "the text that a board prints when it starts"),
    "nul": Fault(0.005, "NUL bytes before the line"),
    "crlf": Fault(0.05, "CR LF and an empty line, as over Wi-Fi"),
    "corrupt": Fault(0.01, "one to three bytes of the line replaced"),
    "cut": Fault(0.01, "the line's tail is lost, in half of the cases with its end"),
    "missing": Fault(0.005, "one value is left out"),
    "range": Fault(0.005, "one value is above the full scale"),
    "overlong": Fault(0.001, "a line of some thousand bytes", 3000, "bytes"),
    "drop": Fault(0.01, "the line is not sent"),
    "double": Fault(0.01, "the line is sent twice"),
    "stall": Fault(0.001, "lines are held back, then sent at once", 0.05, "seconds"),
    "silence": Fault(0.0002, "nothing is sent for a while", 0.5, "seconds"),
    "flood": Fault(0.00005, "that many random bytes at once", 200_000, "bytes"),
    "unplug": Fault(0.0001, "the port goes away, and comes back under another name", 0.5, "seconds"),
    "other": Fault(0.0002, "lines that say they are of the other hand", 0.2, "seconds"),
}


class Piece(NamedTuple):
    """Bytes to send, and what they are in the log: "good", or the fault."""

    content: bytes
    kind: str


def parse_faults(pairs: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Share and amount of each fault that is asked for. Raises PalmarError E-CONF.

    pairs: `garbage=0.01` and `silence=0.001:2` by key; `all` for every fault at its own share, or that share times a
    number.
    """
    chosen: dict[str, tuple[float, float]] = {}
    for name, value in pairs.items():
        first, _, second = str(value).partition(":")
        try:
            share, amount = float(first), float(second) if second else None
        except ValueError:
            share, amount = -1.0, None
        where = f"--fault {name}"
        if name == "all":
            if share < 0 or second:
                raise PalmarError("E-CONF", where, f"{value!r}; a number of 0 or more is allowed, or nothing")
            chosen |= {key: (min(fault.share * share, 1.0), fault.amount or 0.0) for key, fault in FAULTS.items()}
            continue
        if name not in FAULTS:
            known = [*FAULTS, "all"]
            raise PalmarError("E-CONF", where, f"no such fault{nearest(name, known)}; known are {', '.join(known)}")
        fault = FAULTS[name]
        if not 0 <= share <= 1 or (amount is not None and (fault.amount is None or not 0 < amount <= 1e7)):
            behind = f", and :{fault.amount_of} behind it" if fault.amount_of else ""
            raise PalmarError("E-CONF", where, f"{value!r}; a share of the lines from 0 to 1 is needed{behind}")
        chosen[name] = (share, amount if amount is not None else fault.amount or 0.0)
    return chosen


class Faults:
    """Draws faults line by line; same seed, same faults. What the wire itself does is told by `wanted`."""

    def __init__(self, chosen: dict[str, tuple[float, float]], full_scale: int, seed: int) -> None:
        self._chosen, self._full_scale = chosen, full_scale
        self._random = random.Random(seed)
        self.drawn: Counter[str] = Counter()

    def wanted(self, name: str) -> float:
        """The amount of a fault of the wire (stall, silence, flood, unplug, other) if it is to happen now, else 0."""
        share, amount = self._chosen.get(name, (0.0, 0.0))
        happens = share > 0 and self._random.random() < share
        self.drawn[name] += happens
        return amount if happens else 0.0

    def pieces(self, line: bytes) -> list[Piece]:
        """What is sent in place of a line, in order."""
        before: list[Piece] = []
        if self.wanted_flag("banner"):
            before.append(Piece(BANNER, "banner"))
        if size := self.wanted("overlong"):
            before.append(Piece(self.noise(int(size), b"\n") + b"\n", "overlong"))
        if self.wanted_flag("garbage"):
            # Ends with a byte that no line begins with or goes on with.
            before.append(Piece(self.noise(self._random.randint(1, 40), b"\n") + b"\xfe", "garbage"))
        if self.wanted_flag("nul"):
            before.append(Piece(b"\0" * self._random.randint(1, 8), "nul"))
        if self.wanted_flag("drop"):
            return [*before, Piece(b"", "drop")]
        for name, change in (
            ("corrupt", self._corrupt),
            ("cut", self._cut),
            ("missing", self._missing),
            ("range", self._range),
        ):
            if self.wanted_flag(name):
                return [*before, Piece(change(line), name)]
        if self.wanted_flag("crlf"):
            line = line[:-1] + b"\r\n\r\n"
        good = [Piece(line, "good")]
        return [*before, *good, *good] if self.wanted_flag("double") else [*before, *good]

    def wanted_flag(self, name: str) -> bool:
        share = self._chosen.get(name, (0.0, 0.0))[0]
        happens = share > 0 and self._random.random() < share
        self.drawn[name] += happens
        return happens

    def noise(self, size: int, without: bytes = b"") -> bytes:
        return bytes(b for b in self._random.randbytes(size) if b not in without)

    def _corrupt(self, line: bytes) -> bytes:
        """Other bytes, but no digit for a digit: without a checksum, that is another number and no error."""
        content = bytearray(line)
        for _ in range(self._random.randint(1, 3)):
            at = self._random.randrange(len(content) - 1)
            other = [b for b in range(256) if b != content[at] and b != 10]
            if 48 <= content[at] < 58:
                other = [b for b in other if not 48 <= b < 58]
            content[at] = self._random.choice(other)
        return bytes(content)

    def _cut(self, line: bytes) -> bytes:
        """In front of a key, or behind one: a number that lost its last digits is another number and no error."""
        keys = [k for k, b in enumerate(line) if (65 <= b < 91 or b == 40) and k > 0]
        end = b"\n" if self._random.random() < 0.5 else b""
        return line[: self._random.choice(keys) if keys else 0] + end

    def _missing(self, line: bytes) -> bytes:
        starts = [k for k, b in enumerate(line) if b == 40 or (65 <= b < 91 and b"(" not in line[max(k - 3, 0) : k])]
        k = self._random.randrange(max(len(starts) - 1, 1))
        return line[: starts[k]] + line[starts[k + 1] :] if len(starts) > 1 else b"\n"

    def _range(self, line: bytes) -> bytes:
        at = next((k for k, b in enumerate(line) if 48 <= b < 58), 0)
        end = next((k for k in range(at, len(line)) if not 48 <= line[k] < 58), at)
        return line[:at] + str(self._full_scale + self._random.randint(1, 90000)).encode() + line[end:]


class Log:
    """What was sent, a JSON object a line: time by the monotonic clock, time of the trace, kind, line, text."""

    def __init__(self, path: Path | None) -> None:
        self._file: TextIO | None = None if path is None else path.open("w", buffering=1 << 16)

    def add(self, time_s: float, played_s: float, kind: str, number: int, content: bytes = b"") -> None:
        if self._file is not None:
            entry = {"time_s": time_s, "played_s": played_s, "kind": kind, "line": number}
            self._file.write(json.dumps(entry | {"text": content.strip().decode("latin-1")}) + "\n")

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
