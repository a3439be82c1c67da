"""The OpenGloves (lucidgloves) serial encoding: lines of a glove as readings, forces as a line to it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

FULL_SCALE = 4095  # of an ESP32; an AVR has 1023. The stream does not say it.
LONGEST_LINE = 512  # bytes; the fullest line of the encoding, every key and five digits, has 330
NEW_KEYS_AFTER = 5  # lines in a row with other keys than before, and the glove has changed what it sends
FORCE_FULL_SCALE = 1000
NO_FORCE = b"A0B0C0D0E0\n"
ANSWER = b"\n"  # lets lock-step firmware go on; shorter than any command

BUTTONS = "HIJKLMNO"  # joystick, trigger, A, B, grab, pinch, menu, calibrate
CALIBRATE = 1 << BUTTONS.index("O")

# Where the number of a key goes: flexion 3 finger + joint, abduction 15 + finger, then joystick x, y and trigger. The
# encoding's joint A of a finger is its metacarpal, which no hand model here bends; the thumb has no joint D.
_PLACE = {f"({letter}B)": 15 + f for f, letter in enumerate("ABCDE")} | {"F": 20, "G": 21, "P": 22}
_PLACE |= {f"(AA{joint})": k for k, joint in enumerate("ABC")}
_PLACE |= {f"({letter}A{joint})": 3 * f + k for f, letter in enumerate("ABCDE") if f for k, joint in enumerate("BCD")}
_UNUSED = {"(AAD)", *(f"({letter}AA)" for letter in "BCDE")}
_CURLS = {letter: 3 * f for f, letter in enumerate("ABCDE")}
_ANALOG = _PLACE.keys() | _CURLS.keys() | _UNUSED
_INFO = {"Z", "(ZV)", "(ZG)", "(ZH)"}

_FIELD = re.compile(rb"([A-Z]|\([A-Z]{2,3}\))(\d{0,5})")
_LINE = re.compile(rb"(?:(?:[A-Z]|\([A-Z]{2,3}\))\d{0,5})+\Z")  # searched for: the longest end of the line that reads
_LEGACY = re.compile(rb"(?:\d{1,5}&){12}\d{1,5}\Z")


class Reading(NamedTuple):
    """One line: what the glove says of each finger, as shares of its full scale."""

    flexion: list[float]  # 15: thumb MCP PIP DIP, index ...; 0 open to 1 closed, NaN for a joint that is not sent
    abduction: list[float]  # 5: -1 to 1, NaN if not sent
    joystick: tuple[float, float]  # -1 to 1
    trigger: float  # 0 to 1
    buttons: int  # bit k is BUTTONS[k]


class Rejected(Exception):
    """A line that is no reading; the text is the kind that it is counted under."""


@dataclass
class Decoder:
    """Lines to readings, with what the lines before said: which keys this glove sends, and of which hand it is.

    The encoding has no checksum. A line counts if it has the form, every number is inside the full scale, and its
    keys are those that the glove sends, in its order. Of a line that was glued to the end of a broken one, what follows
    the broken part is used.
    """

    full_scale: int = FULL_SCALE
    keys: tuple[str, ...] = ()  # of this glove, in its order; none before the first line
    hand: int | None = None  # 0 left, 1 right, if an info packet said so
    glued: int = 0  # broken parts in front of lines that were used
    largest: int = 0  # count so far
    _others: tuple[tuple[str, ...], int] = ((), 0)  # other keys that were seen last, and how often in a row

    def decode(self, line: bytes) -> Reading | None:
        """The reading of a line without its end; None for an info packet. Raises Rejected."""
        if _LEGACY.search(line):
            return self._legacy(line)
        found = _LINE.search(line)
        if found is None:
            raise Rejected("cut" if re.fullmatch(rb"\d+(&\d*)+", line) else "garbage")
        fields = [(key.decode(), digits) for key, digits in _FIELD.findall(line, found.start())]
        whole = _after_repeat(fields)
        broken = found.start() > 0 or len(whole) < len(fields)
        fields, names = whole, [key for key, _ in whole]
        if "Z" in names:
            # What stands before it is the rest of a broken line, or the end of noise.
            info = names.index("Z")
            if set(names[info:]) <= _INFO:
                self._inform(dict(fields[info:]))
                return None
            fields, broken = fields[info + 1 :], True
        values = dict(fields)
        try:
            reading = self._reading(values)
        except Rejected:
            if found.start() > 0:
                raise Rejected("garbage") from None
            raise
        self.glued += broken
        return reading

    def _reading(self, values: dict[str, bytes]) -> Reading:
        numbers = [math.nan] * 20 + [0.5, 0.5, 0.0]
        keys: list[str] = []
        buttons = 0
        for key, digits in values.items():
            if key in _ANALOG:
                if not digits:
                    raise Rejected("cut")
                keys.append(key)
                count = int(digits)
                if count > self.full_scale:
                    raise Rejected("out of range")
                if key in _PLACE:
                    numbers[_PLACE[key]] = count / self.full_scale
            elif key in BUTTONS and not digits:
                buttons |= 1 << BUTTONS.index(key)
                keys.append(BUTTONS)
            else:
                raise Rejected("garbage")
        for letter, place in _CURLS.items():
            # Of a finger whose joints are sent one by one, those override the curl.
            if letter in values and all(map(math.isnan, numbers[place : place + 3])):
                numbers[place] = int(values[letter]) / self.full_scale
            if all(map(math.isnan, numbers[place : place + 3])):
                raise Rejected("cut")
        self._expect(_order(keys))
        self.largest = max(self.largest, *(int(values[key]) for key in keys if key in values))
        signed = [2.0 * n - 1.0 for n in numbers[15:22]]
        return Reading(numbers[:15], signed[:5], (signed[5], signed[6]), numbers[22], buttons)

    def _legacy(self, line: bytes) -> Reading:
        """Thirteen numbers joined by &: five curls, joystick x and y, click, trigger, A, B, grab, pinch."""
        found = _LEGACY.search(line)
        assert found is not None
        if found.start() > 0 and line[found.start() - 1 : found.start()] == b"&":
            raise Rejected("garbage")  # more than thirteen: which of them are the line's is not to be known
        numbers = [int(part) for part in found.group().split(b"&")]
        if max(numbers[:7]) > self.full_scale:
            raise Rejected("out of range")
        if max(numbers[7:]) > 1:
            raise Rejected("garbage")
        self._expect(("&",))
        self.glued += found.start() > 0
        self.largest = max(self.largest, *numbers[:7])
        share = [n / self.full_scale for n in numbers[:7]]
        flexion = [math.nan] * 15
        flexion[::3] = share[:5]
        buttons = sum(bit << k for k, bit in enumerate(numbers[7:]))
        stick = (2.0 * share[5] - 1.0, 2.0 * share[6] - 1.0)
        return Reading(flexion, [math.nan] * 5, stick, float(numbers[8]), buttons)

    def _inform(self, values: dict[str, bytes]) -> None:
        if values.get("(ZH)") in (b"0", b"1"):
            self.hand = int(values["(ZH)"])

    def _expect(self, keys: tuple[str, ...]) -> None:
        """Let a line pass that has the keys of this glove; others only once they come again and again."""
        if self.keys and keys != self.keys:
            times = self._others[1] + 1 if self._others[0] == keys else 1
            self._others = (keys, times)
            if times < NEW_KEYS_AFTER:
                raise Rejected("other keys")
        self.keys = keys
        self._others = ((), 0)


def _order(keys: list[str]) -> tuple[str, ...]:
    """The keys of a line as they stand; buttons, which come and go, only where no firmware puts them."""
    places = [k for k, key in enumerate(keys) if key == BUTTONS]
    if places and places[-1] - places[0] + 1 == len(places):
        after = keys[places[0] - 1] if places[0] else ""
        if after == "P" or places[-1] == len(keys) - 1:
            return tuple(key for key in keys if key != BUTTONS)
    return tuple(keys)


def _after_repeat(fields: list[tuple[str, bytes]]) -> list[tuple[str, bytes]]:
    """The last fields of a line in which no key stands twice: what was glued to the end of a broken line."""
    seen: set[str] = set()
    for k in range(len(fields) - 1, -1, -1):
        if fields[k][0] in seen:
            return fields[k + 1 :]
        seen.add(fields[k][0])
    return fields


def encode_reading(reading: Reading, full_scale: int = FULL_SCALE, form: str = "curls") -> bytes:
    """A reading as the line of a glove, with its end. Values are clipped to the full scale.

    form: "curls", one number a finger, as current firmware sends it; "joints", with every joint and the splay;
    "legacy", thirteen numbers joined by &.
    """

    def count(share: float) -> int:
        return round(min(max(share, 0.0), 1.0) * full_scale)

    curls = [count(reading.flexion[3 * f]) for f in range(5)]
    x, y = (count((axis + 1.0) / 2.0) for axis in reading.joystick)
    pressed = [reading.buttons >> k & 1 for k in range(8)]
    if form == "legacy":
        return "&".join(str(n) for n in [*curls, x, y, *pressed[:6]]).encode() + b"\n"
    text = "".join(f"{letter}{curl}" for letter, curl in zip("ABCDE", curls, strict=True))
    text += f"F{x}G{y}P{count(reading.trigger)}"
    text += "".join(letter for letter, bit in zip(BUTTONS, pressed, strict=True) if bit)
    if form == "joints":
        for f, letter in enumerate("ABCDE"):
            for k, joint in enumerate("BCD" if f else "ABC"):
                text += f"({letter}A{joint}){count(reading.flexion[3 * f + k])}"
            text += f"({letter}B){count((reading.abduction[f] + 1.0) / 2.0)}"
    return text.encode() + b"\n"


def encode_force(levels: list[int]) -> bytes:
    """Five limits from 0, free, to 1000, blocked, as the line for the glove."""
    return "".join(f"{letter}{level}" for letter, level in zip("ABCDE", levels, strict=True)).encode() + b"\n"


def decode_force(line: bytes) -> list[int] | None:
    """What firmware takes from a line of the host: five limits; None for a line too short to be a command."""
    if len(line.strip()) < 5:
        return None
    values = {key.decode(): digits for key, digits in _FIELD.findall(line)}
    return [min(int(values.get(letter) or 0), FORCE_FULL_SCALE) for letter in "ABCDE"]
