"""Where the palm is: streams joined to our clock, traces and scenes played, constants, keys."""

import math
import os
import pty
import socket

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import GloveError, PalmarError
from palmar.records import write_trace
from palmar.traces.pose_source import open_pose
from palmar.traces.pose_stream import PoseStream, unit_pose

TURN = Rotation.from_rotvec([0.3, -0.2, 0.5])


@pytest.fixture
def address():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        number = end.getsockname()[1]
    return "127.0.0.1", number


def stream_at(address, offset_s=0.0, mount=""):
    return PoseStream(f"udp://{address[0]}:{address[1]}", offset_s=offset_s, mount=unit_pose("", mount), baud=115200)


def send(address, text):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.sendto(text.encode(), address)


def quaternion(rotation):
    return np.roll(rotation.as_quat(), 1)


def line(time_s, position, rotation=TURN, separator=" "):
    numbers = [] if time_s is None else [time_s]
    return separator.join(f"{x:.17g}" for x in [*numbers, *position, *quaternion(rotation)])


def test_pose_lies_between_its_neighbours_and_is_lost_when_the_stream_ends(address):
    stream = stream_at(address)
    for time_s, x in ((1.0, 0.1), (1.02, 0.2)):
        send(address, line(None, (x, 0, 0), separator=", "))
        assert stream.receive(time_s)
    halfway, at_end, after = stream.at(1.01), stream.at(1.05), stream.at(1.2)
    assert halfway.position_m == pytest.approx([0.15, 0, 0]) and halfway.known
    assert at_end.position_m == pytest.approx([0.2, 0, 0]) and at_end.known
    assert after.position_m == pytest.approx([0.2, 0, 0]) and not after.known
    assert not stream.at(0.9).known
    assert halfway.rotation_wxyz == pytest.approx(quaternion(TURN).tolist())
    stream.close()


def test_stated_offset_puts_poses_earlier(address):
    stream = stream_at(address, offset_s=0.03)
    send(address, line(None, (0.1, 0, 0)))
    stream.receive(1.03)
    send(address, line(None, (0.2, 0, 0)))
    stream.receive(1.05)
    assert stream.newest_s == pytest.approx(1.02)
    assert stream.at(1.005).position_m == pytest.approx([0.125, 0, 0])
    stream.close()


def test_a_senders_clock_is_joined_by_its_quickest_pose(address):
    stream = stream_at(address)
    # Sent every 10 ms by a clock 500 s ahead, at 0.1 m/s; they arrive 2 ms late, but for two that took 9.
    for k in range(20):
        send(address, line(500.0 + 0.01 * k, (0.001 * k, 0, 0)))
        stream.receive(0.01 * k + (0.009 if k in (5, 11) else 0.002))
    # The least delay, 2 ms, is what the stream cannot tell from the clocks' difference; it may forget 1e-4 s a second.
    assert stream.at(0.102).position_m[0] == pytest.approx(0.010, abs=0.1 * 1e-4)
    assert stream.at(0.112).position_m[0] == pytest.approx(0.011, abs=0.1 * 1e-4)
    stream.close()


def test_palm_is_placed_by_the_mount_of_the_tracker(address):
    mount = Rotation.from_rotvec([0.0, 1.0, 0.2])
    text = ",".join(f"{x:.17g}" for x in [0.01, -0.02, 0.03, *quaternion(mount)])
    stream = stream_at(address, mount=text)
    send(address, line(None, (0.1, 0.2, 0.3)))
    stream.receive(1.0)
    placed = stream.at(1.0)
    # Exact but for rounding of some products; q and -q are one rotation.
    np.testing.assert_allclose(
        placed.position_m, TURN.apply([0.01, -0.02, 0.03]) + np.array([0.1, 0.2, 0.3]), atol=1e-12
    )
    assert abs(np.dot(placed.rotation_wxyz, quaternion(TURN * mount))) == pytest.approx(1.0, abs=1e-12)
    stream.close()


def test_lines_that_are_no_pose_are_counted(address):
    stream = stream_at(address)
    bad = ["hello", "1 2 3", "0 0 0 2 0 0 0", "0 0 nan 1 0 0 0", "1e9 0 0 1 0 0 0", "1 2 3 4 5 6 7 8 9"]
    send(address, "\n".join([*bad, line(5.0, (0, 0, 0)), line(4.0, (0, 0, 0)), "x" * 2000]))
    stream.receive(1.0)
    counts = stream.counts
    assert counts["rejected"] == len(bad) and counts["received"] == 1
    assert counts["out of order"] == 1 and counts["overlong"] == 1
    stream.close()


def test_constant_pose_scene_and_trace(hand, tmp_path, moving):
    assert open_pose("constant", hand).at(3.0).position_m == [0.0, 0.0, 0.0]
    turned = open_pose("constant:0.1,0.2,0.3,0,1,0,0", hand).at(0.0)
    assert turned.position_m == [0.1, 0.2, 0.3] and turned.rotation_wxyz == [0.0, 1.0, 0.0, 0.0]
    scene = open_pose(str(_scene("poke")), hand)
    assert scene.at(10.0).known and scene.at(10.1).known
    write_trace(tmp_path / "x.mcap", moving)
    played = open_pose(str(tmp_path / "x.mcap"), hand)
    for k in (0, 1, 7):
        # The recording may begin at any time; the trace begins with its first sample.
        assert played.at(100.0 + moving.time_s[k]).position_m == pytest.approx(moving.palm_position_m[k].tolist())
    assert played.at(1e4).position_m == moving.palm_position_m[-1].tolist()


def _scene(name):
    from palmar.traces.scripted import SCENES

    return SCENES / f"{name}.toml"


@pytest.mark.parametrize(
    ("text", "flags", "said"),
    [
        ("constant:1,2", {}, r"E-CONF --pose: '1,2'; X,Y,Z or X,Y,Z,W,QX,QY,QZ is needed"),
        ("constant:0,0,0,2,0,0,0", {}, "E-CONF --pose"),
        ("constant", {"offset_s": 0.1}, "E-USAGE --pose-offset-ms: is for a stream"),
        ("grasp.toml", {}, "E-CONF"),
        ("konstant", {}, r"E-CONF --pose: 'konstant' \(nearest: constant\); constant, keyboard, a .toml"),
        ("udp://127.0.0.1", {}, "udp://HOST:PORT is needed"),
        ("/dev/no-such-port", {}, "E-GLOVE-PORT --pose"),
    ],
)
def test_a_wrong_pose_is_refused(hand, text, flags, said):
    with pytest.raises((PalmarError, GloveError), match=said):
        open_pose(text, hand, **flags)


def test_a_grasp_is_refused_with_what_to_do(hand):
    with pytest.raises(PalmarError, match=r"palmar script .* --pose X.mcap"):
        open_pose(str(_scene("grasp")), hand)


def test_keys_move_the_palm_no_faster_than_a_hand(hand, monkeypatch):
    host, device = pty.openpty()
    monkeypatch.setattr("sys.stdin", os.fdopen(device, "r"))
    keys = open_pose("keyboard", hand)
    keys.at(0.0)
    os.write(host, b"dddd")
    assert keys.receive(0.0) == b"dddd"
    assert keys.at(0.05).position_m == pytest.approx([0.01, 0, 0])
    assert keys.at(1.0).position_m == pytest.approx([0.02, 0, 0])
    os.write(host, b" l")
    keys.receive(1.0)
    turned = keys.at(2.0)
    assert turned.position_m == pytest.approx([0, 0, 0])
    assert turned.rotation_wxyz[3] == pytest.approx(math.sin(0.05 / 2))
    keys.close()
    os.close(host)
