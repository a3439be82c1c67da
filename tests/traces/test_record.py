"""The recorder on a pseudo-terminal whose other end the test holds: what a port can do, it does."""

import os
import threading
import time

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from palmar._runtime import DeviceRecording, read_device_bytes
from palmar.coupling import complete_flexion
from palmar.errors import PalmarError
from palmar.profile import FingerMeasures, Profile
from palmar.recording import record
from palmar.records import read_trace
from palmar.traces.actuator import Actuator
from palmar.traces.glove_angles import AngleMap, read_opengloves
from palmar.traces.live_hand import LiveHand
from palmar.traces.opengloves import NO_FORCE, Decoder, Reading, decode_force
from palmar.traces.port import Port, candidates
from palmar.traces.pose_source import open_pose
from palmar.traces.readings import angles_of
from palmar.traces.record import Recorder, summarise_recording
from palmar.traces.wire import Pty, Server

HEADER = {"device": "opengloves", "hand": "reference", "side": "right", "full_scale": "4095"}
PATIENCE_S = 20.0  # for a busy machine; nothing here depends on it


def line(count: int) -> bytes:
    return f"A{count}B{count}C{count}D{count}E{count}F2048G2048P0\n".encode()


class Bench:
    """A recorder on a thread, and the glove's end of its port."""

    def __init__(self, folder, hand, wire, names, live=None, out="out.mcap"):
        self.out, self.wire = folder / out, wire
        self.recording = DeviceRecording(str(self.out), HEADER)
        self.port = Port(names)
        assert self.port.connect()
        self.recorder = Recorder(
            self.port,
            open_pose("constant", hand),
            self.recording,
            hand,
            decoder=Decoder(),
            side="right",
            live=live,
            start_s=time.monotonic(),
        )
        self._over = False
        self._thread = threading.Thread(target=self.recorder.run, args=(lambda: self._over, lambda _: None, None))
        self._thread.start()

    def until(self, reached):
        end = time.monotonic() + PATIENCE_S
        while not reached():
            assert time.monotonic() < end and self._thread.is_alive(), vars(self.recorder.tally)
            time.sleep(0.005)

    def decode(self, content, count):
        """Send bytes, and wait until that many lines have been decoded in all."""
        assert self.wire.send(content)
        self.until(lambda: self.recorder.tally.decoded == count)

    def finish(self):
        self._over = True
        self._thread.join()
        self.port.close()
        return summarise_recording(self.recorder, None)

    def close(self):
        summary = self.finish()
        self.recording.close({"rate_hz": "200"})
        return summary


@pytest.fixture
def wire(tmp_path):
    wire = Pty(tmp_path / "glove")
    yield wire
    wire.close()


@pytest.fixture
def bench(tmp_path, hand, wire):
    bench = Bench(tmp_path, hand, wire, [str(tmp_path / "glove*")])
    yield bench
    bench.finish()


def test_lines_become_raw_bytes_readings_and_samples(bench, hand):
    for k in range(1, 21):
        bench.decode(line(100 * k), k)
    summary = bench.close()
    trace = read_trace(bench.out)
    assert trace.tracked[:20].all() and not any(trace.lost.values())
    assert (np.diff(trace.time_s) > 0).all() and trace.header["rate_hz"] == "200"
    closed = np.arange(1, 21) * 100 / 4095
    mcp = closed[:, None] * hand.flexion_limit_rad[:, 0, 1]
    # Products of the same numbers in the same order.
    np.testing.assert_array_equal(trace.flexion_rad[:20, :, 0], mcp)
    pip = np.minimum(mcp * hand.flexion_coupling[:, 0], hand.flexion_limit_rad[:, 1, 1])
    np.testing.assert_array_equal(trace.flexion_rad[:20, :, 1], pip)
    assert summary["lines"] == {"received": 20, "decoded": 20, "rejected": 0}
    _, chunks = read_device_bytes(str(bench.out))
    assert b"".join(content for _, content in chunks) == b"".join(line(100 * k) for k in range(1, 21))
    with bench.out.open("rb") as stream:
        messages = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    said = [m for _, channel, _, m in messages if channel.topic == "/device_reading"]
    assert [m.flexion[3] for m in said] == closed.tolist() and np.isnan(said[0].flexion[4])
    again = read_opengloves(bench.out)
    np.testing.assert_array_equal(again.time_s, trace.time_s[:20])
    np.testing.assert_allclose(again.flexion_rad[:, 2, 0], closed * np.pi / 2)


