"""Changed copies of small files through the Python readers: one line of a PalmarError, or what keeps every promise.

Hypothesis chooses and shrinks the changes. `pytest tests/test_fuzz_readers.py --fuzz-examples 20000` tries more.
"""

import json
import re
import signal
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import made_logs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save
from test_column_map import MAP, made_log
from test_column_map import write_log as write_mapped_log
from test_opengloves import LINE, read_all
from test_profile import FULL

from palmar import _runtime
from palmar.errors import PalmarError
from palmar.model import AssetPack, load_pack, save_pack
from palmar.records import Trace, read_trace, write_trace
from palmar.tools.default_hands import find_hand
from palmar.tools.hand_file import read_hand
from palmar.tools.pack import Source, build, read_assets
from palmar.tools.profile_file import profile_toml, read_profile
from palmar.tools.spheres_csv import read_spheres_csv
from palmar.traces.column_map import read_column_map, read_mapped_csv
from palmar.traces.device import read_device
from palmar.traces.opengloves import FULL_SCALE, NEW_KEYS_AFTER, Decoder, encode_reading
from palmar.traces.recording import Recording
from palmar.traces.scene_file import cases_of
from palmar.traces.scripted import SCENES, load_scene

HANG_S = 60  # of processor time: no limit on speed, an end to what would not end
TOP = Path(__file__).resolve().parents[1]
# What readers stumble over, beside plain bytes.
WORDS = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e308",
    b"-0.0",
    b"1e-300",
    b"99999999999999999999",
    b"true",
    b'""',
    b"[]",
    b"{}",
]
WORDS += [
    b"\n",
    b",",
    b";",
    b"=",
    b"[",
    b"]",
    b'"',
    b"#",
    b"\x00",
    b"\xff\xfe",
    b"\r",
    b".",
    b"e",
    b"null",
    b"'",
    b"[[",
]


@dataclass(frozen=True)
class Reader:
    """A small sound file, and what reads it: it raises PalmarError, or asserts what must hold of what was accepted."""

    sample: Callable[[Path], bytes]
    name: str
    read: Callable[[Path], object]


def finite(*arrays: np.ndarray) -> bool:
    return all(np.isfinite(array).all() for array in arrays)


def hand(path: Path) -> None:
    found = read_hand(path)
    assert finite(found.palm_spheres_m, found.joint_m, found.phalanx_m, found.phalanx_radius_m)
    assert (found.palm_spheres_m[:, 3] > 0).all() and (found.phalanx_radius_m > 0).all()
    assert np.allclose(np.linalg.norm(found.flexion_axis, axis=-1), 1, atol=1e-9)
    assert (found.flexion_limit_rad[..., 0] <= found.flexion_limit_rad[..., 1]).all()
    assert (found.joint_stiffness_n_m_per_rad > 0).all()
    packed = path.with_name("hand.pack")
    save_pack(packed, AssetPack(found, load_pack(path.with_name("cube.pack")).objects, {}))
    assert np.array_equal(load_pack(packed).hand.joint_m, found.joint_m)
    _runtime.Session(str(packed))  # what Python writes the core reads


def scene(path: Path) -> None:
    keys, _, _ = load_scene(path)
    assert all(isinstance(name, str) and case["kind"] == keys["kind"] for name, case in cases_of(keys, str(path)))


def profile(path: Path) -> None:
    found = read_profile(path)
    text = profile_toml(found)
    again = path.with_name("again.toml")
    again.write_text(text)
    assert profile_toml(read_profile(again)) == text


def assets(path: Path) -> None:
    sources, _ = read_assets(path, Source("", ""))
    assert sources and all(source.mesh and source.name for source in sources)


def column_map(path: Path) -> None:
    columns = read_column_map(path)
    goes_round(read_mapped_csv(path.with_name("log.csv"), columns), path)


def mapped_log(path: Path) -> None:
    goes_round(read_mapped_csv(path, read_column_map(path.with_name("map.toml"))), path)


def log(path: Path) -> None:
    found = read_device(path)
    if isinstance(found, Recording):
        assert (np.diff(found.time_s) > 0).all()
    else:
        goes_round(found, path)


