"""The `record` verb: a glove on a serial port -> trace, whatever the port does. What it survives: docs/record.md."""

from __future__ import annotations

import contextlib
import math
import select
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from palmar._runtime import DeviceRecording
from palmar.errors import BadTrace
from palmar.model import HandModel
from palmar.profile import Profile
from palmar.traces.arrivals import Arrivals
from palmar.traces.glove_angles import STAGGER_S, AngleMap
from palmar.traces.line_buffer import LineBuffer
from palmar.traces.live_hand import LiveHand
from palmar.traces.opengloves import ANSWER, CALIBRATE, LONGEST_LINE, NO_FORCE, Decoder, Reading, Rejected
from palmar.traces.port import RETRY_S, Port
from palmar.traces.pose_source import PoseSource

TICK_S = 0.02  # longest wait: silence and signals are noticed so much later
FORCE_SILENCE_S = 0.06  # without a good line for so long, no force; with the tick, before a tenth of a second is over
GAP_S = 0.1  # and after so long the trace says that the hand is lost
FLOOD_BYTES_PER_S = 131072  # eleven times what a glove's serial line carries
FLOOD_BURST = 262144
FLOOD_PAUSE_S = 0.005
SAME_RATE = 0.01  # share by which a clock may be off and still be that of the nominal rate


@dataclass
class Tally:
    """What happened, counted."""

    received: int = 0  # lines, empty ones not
    decoded: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    empty: int = 0
    info: int = 0
    calibrations: int = 0  # times the calibrate button was pressed
    samples: int = 0
    not_placed: int = 0  # samples whose palm pose was not known
    gaps: int = 0
    gap_s: float = 0.0
    longest_gap_s: float = 0.0
    bytes: int = 0
    flooded_s: float = 0.0
    forces_sent: int = 0
    forces_released: int = 0  # times it went to none for want of a sample


class Recorder:
    """One recording. `run` until it says so or a person does; `summary` then tells what was recorded and what was not.

    Everything happens on one thread that waits for the glove and the pose source together; only the disk has its own.
    """

    def __init__(
        self,
        port: Port,
        pose: PoseSource,
        recording: DeviceRecording,
        hand: HandModel,
        *,
        profile: Profile | None = None,
        decoder: Decoder,
        side: str,
        live: LiveHand | None = None,
        passive: bool = False,
        start_s: float,
    ) -> None:
        self.port, self.pose, self.recording = port, pose, recording
        self.decoder, self.live, self.passive = decoder, live, passive
        self._map = AngleMap(hand, profile)
        self.tally, self.arrivals = Tally(), Arrivals()
        self.last: Reading | None = None
        self.failed: BadTrace | None = None
        self.time_s = 0.0
        self._hand_number = 0 if side == "left" else 1
        self._start_s = start_s
        self._lines = LineBuffer(LONGEST_LINE)
        self._pending: deque[tuple[float, list[float], list[float]]] = deque()
        self._good_s = -math.inf  # when the last good line came
        self._sample_s = -math.inf  # of the last sample that was written
        self._silent = self._let_go = True
        self._retry_s = 0.0
        self._allowed, self._allowed_s = float(FLOOD_BURST), 0.0
        self._pressed = False

    @property
    def overlong(self) -> int:
        return self._lines.overlong

    def run(self, stopped: Callable[[], bool], told: Callable[[Recorder], None], duration_s: float | None) -> None:
        """Record until `stopped()`, the duration is over or the disk is full; `told` is called at each turn."""
        try:
            while not stopped() and (duration_s is None or self.time_s < duration_s):
                self._wait()
                self._receive()
                self._look_for_silence()
                self._write_ready()
                told(self)
        except BadTrace as error:
            if error.code != "E-TRACE-WRITE":
                raise
            self.failed = error
        finally:
            self._release()
            if self.failed is None:
                # The last samples get the pose that there is.
                with contextlib.suppress(BadTrace):
                    self._write_ready(all_of_them=True)

    def _wait(self) -> None:
        files = [*self.pose.files, *([self.port.fileno()] if self.port.is_open else [])]
        ready, _, _ = select.select(files, [], [], TICK_S)
        self.time_s = time.monotonic() - self._start_s
        self._ready = set(ready)

    def _receive(self) -> None:
        if any(file in self._ready for file in self.pose.files) or not self.pose.files:
            content = self.pose.receive(self.time_s)
            if content:
                self.recording.add_pose_bytes(self.time_s, content)
        if not self.port.is_open:
            if self.time_s >= self._retry_s:
                self._retry_s = self.time_s + RETRY_S
                if self.port.connect():
                    self.decoder.hand = None  # another glove may have been plugged in
                    self._send(NO_FORCE if self.live else b"")
        elif self.port.fileno() in self._ready:
            content = self.port.read()
            if content:
                self._take(content)
            elif content is None:
                self.tally.rejected["unplugged"] += self._lines.begin_anew()
                self._retry_s = self.time_s + RETRY_S

    def _take(self, content: bytes) -> None:
        self.tally.bytes += len(content)
        self.recording.add_device_bytes(self.time_s, content)
        lines = self._lines.feed(content)
        readings = [reading for reading in map(self._decode, lines) if reading is not None]
        if readings:
            self._measure(readings)
        if lines and not self.passive:
            self._send(self._answer(bool(readings)))
        self._hold_flood(len(content))

    def _decode(self, line: bytes) -> Reading | None:
        if not line:
            self.tally.empty += 1
            return None
        self.tally.received += 1
        try:
            reading = self.decoder.decode(line)
        except Rejected as why:
            self.tally.rejected[str(why)] += 1
            return None
        if reading is None:
            self.tally.info += 1
        elif self.decoder.hand not in (None, self._hand_number):
            self.tally.rejected["other hand"] += 1
            return None
        return reading

    def _measure(self, readings: list[Reading]) -> None:
        """Samples of the lines of one chunk; they came together and are a microsecond apart."""
        for reading in readings:
            flexion, abduction = self._map.angles(reading)
            when = max(self.time_s, self._pending[-1][0] + STAGGER_S if self._pending else self._sample_s + STAGGER_S)
            self._end_silence(when)
            self._good_s = when
            self.arrivals.add(self.time_s)
            self.recording.add_reading(when, *reading)
            self._pending.append((when, flexion, abduction))
            pressed = bool(reading.buttons & CALIBRATE)
            self.tally.calibrations += pressed and not self._pressed
            self._pressed = pressed
        self.tally.decoded += len(readings)
        self.last = readings[-1]
        if self.live is not None:
            placed = self.pose.at(self._good_s)
            if placed.known:
                self.live.step(self._good_s, placed, flexion, abduction)
            elif not self._let_go:
                self._release()

    def _answer(self, measured: bool) -> bytes:
        if self.live is None or not measured or not self.live.levels:
            return ANSWER
        self._let_go = False
        self.tally.forces_sent += 1
        return self.live.command()

    def _send(self, content: bytes) -> None:
        if content and not self.passive:
            self.port.write(content)

    def _release(self) -> None:
        """No force, at once."""
        if self.live is not None and not self._let_go:
            self._let_go = True
            self.tally.forces_released += 1
            self.live.let_go()
            self._send(NO_FORCE)

    def _look_for_silence(self) -> None:
        silent_s = self.time_s - self._good_s
        if silent_s > FORCE_SILENCE_S:
            self._release()
        if silent_s > GAP_S and not self._silent:
            self._silent = True
            self._write_ready(all_of_them=True)
            when = max(self._good_s + GAP_S, self._sample_s + STAGGER_S)
            placed = self.pose.at(when)
            self._write(when, False, placed.position_m, placed.rotation_wxyz, [0.0] * 15, [0.0] * 5)

    def _end_silence(self, when: float) -> None:
        if self._silent and self.tally.samples:
            gap = when - self._good_s
            self.tally.gaps += 1
            self.tally.gap_s += gap
            self.tally.longest_gap_s = max(self.tally.longest_gap_s, gap)
        self._silent = False

    def _write_ready(self, all_of_them: bool = False) -> None:
        """Write the samples whose palm pose will not get better by waiting."""
        while self._pending:
            when, flexion, abduction = self._pending[0]
            if not all_of_them and when > self.pose.newest_s and self.time_s - when < self.pose.wait_s:
                return
            placed = self.pose.at(when)
            self._pending.popleft()
            self.tally.samples += 1
            self.tally.not_placed += not placed.known
            self._write(when, placed.known, placed.position_m, placed.rotation_wxyz, flexion, abduction)

    def _write(self, when: float, tracked: bool, *values: list[float]) -> None:
        self.recording.add_sample(when, tracked, *values)  # type: ignore[arg-type]
        self._sample_s = when

    def _hold_flood(self, count: int) -> None:
        """Of a device that sends far more than a glove can, take only so much: the rest waits, or its sender does."""
        passed, self._allowed_s = self.time_s - self._allowed_s, self.time_s
        self._allowed = min(self._allowed + passed * FLOOD_BYTES_PER_S, FLOOD_BURST) - count
        if self._allowed < 0:
            self._allowed = 0.0
            self.tally.flooded_s += FLOOD_PAUSE_S
            time.sleep(FLOOD_PAUSE_S)


