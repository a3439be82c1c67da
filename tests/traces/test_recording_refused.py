"""What `record` and `emulate` refuse before and after they listened: each with its code, and no file is left."""

import re
import threading

import pytest
from made_trace import make_trace

from palmar.errors import BadPack, GloveError, PalmarError
from palmar.recording import emulate, record
from palmar.records import write_trace
from palmar.traces.glove_angles import DEVICE
from palmar.traces.wire import Pty


@pytest.fixture
def glove():
    wire = Pty()
    yield wire
    wire.close()


def refused(kind, said, out, *arguments, **options):
    with pytest.raises(kind, match=re.escape(said)):
        record(*arguments, out, **options)
    assert not out.exists()


def test_flags_that_do_not_go_together(tmp_path, glove, ball_pack):
    out = tmp_path / "out.mcap"
    ports = [glove.name]
    refused(PalmarError, "E-CONF --device: 'glove'; known are opengloves", out, "glove", ports)
    refused(PalmarError, "E-USAGE --feedback, --set, --object: are of a solver", out, DEVICE, ports, feedback=True)
    refused(PalmarError, "E-USAGE --feedback, --set, --object: are of a solver", out, DEVICE, ports, object_name="x")
    refused(PalmarError, "E-USAGE --actuator: is for what is sent back", out, DEVICE, ports, actuator={"cap_n": 1})
    both = {"solve": ball_pack, "feedback": True, "passive": True}
    refused(PalmarError, "E-USAGE --passive: sends nothing, and --feedback sends forces", out, DEVICE, ports, **both)
    refused(PalmarError, "E-CONF --side: 'left'; hand", out, DEVICE, ports, side="left")
    other = {"solve": ball_pack, "hand_name": "default:male-95"}
    refused(BadPack, f"E-PACK-HAND {ball_pack}: built for hand", out, DEVICE, ports, **other)
    out.write_bytes(b"precious")
    with pytest.raises(PalmarError, match=r"E-FILE-PLACE .*: is there already"):
        record(DEVICE, ports, out)
    assert out.read_bytes() == b"precious"


def test_a_silent_glove_and_one_that_talks_nonsense_leave_no_file(tmp_path, glove):
    out = tmp_path / "out.mcap"
    refused(GloveError, f"E-GLOVE-SILENT {glove.name}: nothing came", out, DEVICE, [glove.name], duration_s=0.2)

    stop = threading.Event()

    def babble():
        while not stop.wait(0.01):
            glove.send(b"Zwhat?\n")

    talking = threading.Thread(target=babble)
    talking.start()
    said = "no line of them reads"
    refused(GloveError, said, out, DEVICE, [glove.name], duration_s=0.5, full_scale=1023)
    stop.set()
    talking.join()


def test_an_emulator_that_cannot_be_told_where_to_speak(tmp_path):
    trace = tmp_path / "in.mcap"
    write_trace(trace, make_trace(20))
    with pytest.raises(PalmarError, match="E-USAGE --listen: is a socket, and --link names a terminal"):
        emulate(trace, link=tmp_path / "glove", listen="localhost:0")
    for where in ("host:1", "udp://host", "udp://host:x", "udp://host:0", "udp://host:65536"):
        with pytest.raises(PalmarError, match=re.escape(f"E-CONF --poses-to: {where!r}; udp://HOST:PORT is needed")):
            emulate(trace, poses_to=where)
