"""Traces against the official MCAP packages, and resampling against scipy."""

import io
import struct
import subprocess
import sys

import numpy as np
import pytest
from documented import schema_texts
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from palmar import _runtime
from palmar.errors import BadTrace, PalmarError

HEADER = {"schema": "palmar.trace/1", "device": "glove ü", "hand": "default", "side": "right", "rate_hz": "90"}
SAMPLE = "palmar_msgs/msg/Sample"
SOUND = {"bytes": 0, "chunks": 0, "messages": 0, "unclosed": 0}


def make_columns(count: int, interval_s: float, seed: int = 0) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    columns = {
        "time_s": 0.25 + interval_s * np.arange(count),
        "palm_position_m": random.normal(size=(count, 3)),
        "palm_rotation_wxyz": Rotation.random(count, random).as_quat()[:, [3, 0, 1, 2]],
        "flexion_rad": random.normal(size=(count, 5, 3)),
        "abduction_rad": random.normal(size=(count, 5)),
        "tracked": random.random(count) > 0.1,
        "has_object_pose": random.random(count) > 0.5,
        "object_position_m": random.normal(size=(count, 3)),
        "object_rotation_wxyz": Rotation.random(count, random).as_quat()[:, [3, 0, 1, 2]],
    }
    columns["tracked"][0] = True
    return columns


def assert_equal(got: dict[str, np.ndarray], expected: dict[str, np.ndarray], count: int | None = None) -> None:
    assert got.keys() == expected.keys()
    for name, values in expected.items():
        assert got[name].dtype == values.dtype, name
        assert np.array_equal(got[name], values[:count]), name


def as_message(columns: dict[str, np.ndarray], i: int) -> dict:
    return {
        name: values[i].ravel().tolist() if values.ndim > 1 else values[i].item() for name, values in columns.items()
    }


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    return make_columns(700, 1 / 90)


def test_trace_comes_back_bit_for_bit(tmp_path, columns):
    path = str(tmp_path / "größe.mcap")
    _runtime.write_trace(path, HEADER, columns)
    header, back, lost = _runtime.read_trace(path)
    assert header == HEADER
    assert lost == SOUND
    assert_equal(back, columns)
    assert [p.name for p in tmp_path.iterdir()] == ["größe.mcap"]


def test_object_pose_may_be_left_out(tmp_path, columns):
    path = str(tmp_path / "t.mcap")
    _runtime.write_trace(path, HEADER, {k: v for k, v in columns.items() if "object" not in k})
    _, back, _ = _runtime.read_trace(path)
    assert not back["has_object_pose"].any()
    assert (back["object_position_m"] == 0).all()
    assert (back["object_rotation_wxyz"] == [1, 0, 0, 0]).all()


