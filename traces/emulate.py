"""The `emulate` verb: a trace as a glove would send it, on a pseudo-terminal or a socket, with faults on demand."""

from __future__ import annotations

import math
import random
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from palmar.model import Array, HandModel
from palmar.records import Trace
from palmar.traces.glove_angles import readings_from_angles
from palmar.traces.line_faults import Faults, Log, Piece
from palmar.traces.opengloves import NO_FORCE, Reading, decode_force, encode_reading
from palmar.traces.wire import OPENED_S, Pty, Server

BAUD = 115200
USUAL_HZ = 200.0  # what the firmware comes to at this baud rate
LATEST_S = 0.25  # that a busy machine may make lines late; where it is later they are left out
ANSWER_S = 1.0  # lock-step firmware waits so long for the end of a line from the host
POT_OPEN, POT_CLOSED = 0.31, 0.74  # of a potentiometer's travel: what auto-ranging has to find out


class Emulator:
    """A glove that plays a trace, in the firmware's own order: read, send, and in lock-step wait for an answer."""

    def __init__(
        self,
        trace: Trace,
        hand: HandModel,
        wire: Pty | Server,
        *,
        form: str,
        full_scale: int,
        rate_hz: float,
        lock_step: bool,
        auto_range: bool,
        jitter_s: float,
        drift_ppm: float,
        count_lines: bool,
        loop: bool,
        faults: Faults,
        log: Log,
        seed: int,
        poses_to: tuple[str, int] | None = None,
    ) -> None:
        self.wire, self.faults, self.log = wire, faults, log
        self.force = [0] * 5
        self.sent: Counter[str] = Counter()
        self.not_heard = self.answers = self.forces = 0
        self._trace, self._form, self._full_scale = trace, form, full_scale
        self._lock_step, self._loop, self._count_lines = lock_step, loop, count_lines
        self._jitter_s, self._pace = jitter_s, 1.0 + drift_ppm * 1e-6  # seconds of the glove's clock in one of ours
        self._period_s = 1.0 / (rate_hz * self._pace)
        self._away = False  # nothing was sent on purpose, and is not made up for
        self._random = random.Random(seed)
        self._time_s = trace.time_s - trace.time_s[0]
        self._flexion, self._abduction = readings_from_angles(trace.flexion_rad, trace.abduction_rad, hand)
        self.clipped = int((trace.flexion_rad < 0).any(axis=(1, 2)).sum())
        self._range = (np.full(5, np.inf), np.full(5, -np.inf)) if auto_range else None
        self._side = 0 if hand.about.get("side") == "left" else 1
        self._held: list[bytes] = []  # back, for a stall
        self._held_until = self._other_until = 0.0
        self._from_host = b""
        self._number, self._played_s = 0, 0.0
        self._poses = None if poses_to is None else socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._poses_to = poses_to

    def run(self, stopped: Callable[[], bool], told: Callable[[Emulator], None], duration_s: float | None) -> None:
        """Play until the trace is over, `stopped()` or the duration is. The trace begins when a host opens the port."""
        while not stopped() and not self.wire.heard():
            time.sleep(0.01)
        time.sleep(OPENED_S)
        start = due = idle = time.monotonic()
        while not stopped() and (duration_s is None or time.monotonic() - start < duration_s):
            begins = max(due + abs(self._random.gauss(0.0, self._jitter_s)), idle)
            self._listen(begins)
            played = (due - start) * self._pace
            if played > self._time_s[-1] and not self._loop:
                break
            # The wire carries ten bits a byte; the firmware's next turn begins when its buffer is empty.
            # A glove does not know how busy this machine is: lines that would have come by now are sent at once. One
            # that waits for an answer goes on when it has it.
            idle = time.monotonic() if self._lock_step else begins
            carried_s = self._say(played) * 10 / BAUD
            idle += carried_s
            step = max(self._period_s, carried_s)
            due += step
            if self._lock_step:
                self._await_answer(time.monotonic() + ANSWER_S)
            now = time.monotonic()
            if self._away or due < now - LATEST_S:
                due += max(math.ceil((now - due) / step), 0) * step
                self._away = False
            told(self)
        if self._held:
            self.wire.send(b"".join(self._held))

    def line(self, played_s: float) -> bytes:
        """The line for a time of the trace; of a trace that loops, again from its beginning."""
        if self._loop:
            played_s %= float(self._time_s[-1]) or 1.0
        self._played_s = played_s
        k = max(int(np.searchsorted(self._time_s, played_s + 1e-9, side="right")) - 1, 0)
        self._send_pose(k)
        flexion, abduction = self._flexion[k], self._abduction[k]
        if self._range is not None:
            flexion = self._ranged(flexion)
        stick = (0.0, 0.0)
        if self._count_lines:
            # The number of the line in base full scale + 1, so that it can be found again.
            high, low = divmod(self._number, self._full_scale + 1)
            stick = (2.0 * low / self._full_scale - 1.0, 2.0 * (high % (self._full_scale + 1)) / self._full_scale - 1.0)
        trigger = max(2.0 * float(flexion[1, 0]) - 1.0, 0.0)
        reading = Reading(flexion.ravel().tolist(), abduction.tolist(), stick, trigger, 0)
        return encode_reading(reading, self._full_scale, self._form)

    def _say(self, played_s: float) -> int:
        """Send what there is to send in one turn; gives the length of the line."""
        now = time.monotonic()
        line = self.line(played_s)
        if away := self.faults.wanted("unplug"):
            self._unplug(away)
            return len(line)
        if quiet := self.faults.wanted("silence"):
            self._away = True
            self.sent["silence"] += 1
            self._write("silence", b"under force" if any(self.force) else b"")
            self._listen(now + quiet)
            return len(line)
        if size := int(self.faults.wanted("flood")):
            self._send(Piece(self.faults.noise(size) + b"\xfe\n", "flood"), now)
        if other := self.faults.wanted("other"):
            self._other_until = now + other
            self._send(Piece(f"Z(ZV)5(ZG)1(ZH){1 - self._side}\n".encode(), "info"), now)
        if self._other_until and now > self._other_until:
            self._other_until = 0.0
            self._send(Piece(f"Z(ZV)5(ZG)1(ZH){self._side}\n".encode(), "info"), now)
        if held := self.faults.wanted("stall"):
            self._held_until = now + held
        for piece in self.faults.pieces(line):
            kind = "other" if self._other_until and piece.kind == "good" else piece.kind
            self._send(Piece(piece.content, kind), now)
        self._number += 1
        return len(line)

    def _send(self, piece: Piece, now: float) -> None:
        if not self.wire.heard():
            self.not_heard += 1
            return
        if now < self._held_until:
            self._held.append(piece.content)
        else:
            content = b"".join(self._held) + piece.content
            self._held.clear()
            if not self.wire.send(content):
                self.not_heard += 1
                return
        self.sent[piece.kind] += 1
        self._write(piece.kind, b"" if piece.kind == "flood" else piece.content)

    def _write(self, kind: str, content: bytes = b"") -> None:
        self.log.add(time.monotonic(), self._played_s, kind, self._number, content)

    def _unplug(self, away_s: float) -> None:
        self._away = True
        # What is still in the wire would be lost; a test could not tell that from a fault of the host.
        time.sleep(OPENED_S)
        self.wire.unplug()
        self._other_until = 0.0  # what comes back says nothing of another hand
        self.sent["unplug"] += 1
        time.sleep(away_s)
        self.wire.plug()
        self._write("plug")

    def _listen(self, until: float) -> None:
        """Take what the host sends while it is not yet time for the next line."""
        while True:
            left = until - time.monotonic()
            self._hear(self.wire.receive(left))
            if left <= 0:
                return
            if not self.wire.heard():
                time.sleep(max(min(until - time.monotonic(), 0.01), 0.0))

    def _await_answer(self, until: float) -> None:
        before = self.answers
        while self.answers == before and (left := until - time.monotonic()) > 0:
            if not self.wire.heard():
                return
            self._hear(self.wire.receive(left))

    def _hear(self, content: bytes) -> None:
        *lines, self._from_host = (self._from_host + content).split(b"\n")
        self._from_host = self._from_host[-64:]
        for line in lines:
            self.answers += 1
            force = decode_force(line)
            if force is not None:
                self.forces += 1
                self.force = force
                if line + b"\n" == NO_FORCE:
                    self._write("no force")

    def _ranged(self, flexion: Array) -> Array:
        """What auto-ranging firmware makes of a potentiometer: shares of the travel that it has seen so far."""
        assert self._range is not None
        least, most = self._range
        pot = POT_OPEN + (POT_CLOSED - POT_OPEN) * flexion[:, 0]
        np.minimum(least, pot, out=least)
        np.maximum(most, pot, out=most)
        seen = np.where(most > least, most - least, 1.0)
        return np.repeat(((pot - least) / seen)[:, None], 3, axis=1)

    def _send_pose(self, k: int) -> None:
        if self._poses is None or self._poses_to is None or not self._trace.tracked[k]:
            return
        numbers = [*self._trace.palm_position_m[k], *self._trace.palm_rotation_wxyz[k]]
        text = " ".join(f"{number:.9g}" for number in [time.monotonic(), *numbers])
        self._poses.sendto(text.encode() + b"\n", self._poses_to)


def summarise_emulation(emulator: Emulator) -> dict[str, Any]:
    """What was sent, by kind, and what the host answered."""
    return {
        "sent": dict(sorted(emulator.sent.items())),
        "nobody listened": emulator.not_heard,
        "answers": emulator.answers,
        "force commands": emulator.forces,
        "samples with a negative flexion, sent as 0": emulator.clipped,
    }