def summarise_recording(recorder: Recorder, nominal_hz: float | None) -> dict[str, Any]:
    """What was recorded and what was lost, in plain values."""
    tally, arrivals, port = recorder.tally, recorder.arrivals, recorder.port
    found = arrivals.clock()
    clock: dict[str, float | None] = {
        # Where arrivals are too wild for a clock, lines over time is what can be said.
        "rate_hz": 1.0 / found.period_s if found else tally.decoded / max(recorder.time_s - tally.gap_s, 1e-9),
        "jitter_ms": found.jitter_s * 1e3 if found else None,
    }
    # A device whose rate is another one has no drift from it.
    if found and nominal_hz is not None and abs(found.period_s * nominal_hz - 1.0) < SAME_RATE:
        clock["drift_ppm"] = (1.0 / (found.period_s * nominal_hz) - 1.0) * 1e6
        clock["drift_error_ppm"] = found.error_s / found.period_s * 1e6
    rejected = {kind: count for kind, count in tally.rejected.items() if count}
    if recorder.overlong:
        rejected["overlong"] = recorder.overlong
    summary: dict[str, Any] = {
        "duration_s": recorder.time_s,
        "samples": tally.samples,
        "clock": clock,
        "lines": {
            "received": tally.received + recorder.overlong + tally.rejected["unplugged"],
            "decoded": tally.decoded,
            "rejected": sum(rejected.values()),
        },
        "rejected": rejected,
        "broken parts before good lines": recorder.decoder.glued,
        "gaps": {"count": tally.gaps, "seconds": tally.gap_s, "longest_s": tally.longest_gap_s},
        "port": {"opened": port.opened, "lost": port.lost, "answers not taken": port.refused},
        "bytes": tally.bytes,
        "dropped before the disk": recorder.recording.dropped,
        "palm": {"not known": tally.not_placed, **recorder.pose.counts},
    }
    if tally.calibrations:
        summary["calibrate button"] = tally.calibrations
    if tally.flooded_s:
        summary["flood held back s"] = tally.flooded_s
    if recorder.live is not None:
        summary["feedback"] = {
            "sent": tally.forces_sent,
            "released": tally.forces_released,
            **recorder.live.counts,
        }
    return summary