def test_each_line_is_answered_with_a_bare_line_end(bench):
    bench.decode(line(1), 1)
    assert bench.wire.receive(PATIENCE_S) == b"\n"
    bench.wire.send(b"garbage\n")
    assert bench.wire.receive(PATIENCE_S) == b"\n"


def test_unplug_and_replug_under_another_name(bench, tmp_path):
    bench.decode(line(1), 1)
    bench.wire.send(b"A2B2")
    time.sleep(0.05)
    bench.wire.unplug()
    bench.until(lambda: not bench.port.is_open)
    bench.wire.plug()
    bench.until(lambda: bench.port.is_open)
    bench.decode(line(3), 2)
    summary = bench.close()
    assert summary["port"]["opened"] == [str(tmp_path / "glove"), str(tmp_path / "glove-1")]
    assert len(summary["port"]["lost"]) == 1 and summary["gaps"]["count"] == 1
    assert summary["rejected"] == {"unplugged": 1}
    trace = read_trace(bench.out)
    # The gap begins with a sample that says so, as a replay wants it.
    assert trace.tracked[:3].tolist() == [True, False, True]


def test_silence_is_marked_and_ends_with_the_next_good_line(bench):
    bench.decode(line(1), 1)
    bench.until(lambda: bench.recorder._silent)
    bench.wire.send(b"noise\n" * 3)
    bench.decode(line(2), 2)
    summary = bench.close()
    assert summary["gaps"]["count"] == 1 and summary["rejected"] == {"garbage": 3}
    trace = read_trace(bench.out)
    assert trace.tracked[:3].tolist() == [True, False, True]
    assert trace.time_s[1] == pytest.approx(trace.time_s[0] + 0.1)


def test_lines_of_the_other_hand_are_no_samples(bench):
    bench.decode(line(1), 1)
    bench.wire.send(b"Z(ZV)5(ZG)1(ZH)0\n" + line(2) + line(3))
    bench.decode(b"Z(ZH)1\n" + line(4), 2)
    summary = bench.close()
    assert summary["rejected"] == {"other hand": 2}


def test_a_burst_of_lines_is_kept_whole_with_times_that_rise(bench):
    bench.decode(b"".join(line(k) for k in range(60)), 60)
    bench.close()
    trace = read_trace(bench.out)
    assert (trace.tracked.sum() == 60) and (np.diff(trace.time_s) > 0).all()


def test_a_flood_is_held_back_and_what_follows_is_read(bench):
    noise = os.urandom(600_000).replace(b"A", b"a")
    for at in range(0, len(noise), 4000):
        assert bench.wire.send(noise[at : at + 4000])
    bench.decode(b"\n" + line(7), 1)
    summary = bench.close()
    assert summary["flood held back s"] > 0 and summary["bytes"] == len(noise) + 1 + len(line(7))


def test_a_full_disk_ends_the_recording_and_is_told(tmp_path, hand, wire):
    bench = Bench(tmp_path, hand, wire, [str(tmp_path / "glove")])
    bench.decode(line(1), 1)
    bench.finish()
    full = Bench(tmp_path, hand, wire, [str(tmp_path / "glove")], out="/dev/full")
    end = time.monotonic() + PATIENCE_S
    while full._thread.is_alive() and time.monotonic() < end:  # the writer fails by itself; it is told at the next line
        full.wire.send(line(2))
        full._thread.join(0.1)
    assert full.recorder.failed is not None and full.recorder.failed.code == "E-TRACE-WRITE"
    full.finish()


def test_killed_recorder_leaves_a_trace(bench):
    bench.decode(line(1), 1)
    bench.until(lambda: _samples(bench.out))
    trace = read_trace(bench.out)  # nothing has ended it
    assert trace.lost["unclosed"] and len(trace.time_s) >= 1


def _samples(path):
    try:
        return len(read_trace(path).time_s)
    except PalmarError:
        return 0


def test_force_is_let_go_in_silence(tmp_path, hand, wire, ball_pack):
    live = LiveHand(ball_pack, "", {}, Actuator(cap_n=5.0))
    bench = Bench(tmp_path, hand, wire, [str(tmp_path / "glove")], live=live)
    count = 0
    while not any(live.levels):  # the fist closes until it meets the ball
        count += 1
        assert count < 200
        bench.decode(line(min(60 * count, 4095)), count)
    heard = b""
    bench.until(lambda: bench.recorder.tally.forces_released)
    while not heard.endswith(NO_FORCE):
        heard += bench.wire.receive(PATIENCE_S)
    commands = [decode_force(command) for command in heard.splitlines()]
    assert len(commands) == count + 1 and any(commands[-2]) and not any(commands[-1])
    assert bench.close()["feedback"]["in contact"] == 1


