"""`palmar recover`: whatever happened to a trace, a sound part of what went in comes out, and the loss is said.

A trace of three samples, each in its own chunk, is cut at every byte and damaged at every bit. The reader itself is
held to every flip, insertion and missing byte of traces and runs by test_damage.cpp; `--all-recordings` flips every bit
here too, where one in seven is enough by default.
"""

import numpy as np
import pytest
from mcap.reader import make_reader

from palmar import _runtime, cli
from palmar.errors import BadTrace, PalmarError
from palmar.records import Trace, read_trace, write_trace
from palmar.recover import recover_file

COLUMNS = [name for name in Trace.__dataclass_fields__ if name not in ("header", "lost")]


def make_trace(count=3, interval_s=0.3):  # 0.3 s apart: each sample is in a chunk of its own
    random = np.random.default_rng(3)
    rotation = random.normal(size=(count, 4))
    return Trace(
        header={"schema": "palmar.trace/1", "device": "glove", "hand": "default", "side": "left"},
        time_s=1.0 + interval_s * np.arange(count),
        palm_position_m=random.normal(size=(count, 3)),
        palm_rotation_wxyz=rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        flexion_rad=random.normal(size=(count, 5, 3)),
        abduction_rad=random.normal(size=(count, 5)),
        tracked=np.ones(count, bool),
        has_object_pose=np.zeros(count, bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )


@pytest.fixture
def sound(tmp_path):
    write_trace(tmp_path / "sound.mcap", make_trace())
    return tmp_path / "sound.mcap"


def recovered(content, folder, header_of=None):
    """What recover makes of a file's bytes: the trace, and what was said to be lost; None where it refused."""
    damaged, out = folder / "damaged.mcap", folder / "out.mcap"
    damaged.unlink(missing_ok=True)
    damaged.write_bytes(content)
    out.unlink(missing_ok=True)
    try:
        lost = recover_file(damaged, out, header_of)["lost"]
    except BadTrace as error:
        assert error.code.startswith("E-TRACE-") and "\n" not in str(error)
        assert not out.exists()
        return None, None
    return read_trace(out), lost


def assert_part(trace, whole):
    """The samples of a trace are rows of the whole one, bit for bit and in order."""
    assert not any(trace.lost.values())
    assert trace.header == whole.header
    rows = np.searchsorted(whole.time_s, trace.time_s)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(trace, name), getattr(whole, name)[rows])


def test_a_sound_trace_comes_out_the_same_and_nothing_is_lost(sound, tmp_path):
    trace, lost = recovered(sound.read_bytes(), tmp_path)
    assert_part(trace, make_trace())
    assert len(trace.time_s) == 3 and not any(lost.values())
    assert (tmp_path / "out.mcap").read_bytes() == sound.read_bytes()


def test_cut_at_every_byte_all_whole_chunks_are_kept(sound, tmp_path):
    content, kept = sound.read_bytes(), []
    for size in range(len(content)):
        trace, lost = recovered(content[:size], tmp_path)
        if trace is not None:
            assert_part(trace, make_trace())
            assert lost["unclosed"] == 1
        kept.append(0 if trace is None else len(trace.time_s))
    assert kept == sorted(kept) and set(kept) == {0, 1, 2, 3}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["damaged.mcap", "out.mcap", "sound.mcap"]


def test_with_every_bit_flipped_no_sample_is_wrong_and_every_loss_is_said(sound, tmp_path, request):
    content = sound.read_bytes()
    step = 1 if request.config.getoption("--all-recordings") else 7
    refused = 0
    for bit in range(0, 8 * len(content), step):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        trace, lost = recovered(bytes(flipped), tmp_path)
        refused += trace is None
        if trace is not None:
            assert_part(trace, make_trace())
            assert any(lost.values()), bit
            assert len(trace.time_s) + lost["messages"] >= 3, bit
            assert len(trace.time_s) >= 2, bit  # one chunk at most
    assert refused * step < 0.1 * 8 * len(content)  # the header is a fiftieth of the file


def test_a_header_that_is_lost_is_taken_from_another_trace(sound, tmp_path):
    content = bytearray(sound.read_bytes())
    content[content.index(b"glove")] ^= 1
    assert recovered(bytes(content), tmp_path) == (None, None)
    with pytest.raises(BadTrace, match="--header-of"):
        recover_file(tmp_path / "damaged.mcap", tmp_path / "x.mcap")
    other = tmp_path / "other.mcap"
    write_trace(other, make_trace(7))
    trace, lost = recovered(bytes(content), tmp_path, other)
    assert_part(trace, make_trace())
    assert len(trace.time_s) == 3 and lost["bytes"] > 0


