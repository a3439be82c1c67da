"""The emulated glove in time that is made up: how it keeps its pace, and what the recorder says of its clock.

`glove_figures.py` does the same over a port in real time, as long as one likes.
"""

import itertools
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

    def __init__(self, made: MadeTime, answers: bool = False) -> None:
        self.made, self.sent, self.answers = made, [], answers
        self._random = random.Random(3)
        self._unanswered = 0

    def heard(self) -> bool:
        return True

    def send(self, content: bytes) -> bool:
        self.sent.append((self.made.now_s, content))
        self._unanswered += 1
        if self._random.random() < 0.002:
            self.made.sleep(self._random.uniform(0.0, 0.1))
        return True

    def receive(self, wait_s: float) -> bytes:
        if self.answers and self._unanswered:
            self._unanswered = 0
            self.made.sleep(0.001 + self._random.expovariate(1 / 0.001))
            return b"\n"
        self.made.sleep(max(wait_s, 0.0))
        return b""

    def unplug(self) -> None: ...

    def plug(self) -> None: ...


def sent_by(tmp_path, hand, monkeypatch, seconds, drift_ppm=0.0, faults=None, lock_step=False):
    """What such a glove sends to a host, of which only one that it waits for answers."""
    trace = glove_figures.moving_trace(tmp_path / "source.mcap")
    made = MadeTime()
    wire = Wire(made, answers=lock_step)
    monkeypatch.setattr(emulate, "time", made)
    emulator = Emulator(
        *(trace, hand, wire),
        **{"form": "curls", "full_scale": 4095, "rate_hz": 200.0, "lock_step": lock_step, "auto_range": False},
        **{"jitter_s": 0.3e-3, "drift_ppm": drift_ppm, "count_lines": False, "loop": True, "seed": 1},
        faults=Faults(parse_faults(faults or {}), 4095, 1),
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


@pytest.mark.parametrize("lock_step", [False, True])
def test_lines_that_a_busy_machine_makes_late_are_made_up_for(tmp_path, hand, monkeypatch, lock_step):
    sent = sent_by(tmp_path, hand, monkeypatch, 30.0, lock_step=lock_step)
    times = [came_s for came_s, _ in sent]
    # Two lines in a thousand are held up for up to 0.1 s, answers come after 2 ms on average: none is left out.
    assert len(sent) == pytest.approx(30.0 * 200.0, abs=25)
    apart = [after - before for before, after in itertools.pairwise(times)]
    assert max(apart) > 0.05
    if lock_step:  # after a late answer no faster than the wire carries them
        assert min(apart) >= min(len(content) for _, content in sent) * 10 / 115200 - 1e-9


def test_a_silence_is_not_made_up_for(tmp_path, hand, monkeypatch):
    sent = sent_by(tmp_path, hand, monkeypatch, 30.0, faults={"silence": "0.002:0.5"})
    times = [came_s for came_s, _ in sent]
    silent_s = sum(after - before for before, after in itertools.pairwise(times) if after - before > 0.4)
    assert silent_s > 3.0
    assert len(sent) == pytest.approx((30.0 - silent_s) * 200.0, abs=50)