def goes_round(trace: Trace, path: Path) -> None:
    """A trace that was read can be written, but for angles that are still to be filled in, and comes back the same."""
    assert (np.diff(trace.time_s) > 0).all() and finite(trace.time_s, trace.palm_position_m, trace.palm_rotation_wxyz)
    if np.isnan(trace.flexion_rad).any():
        return
    out = path.with_name("round.mcap")
    write_trace(out, trace)
    again = read_trace(out)
    assert not any(again.lost.values()) and np.array_equal(again.time_s, trace.time_s)
    assert np.array_equal(again.flexion_rad, trace.flexion_rad)


def spheres(path: Path) -> None:
    leaves, _ = read_spheres_csv(path)
    assert finite(leaves) and (leaves[:, 3] > 0).all() and leaves.shape[1] == 4


def pack(path: Path) -> None:
    found = load_pack(path)
    for tree in found.objects.values():
        assert all(finite(level) and (level[:, 3] > 0).all() for level in tree.levels)
    again = path.with_name("again.pack")
    save_pack(again, found)
    assert load_pack(again).objects.keys() == found.objects.keys()
    for name in found.objects:
        _runtime.Session(str(path), name)  # the core takes whatever Python takes


def glove_bytes(path: Path) -> None:
    """Shares of the full scale come out, the same however the bytes arrive, and the glove is known then."""
    raw, decoder, bytewise = path.read_bytes() + b"\n", Decoder(), Decoder()
    readings, rejected = read_all([raw], decoder)
    again, rejected_again = read_all([raw[at : at + 1] for at in range(len(raw))], bytewise)
    assert (repr(readings), rejected, decoder) == (repr(again), rejected_again, bytewise)  # NaN is not itself
    for reading in readings:
        shares = np.array([*reading.flexion, reading.trigger])
        signed = np.array([*reading.abduction, *reading.joystick])
        assert ((shares >= 0) & (shares <= 1) | np.isnan(shares)).all() and not np.isnan(shares[15])
        assert (np.isnan(signed) | (abs(signed) <= 1)).all()
        assert not np.isnan(np.reshape(reading.flexion, (5, 3))).all(axis=1).any()  # of every finger something
        assert 0 <= reading.buttons < 256
        if finite(np.array(reading.flexion[::3])):
            back = Decoder().decode(encode_reading(reading).strip())
            assert back is not None and np.allclose(
                back.flexion[::3], reading.flexion[::3], rtol=0, atol=1 / FULL_SCALE
            )
    assert decoder.largest <= FULL_SCALE and decoder.hand in (None, 0, 1)
    known, _ = read_all([LINE + b"\n"] * NEW_KEYS_AFTER, decoder)
    assert known


def small_pack(folder: Path) -> bytes:
    """Without its checksum, which no change would come past."""
    raw = (folder / "cube.pack").read_bytes()
    manifest = json.loads(json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])["__metadata__"]["palmar"])
    del manifest["crc32"]
    return save(load(raw), {"palmar": json.dumps(manifest)})


def made(write: Callable[..., Path], *arguments: object) -> Callable[[Path], bytes]:
    return lambda folder: write(folder / "made.csv", *arguments).read_bytes()


def mapped(folder: Path) -> bytes:
    return write_mapped_log(folder / "log.csv", made_log()[1]).read_bytes()


def scene_text(name: str) -> Callable[[Path], bytes]:
    return lambda _: (SCENES / f"{name}.toml").read_bytes()