@pytest.mark.parametrize("reader", ["indexed", "stream"])
def test_official_reader_gives_equal_values(tmp_path, columns, reader):
    path = tmp_path / "t.mcap"
    _runtime.write_trace(str(path), HEADER, columns)
    make = make_reader if reader == "indexed" else NonSeekingReader
    with path.open("rb") as stream:
        messages = list(
            make(stream, validate_crcs=True, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/haptic_hand")
        )
    assert len(messages) == 700
    for name, values in columns.items():
        got = np.array([getattr(decoded, name) for _, _, _, decoded in messages])
        assert np.array_equal(got, values.reshape(got.shape)), name
    assert [m.log_time for _, _, m, _ in messages] == [round(t * 1e9) for t in columns["time_s"].tolist()]
    assert [m.sequence for _, _, m, _ in messages] == list(range(700))


def test_official_reader_finds_summary_and_metadata(tmp_path, columns):
    path = tmp_path / "t.mcap"
    _runtime.write_trace(str(path), HEADER, columns)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        (metadata,) = reader.iter_metadata()
        header = reader.get_header()
        # Half a second in the middle, which the chunk index must find.
        found = [m.log_time for _, _, m in reader.iter_messages(starting_at=3_000_000_000, ending_at=3_500_000_000)]
    assert (header.profile, header.library) == ("ros2", "palmar")
    assert summary.statistics.message_count == 700
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
    assert summary.statistics.metadata_count == 1
    assert summary.statistics.message_start_time == round(columns["time_s"][0] * 1e9)
    assert summary.statistics.message_end_time == round(columns["time_s"][-1] * 1e9)
    assert metadata.name == "palmar.trace"
    assert {k: v for k, v in metadata.metadata.items() if k != "crc32"} == HEADER
    assert found == [t for t in (np.round(columns["time_s"] * 1e9).astype(int)).tolist() if 3e9 <= t <= 3.5e9]


def test_schema_texts_are_those_of_the_document(tmp_path, columns):
    path = tmp_path / "t.mcap"
    _runtime.write_trace(str(path), HEADER, columns)
    with path.open("rb") as stream:
        (schema,) = make_reader(stream).get_summary().schemas.values()

    def fields(text):
        return [line.split("#")[0].split() for line in text.splitlines() if line.split("#")[0].strip()]

    assert fields(schema.data.decode()) == fields(schema_texts()[SAMPLE])


@pytest.mark.parametrize("chunk_size", [1, 10_000, 1 << 20])
def test_reads_what_the_official_writer_writes(tmp_path, columns, chunk_size):
    path = tmp_path / "t.mcap"
    with (
        path.open("wb") as stream,
        Ros2Writer(stream, chunk_size=chunk_size, compression=CompressionType.NONE) as writer,
    ):
        other = writer.register_msgdef("std_msgs/msg/String", "string data")
        writer.write_message("/other", other, {"data": "not ours"}, log_time=0)
        schema = writer.register_msgdef(SAMPLE, schema_texts()[SAMPLE])
        for i in range(700):
            writer.write_message("/haptic_hand", schema, as_message(columns, i), log_time=i)
        writer.add_metadata("palmar.trace", HEADER)
    header, back, lost = _runtime.read_trace(str(path))
    assert header == HEADER
    assert lost == SOUND
    assert_equal(back, columns)


@pytest.mark.parametrize("crcs", [False, True])
def test_reads_files_without_chunks(tmp_path, columns, crcs):
    path = tmp_path / "t.mcap"
    chunked = io.BytesIO()
    with Ros2Writer(chunked, compression=CompressionType.NONE) as writer:
        schema = writer.register_msgdef(SAMPLE, schema_texts()[SAMPLE])
        for i in range(700):
            writer.write_message("/haptic_hand", schema, as_message(columns, i), log_time=i)
    chunked.seek(0)
    writer = McapWriter(str(path), use_chunking=False, enable_crcs=crcs, enable_data_crcs=crcs)
    writer.start("ros2")
    writer.add_metadata("palmar.trace", HEADER)
    schema = writer.register_schema(SAMPLE, "ros2msg", schema_texts()[SAMPLE].encode())
    channel = writer.register_channel("/haptic_hand", "cdr", schema)
    for _, _, message in NonSeekingReader(chunked).iter_messages():
        writer.add_message(channel, message.log_time, message.data, message.publish_time)
    writer.finish()
    _, back, lost = _runtime.read_trace(str(path))
    assert lost == SOUND
    assert_equal(back, columns)

    # One wrong bit in a sample: with a CRC it must not come out; without one, nobody can know.
    whole = bytearray(path.read_bytes())
    whole[whole.index(columns["flexion_rad"][300].tobytes()) + 3] ^= 16
    path.write_bytes(whole)
    if crcs:
        with pytest.raises(BadTrace, match="E-TRACE-CRC"):
            _runtime.read_trace(str(path))
    # Cut: all whole samples.
    path.write_bytes(whole[: whole.index(columns["flexion_rad"][200].tobytes())])
    _, back, lost = _runtime.read_trace(str(path))
    assert_equal(back, columns, 200)
    assert lost["unclosed"] == 1
    assert lost["messages"] == 1


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_compressed_chunks_are_refused_with_the_way_out(tmp_path, columns, compression):
    path = tmp_path / "t.mcap"
    with path.open("wb") as stream, Ros2Writer(stream, compression=compression) as writer:
        schema = writer.register_msgdef(SAMPLE, schema_texts()[SAMPLE])
        writer.write_message("/haptic_hand", schema, as_message(columns, 0), log_time=0)
        writer.add_metadata("palmar.trace", HEADER)
    with pytest.raises(BadTrace, match=r"E-TRACE-COMPRESSION.*--output-compression none"):
        _runtime.read_trace(str(path))


def test_every_prefix_gives_a_prefix_or_bad_trace(tmp_path):
    columns = make_columns(4, 0.3)  # 0.3 s apart, so each sample has its own chunk
    path = tmp_path / "t.mcap"
    _runtime.write_trace(str(path), HEADER, columns)
    whole = path.read_bytes()
    counts = []
    for size in range(len(whole)):
        path.unlink()
        path.write_bytes(whole[:size])
        try:
            header, back, lost = _runtime.read_trace(str(path))
        except BadTrace:
            counts.append(0)
            continue
        assert header == HEADER
        assert lost["unclosed"] == 1
        counts.append(len(back["time_s"]))
        assert_equal(back, columns, counts[-1])
    assert counts == sorted(counts)
    assert set(counts) == {0, 1, 2, 3, 4}


def test_extra_byte_is_counted(tmp_path, columns):
    path = tmp_path / "t.mcap"
    _runtime.write_trace(str(path), HEADER, columns)
    path.write_bytes(path.read_bytes() + b"\0")
    _, back, lost = _runtime.read_trace(str(path))
    assert lost == SOUND | {"bytes": 1}
    assert_equal(back, columns)


@pytest.mark.parametrize(
    ("change", "code", "where"),
    [
        (lambda c: c["time_s"].__setitem__(5, c["time_s"][4]), "E-TRACE-TIME", "sample 5"),
        (lambda c: c["flexion_rad"].__setitem__((7, 2, 1), np.nan), "E-TRACE-VALUE", "sample 7"),
        (lambda c: c["palm_rotation_wxyz"].__setitem__(0, [1, 0.05, 0, 0]), "E-TRACE-VALUE", "sample 0"),
        (lambda c: c.pop("tracked"), "E-TRACE-COLUMN", "columns.tracked"),
        (lambda c: c.update(flexion=c["flexion_rad"]), "E-TRACE-COLUMN", "columns.flexion"),
        (lambda c: c.update(flexion_rad=c["flexion_rad"].reshape(-1, 15)), "E-TRACE-COLUMN", "columns.flexion_rad"),
        (lambda c: c.update(abduction_rad=c["abduction_rad"][:-1]), "E-TRACE-COLUMN", "columns.abduction_rad"),
    ],
)
def test_wrong_columns_are_refused_and_nothing_is_written(tmp_path, columns, change, code, where):
    change(columns)
    with pytest.raises(BadTrace) as caught:
        _runtime.write_trace(str(tmp_path / "t.mcap"), HEADER, columns)
    assert caught.value.code == code
    assert where in caught.value.where
    assert list(tmp_path.iterdir()) == []


def test_header_that_lacks_a_key_is_refused(tmp_path, columns):
    with pytest.raises(BadTrace, match=r"E-TRACE-HEADER.*device"):
        _runtime.write_trace(str(tmp_path / "t.mcap"), {"hand": "a", "side": "left"}, columns)


def test_other_version_is_refused_with_both_versions(tmp_path, columns):
    path = tmp_path / "t.mcap"
    with path.open("wb") as stream, Ros2Writer(stream, compression=CompressionType.NONE) as writer:
        schema = writer.register_msgdef(SAMPLE, schema_texts()[SAMPLE])
        writer.write_message("/haptic_hand", schema, as_message(columns, 0), log_time=0)
        writer.add_metadata("palmar.trace", HEADER | {"schema": "palmar.trace/7"})
    with pytest.raises(BadTrace, match=r"E-TRACE-SCHEMA.*palmar\.trace/7.*palmar\.trace/1"):
        _runtime.read_trace(str(path))


def test_other_fields_are_refused(tmp_path, columns):
    path = tmp_path / "t.mcap"
    text = schema_texts()[SAMPLE].replace("flexion_rad", "flexion_deg")
    with path.open("wb") as stream, Ros2Writer(stream, compression=CompressionType.NONE) as writer:
        schema = writer.register_msgdef(SAMPLE, text)
        message = as_message(columns, 0)
        message["flexion_deg"] = message.pop("flexion_rad")
        writer.write_message("/haptic_hand", schema, message, log_time=0)
        writer.add_metadata("palmar.trace", HEADER)
    with pytest.raises(BadTrace, match="E-TRACE-SCHEMA"):
        _runtime.read_trace(str(path))


def test_lying_lengths_cost_no_memory(tmp_path):
    """A 60-byte file that claims exabytes is refused at once."""
    path = tmp_path / "t.mcap"
    magic = b"\x89MCAP0\r\n"
    for opcode in (1, 3, 4, 5, 6, 12, 15):
        path.write_bytes(magic + struct.pack("<BQ", opcode, 2**62) + b"\xff" * 40)
        with pytest.raises(BadTrace):
            _runtime.read_trace(str(path))


def test_killed_writer_leaves_no_file_under_the_name(tmp_path):
    """The process dies inside the write: the disk is full for it after 1 MiB."""
    path = tmp_path / "t.mcap"
    program = f"""
import resource, numpy as np
from palmar import _runtime
n = 20_000
columns = dict(time_s=np.arange(n) / 1000,
               palm_position_m=np.zeros((n, 3)), palm_rotation_wxyz=np.tile([1.0, 0, 0, 0], (n, 1)),
               flexion_rad=np.zeros((n, 5, 3)), abduction_rad=np.zeros((n, 5)), tracked=np.ones(n, bool))
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))
_runtime.write_trace({str(path)!r}, dict(device="d", hand="h", side="left"), columns)
"""
    # Python ignores SIGXFSZ, so the writer meets a failed write; with the signal's default the process dies in it.
    refused = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "E-TRACE-WRITE" in refused.stderr
    assert list(tmp_path.iterdir()) == []
    killed = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_DFL)\n" + program
    died = subprocess.run([sys.executable, "-c", killed], capture_output=True, text=True)
    assert died.returncode < 0
    assert not path.exists()


