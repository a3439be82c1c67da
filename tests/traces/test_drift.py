"""An emulated glove whose clock runs fast or slow, and what the recorder says of it: both in time that is made up.

`glove_figures.py` does the same over a port in real time, as long as one likes.
"""

import random
from types import SimpleNamespace

import glove_figures
import pytest

from palmar.traces import emulate
from palmar.traces.emulate import Emulator
from palmar.traces.line_faults import Faults, Log, parse_faults
from palmar.traces.opengloves import Decoder
from palmar.traces.pose_source import open_pose
from palmar.traces.record import Recorder, summarise_recording


class MadeTime:
    """A clock that goes on where somebody waits, and a little at each look."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        self.now_s += 1e-6
        return self.now_s

    def sleep(self, wait_s: float) -> None:
        self.now_s += wait_s


class Wire:
    """Keeps what was sent with the time at which it comes; the host's machine is busy for a while now and then."""

    name = "made"

    def __init__(self, made: MadeTime) -> None:
        self.made, self.sent = made, []
        self._random = random.Random(3)

    def heard(self) -> bool:
        return True

    def send(self, content: bytes) -> bool:
        self.sent.append((self.made.now_s, content))
        if self._random.random() < 0.002:
            self.made.sleep(self._random.uniform(0.0, 0.1))
        return True

    def receive(self, wait_s: float) -> bytes:
        self.made.sleep(max(wait_s, 0.0))
        return b""

    def unplug(self) -> None: ...

    def plug(self) -> None: ...


def sent_by(tmp_path, hand, monkeypatch, seconds, drift_ppm, faults):
    trace = glove_figures.moving_trace(tmp_path / "source.mcap")
    made = MadeTime()
    wire = Wire(made)
    monkeypatch.setattr(emulate, "time", made)
    emulator = Emulator(
        *(trace, hand, wire),
        **{"form": "curls", "full_scale": 4095, "rate_hz": 200.0, "lock_step": False, "auto_range": False},
        **{"jitter_s": 0.3e-3, "drift_ppm": drift_ppm, "count_lines": False, "loop": True, "seed": 1},
        faults=Faults(parse_faults(faults), 4095, 1),
        log=Log(None),
    )
    emulator.run(lambda: False, lambda _: None, seconds)
    monkeypatch.undo()
    return wire.sent


def recorded(hand, sent):
    """What the recorder says at the end of what came when."""
    nothing = SimpleNamespace(
        **dict.fromkeys(["add_sample", "add_reading", "add_device_bytes"], lambda *_: None), dropped=0
    )
    port = SimpleNamespace(is_open=True, write=lambda content: True, opened=["made"], lost=[], refused=0)
    pose = open_pose("constant", hand)
    recorder = Recorder(port, pose, nothing, hand, decoder=Decoder(), side="right", start_s=sent[0][0])
    for came_s, content in sent:
        recorder.time_s = came_s - sent[0][0]
        recorder._look_for_silence()
        recorder._take(content)
        recorder._write_ready()
    return summarise_recording(recorder, 200.0)


@pytest.mark.parametrize("drift_ppm", [200.0, -200.0])
@pytest.mark.parametrize("faults", [{}, {"all": "1"}])
def test_the_drift_of_a_glove_is_stated_whatever_happens_to_its_lines(tmp_path, hand, monkeypatch, drift_ppm, faults):
    summary = recorded(hand, sent_by(tmp_path, hand, monkeypatch, 60.0, drift_ppm, faults))
    clock = summary["clock"]
    # 12,000 lines that jitter by half a millisecond leave open 0.1 ppm, with faults, which do so in lumps, 0.5.
    assert clock["drift_ppm"] == pytest.approx(drift_ppm, abs=2.0)
    assert clock["drift_error_ppm"] < 1.0
    assert clock["rate_hz"] == pytest.approx(200.0 * (1 + drift_ppm * 1e-6), abs=4e-4)
    assert summary["lines"]["decoded"] > (11_200 if faults else 11_990)
    assert bool(summary["lines"]["rejected"]) == bool(faults)