def test_a_glove_on_a_socket(tmp_path, hand):
    server = Server("127.0.0.1:0")
    bench = Bench(tmp_path, hand, server, [server.name])
    bench.until(server.heard)
    bench.decode(line(5), 1)
    assert server.receive(PATIENCE_S) == b"\n"
    server.unplug()
    bench.until(lambda: not bench.port.is_open)
    server.plug()
    bench.until(lambda: server.heard())
    bench.decode(line(6), 2)
    assert len(bench.close()["port"]["opened"]) == 2
    server.close()


@pytest.mark.parametrize("with_profile", [False, True])
def test_angles_of_a_reading_are_those_of_the_coupling_and_the_profile(hand, with_profile):
    generator = np.random.default_rng(5)
    ends = np.stack([generator.uniform(0, 0.5, (5, 3)), generator.uniform(0.8, 1.5, (5, 3))], axis=-1)
    ends[2, 1] = 0.3  # a joint that the profile says is not read
    fingers = tuple(FingerMeasures(reading_rad=end) for end in ends)
    profile = Profile("x", "right", "made", fingers=fingers, device="opengloves") if with_profile else None
    angle_map = AngleMap(hand, profile)
    for _ in range(50):
        share = generator.uniform(0, 1, (5, 3))
        share[generator.random((5, 3)) < 0.4] = np.nan
        share[:, 0] = np.where(np.isnan(share).all(axis=1) | (np.arange(5) == 2), 0.5, share[:, 0])
        flexion, abduction = angle_map.angles(Reading(share.ravel().tolist(), [-1, 1, 0, 0.5, np.nan], (0, 0), 0, 0))
        if profile is None:
            expected = complete_flexion(hand, share[None] * hand.flexion_limit_rad[..., 1])
        else:
            expected = angles_of(share[None] * np.pi / 2, hand, profile)
        # The same sums in another order.
        np.testing.assert_allclose(np.reshape(flexion, (5, 3)), expected[0], atol=1e-12)
        np.testing.assert_allclose(abduction, [-0.4, 0.4, 0, 0.2, 0])


def test_names_of_ports_are_patterns_paths_and_sockets(tmp_path):
    for name in ("b", "a"):
        (tmp_path / name).touch()
    assert candidates([str(tmp_path / "*"), str(tmp_path / "a"), "socket://x:1"]) == [
        str(tmp_path / "a"),
        str(tmp_path / "b"),
        "socket://x:1",
    ]
    assert candidates([str(tmp_path / "none"), "usb:NO-SUCH-NUMBER"]) == []


def test_a_port_that_says_nothing_is_told_and_leaves_no_file(tmp_path, wire):
    out = tmp_path / "x.mcap"
    with pytest.raises(PalmarError, match=r"E-GLOVE-SILENT .*glove: nothing came: is the glove on"):
        record("opengloves", [wire.name], out, duration_s=0.1)
    assert not out.exists()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ({"device": "opengloved"}, "E-CONF --device: 'opengloved'; known are opengloves"),
        ({"ports": ["/dev/none"]}, "E-GLOVE-PORT --port: /dev/none: no such port"),
        ({"feedback": True}, "E-USAGE .*--solve PACK is missing"),
        ({"actuator": {"cap_n": 3}}, "E-USAGE --actuator: .*--feedback is missing"),
        ({"side": "left"}, "E-CONF --side: 'left'; hand median adult is a right one"),
        ({"pose": "constant:1"}, "E-CONF --pose"),
    ],
)
def test_wrong_flags_are_refused_and_leave_no_file(tmp_path, wire, flags, said):
    out = tmp_path / "x.mcap"
    given = {"device": "opengloves", "ports": [wire.name], **flags}
    with pytest.raises(PalmarError, match=said):
        record(given.pop("device"), given.pop("ports"), out, duration_s=0.1, **given)
    assert not out.exists()


def test_a_recording_is_never_written_over(tmp_path, wire):
    out = tmp_path / "x.mcap"
    out.write_text("kept")
    with pytest.raises(PalmarError, match=r"E-FILE-PLACE .* is there already"):
        record("opengloves", [wire.name], out)
    assert out.read_text() == "kept"