def test_errors_are_the_classes_of_palmar_errors():
    with pytest.raises(BadTrace) as caught:
        _runtime.read_trace("/no/such/file.mcap")
    assert (caught.value.code, caught.value.where) == ("E-TRACE-MISSING", "/no/such/file.mcap")
    with pytest.raises(PalmarError, match=r"E-CONF.*'hold', 'linear' or 'pchip'") as caught:
        _runtime.resample(HEADER, make_columns(3, 0.01), "cubic", 1000)
    assert type(caught.value) is PalmarError


@pytest.mark.parametrize("count", [2, 3, 4, 40])
def test_pchip_equals_scipy(count):
    random = np.random.default_rng(count)
    columns = make_columns(count, 0.01, count)
    columns["time_s"] = 0.5 + np.cumsum(random.uniform(0.002, 0.05, count))
    columns["palm_position_m"] = np.round(columns["palm_position_m"])  # equal neighbours: flat parts and turns
    columns["flexion_rad"] = np.cumsum(np.abs(columns["flexion_rad"]), axis=0)  # monotone
    columns["tracked"][:] = True
    columns["has_object_pose"][:] = True
    got = _runtime.resample(HEADER, columns, "pchip", 1000)
    time_s = got["time_s"]
    assert np.allclose(
        np.diff(time_s), 0.001, rtol=0, atol=2e-9
    )  # a sample within 1 ns of a grid time gives it its own
    for name in ("palm_position_m", "flexion_rad", "abduction_rad", "object_position_m"):
        expected = PchipInterpolator(columns["time_s"], columns[name], axis=0)(time_s)
        # scipy sums powers in another order: 1e-12 of the largest value is some thousand roundings.
        assert np.allclose(got[name], expected, rtol=0, atol=1e-12 * np.abs(columns[name]).max()), name


@pytest.mark.parametrize("method", ["linear", "pchip"])
def test_rotation_equals_scipy_slerp_without_sign_jumps(method):
    columns = make_columns(30, 0.0123, 3)
    columns["tracked"][:] = True
    got = _runtime.resample(HEADER, columns, method, 1000)
    turn = Slerp(columns["time_s"], Rotation.from_quat(columns["palm_rotation_wxyz"], scalar_first=True))
    away = turn(got["time_s"]).inv() * Rotation.from_quat(got["palm_rotation_wxyz"], scalar_first=True)
    assert away.magnitude().max() < 1e-12  # rad; rounding of sines and of the norm
    neighbours = (got["palm_rotation_wxyz"][1:] * got["palm_rotation_wxyz"][:-1]).sum(axis=1)
    assert neighbours.min() > 0.9  # at most 0.9 rad a step at a half turn in 12 steps; a jump of sign gives -1