ASSETS = b'hand = "default"\n[[object]]\nmesh = "shape:cube"\nname = "c"\nsize_mm = 80\nerror_mm = 2.0\nclose = true\n'
SPHERES = b"x_m,y_m,z_m,radius_m\n0,0,0,0.01\n0.02,0.0,-0.01,0.012\n"
GLOVE = b"\n".join(
    [
        b"Z(ZV)1(ZG)2(ZH)1",
        LINE,
        b"A100B200C300D400E500F2048G2048P7HKN",
        b"A100B200C300D400E500F0G4095P0(AAA)1(AAB)2(AAC)3(BAB)10(BAC)20(BAD)30(AB)500(BB)4095",
        b"100&200&300&400&500&2048&0&0&1&0&1&0&1",
    ]
)
ANGLES = made_logs.made_angles(4)
READERS = {
    "hand": Reader(lambda _: (TOP / "tools" / "default_hand.toml").read_bytes(), "hand.toml", hand),
    "profile": Reader(lambda _: profile_toml(FULL).encode(), "profile.toml", profile),
    "assets": Reader(lambda _: ASSETS, "assets.toml", assets),
    "scene of a grasp": Reader(scene_text("grasp"), "scene.toml", scene),
    "scene with faults": Reader(scene_text("samples_dropped"), "scene.toml", scene),
    "scene with sweeps": Reader(scene_text("plate_approach"), "scene.toml", scene),
    "column map": Reader(lambda _: MAP.encode(), "other.toml", column_map),
    "mapped log": Reader(mapped, "other.csv", mapped_log),
    "leap log": Reader(made(made_logs.leap_log, made_logs.made_hand(), ANGLES), "leap.csv", log),
    "webxr log": Reader(made(made_logs.webxr_log, made_logs.made_hand(), ANGLES), "webxr.csv", log),
    "glove bytes": Reader(lambda _: GLOVE, "glove.bin", glove_bytes),
    "spheres": Reader(lambda _: SPHERES, "spheres.csv", spheres),
    "pack": Reader(small_pack, "x.pack", pack),
}

PLACE = st.floats(0, 1, exclude_max=True)
PIECE = st.one_of(st.sampled_from(WORDS), st.binary(min_size=1, max_size=4))
EDIT = st.tuples(st.sampled_from(["put", "cut", "over", "swap", "number", "line"]), PLACE, PLACE, PIECE)


def edited(raw: bytes, edits: list[tuple[str, float, float, bytes]]) -> bytes:
    for kind, first, second, piece in edits:
        at, other = int(first * len(raw)), int(second * len(raw))
        if kind == "put":
            raw = raw[:at] + piece + raw[at:]
        elif kind == "cut":
            raw = raw[:at] + raw[at + 1 + other % 40 :]
        elif kind == "over":
            raw = raw[:at] + piece + raw[at + len(piece) :]
        elif kind == "swap":
            raw = raw[:at] + raw[other : other + 20] + raw[at:]
        elif kind == "number" and (numbers := list(re.finditer(rb"-?\d[\d.e+-]*", raw))):
            chosen = numbers[int(first * len(numbers))]
            raw = raw[: chosen.start()] + piece + raw[chosen.end() :]
        elif kind == "line":
            lines = raw.split(b"\n")
            lines.insert(int(second * len(lines)), lines[int(first * len(lines))])
            raw = b"\n".join(lines)
    return raw


@contextmanager
def bounded_time():
    def end(*_):
        pytest.fail(f"more than {HANG_S} s of processor time")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """cube.pack, map.toml and log.csv, which some readers need beside theirs."""
    place = tmp_path_factory.mktemp("fuzz")
    (place / "cube.csv").write_bytes(SPHERES)
    (place / "map.toml").write_text(MAP)
    mapped(place)
    build(["shape:cube"], place / "cube.pack", spheres_csv=place / "cube.csv")
    return place


@pytest.mark.parametrize("name", READERS)
def test_a_changed_file_is_refused_in_one_line_or_keeps_every_promise(name, folder, request):
    reader, sample = READERS[name], cache(READERS[name].sample)
    path = folder / reader.name
    path.write_bytes(sample(folder))
    reader.read(path)  # the sound file is accepted

    @settings(
        max_examples=request.config.getoption("--fuzz-examples"),
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.lists(EDIT, min_size=1, max_size=4))
    def changed(edits):
        path.write_bytes(edited(sample(folder), edits))
        with bounded_time(), warnings.catch_warnings():
            warnings.simplefilter("error")  # it would be another line for the user
            try:
                reader.read(path)
            except PalmarError as error:
                assert re.fullmatch(r"E-[A-Z0-9-]+ .+: .+", str(error)), str(error)

    changed()


def test_the_hand_of_the_tests_is_the_one_of_the_file():
    assert np.array_equal(read_hand(TOP / "tools" / "default_hand.toml").joint_m, find_hand("default").joint_m)