def test_samples_that_are_no_pose_are_left_out_and_counted(sound, tmp_path):
    """Another program may write what the format does not allow, with a CRC that fits: a file without CRCs here."""
    from mcap.reader import NonSeekingReader
    from mcap.writer import Writer

    with sound.open("rb") as stream:
        messages = list(NonSeekingReader(stream).iter_messages())
    with (tmp_path / "open.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False, enable_crcs=False, enable_data_crcs=False)
        writer.start("ros2")
        writer.add_metadata("palmar.trace", make_trace().header)
        given, channel = messages[0][0], messages[0][1]
        schema = writer.register_schema(given.name, given.encoding, given.data)
        number = writer.register_channel(channel.topic, channel.message_encoding, schema)
        for row, (_, _, message) in enumerate(messages):
            data = message.data
            if row == 1:
                data = data.replace(make_trace().flexion_rad[1].tobytes()[:8], np.float64(np.nan).tobytes())
            writer.add_message(number, message.log_time, data, message.publish_time)
        writer.finish()
    with pytest.raises(BadTrace, match="E-TRACE-VALUE"):
        read_trace(tmp_path / "open.mcap")
    answer = recover_file(tmp_path / "open.mcap", tmp_path / "out.mcap")
    assert answer["lost"]["messages"] == 1 and answer["samples"] == 2
    assert_part(read_trace(tmp_path / "out.mcap"), make_trace())


CHANNELS = ("device_readings", "device_bytes", "pose_bytes", "samples")


def record_all(path, count=5):
    """A recording with all that `palmar record` keeps, 0.3 s apart: what came at one time is in a chunk of its own."""
    recording = _runtime.DeviceRecording(str(path), make_trace().header)
    whole = make_trace(count)
    for row, time_s in enumerate(whole.time_s.tolist()):
        recording.add_device_bytes(time_s, b"A1B2C3D4E5\n" * row + b"\0\xff\n")
        recording.add_pose_bytes(time_s, f"{row} 0 0 1 0 0 0\n".encode())
        # What a glove does not send is not a number, and stays that.
        recording.add_reading(time_s, [row / 7, np.nan] * 7 + [0.5], [np.nan] * 5, [0.1, -0.1], 0.25, row)
        values = (whole.palm_position_m, whole.palm_rotation_wxyz, whole.flexion_rad.reshape(-1, 15))
        recording.add_sample(time_s, True, *(value[row] for value in values), whole.abduction_rad[row])
    recording.close({"rate_hz": "3.3", "recorded": "{}"})
    return path


def messages_of(path):
    with path.open("rb") as stream:
        return [(channel.topic, m.log_time, m.data) for _, channel, m in make_reader(stream).iter_messages()]


def test_all_channels_of_a_recording_are_kept_wherever_it_was_cut(tmp_path):
    content = record_all(tmp_path / "whole.mcap").read_bytes()
    whole = messages_of(tmp_path / "whole.mcap")
    header = read_trace(tmp_path / "whole.mcap").header
    assert header["recorded"] == "{}" and len(whole) == 20
    kept = []
    for size in [*range(0, len(content), 41), len(content)]:
        (tmp_path / "cut.mcap").write_bytes(content[:size])
        out = tmp_path / f"out_{size}.mcap"
        try:
            answer = recover_file(tmp_path / "cut.mcap", out)
        except BadTrace:
            kept.append(0)
            continue
        # Of each time all or nothing, in every channel, with the numbers and bytes that there were.
        assert len({answer[name] for name in CHANNELS}) == 1
        kept.append(answer["samples"])
        assert sorted(messages_of(out)) == sorted(whole[: 4 * kept[-1]])
        out.unlink()
    assert kept == sorted(kept) and set(kept) == {0, 1, 2, 3, 4, 5}


def test_a_damaged_chunk_costs_what_came_in_its_time_in_every_channel(tmp_path):
    content = bytearray(record_all(tmp_path / "whole.mcap").read_bytes())
    content[content.index(b"3 0 0 1 0 0 0")] ^= 1
    (tmp_path / "flipped.mcap").write_bytes(content)
    answer = recover_file(tmp_path / "flipped.mcap", tmp_path / "out.mcap")
    whole = messages_of(tmp_path / "whole.mcap")
    assert sorted(messages_of(tmp_path / "out.mcap")) == sorted(whole[:12] + whole[16:])
    assert [answer[name] for name in CHANNELS] == [4] * 4 and answer["lost"]["chunks"] == 1
    assert read_trace(tmp_path / "out.mcap").header == read_trace(tmp_path / "whole.mcap").header
    _, chunks = _runtime.read_device_bytes(str(tmp_path / "out.mcap"))
    assert [content for _, content in chunks] == [b"A1B2C3D4E5\n" * row + b"\0\xff\n" for row in (0, 1, 2, 4)]


def test_the_damaged_file_is_never_written_over(sound):
    with pytest.raises(PalmarError, match="E-FILE-PLACE"):
        recover_file(sound, sound)


def test_the_verb_ends_with_3_where_something_was_lost_and_with_0_where_nothing_was(sound, tmp_path, capsys):
    assert cli.run(["recover", str(sound), "-o", str(tmp_path / "a.mcap")]) == 0
    assert capsys.readouterr().err == ""
    (tmp_path / "cut.mcap").write_bytes(sound.read_bytes()[:-700])
    assert cli.run(["recover", str(tmp_path / "cut.mcap"), "-o", str(tmp_path / "b.mcap")]) == 3
    captured = capsys.readouterr()
    assert captured.err.startswith("E-TRACE-LOSS") and captured.err.count("\n") == 1
    assert not any(read_trace(tmp_path / "b.mcap").lost.values())
    (tmp_path / "noise.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    assert cli.run(["recover", str(tmp_path / "noise.mcap"), "-o", str(tmp_path / "c.mcap")]) == 2
    assert not (tmp_path / "c.mcap").exists()
