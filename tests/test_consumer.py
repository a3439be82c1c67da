"""The core as outside projects see it: installed with CMake alone, stepped from C, loaded by ctypes."""

import ctypes
import json
import os
import random
import re
import subprocess
import sys
import time
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from palmar import _runtime
from palmar.errors import BadTrace, PalmarError

sys.path.append(str(Path(__file__).parent / "consumer"))
import host

TOP = Path(__file__).resolve().parents[1]
CORE = TOP / "build" / "tests"  # `make test` configures and builds it, without Python
CONSUMER = TOP / "tests" / "consumer"
CMAKE = Path(sys.executable).parent / "cmake"

needs_core = pytest.mark.skipif(
    not (CORE / "libpalmar.a").exists() or not (CORE / "libpalmar.so").exists(),
    reason="the core is not built alone; `make test` does it",
)


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A prefix with the core, a pack of one cube (z up to 32 mm) and the built C host."""
    from palmar.tools.pack import build

    folder = tmp_path_factory.mktemp("hosts")
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (folder / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    build(["shape:cube"], folder / "cube.pack", spheres_csv=folder / "cube.csv")

    environment = os.environ | {"PATH": f"{CMAKE.parent}{os.pathsep}{os.environ['PATH']}"}

    def cmake(*arguments: object) -> None:
        done = subprocess.run([CMAKE, *map(str, arguments)], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    cmake("--install", CORE, "--component", "palmar", "--prefix", folder / "prefix")
    cmake("-S", CONSUMER, "-B", folder / "build", "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={folder / 'prefix'}")
    cmake("--build", folder / "build")
    return folder


def said_by(*command: object) -> list[str]:
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.stderr == ""
    return done.stdout.splitlines()


@needs_core
def test_a_c_host_and_a_ctypes_host_step_the_installed_core_to_the_same_state(installed):
    from_c = said_by(installed / "build" / "consumer", installed / "cube.pack")
    library = next((installed / "prefix").rglob("libpalmar.so"))
    from_ctypes = said_by(sys.executable, CONSUMER / "host.py", library, installed / "cube.pack")

    assert from_c == from_ctypes
    assert from_c[0] == f"palmar {version('palmar')}"
    heights = [float(re.search(r"palm at ([\d.]+) m", line)[1]) for line in from_c[1:-1]]
    contacts = [int(re.search(r"(\d+) contacts", line)[1]) for line in from_c[1:-1]]
    forces = [float(re.search(r"force (-?[\d.]+) N", line)[1]) for line in from_c[1:-1]]
    assert contacts[0] == 0 and forces[0] == 0.0
    assert contacts[-1] > 0
    # The cube's top is at 32 mm, the palm's balls have 11 mm; the thumb, which points down, holds it a little higher.
    assert 0.040 < heights[-1] < 0.060
    # 1000 N/m times the distance to the commanded 20 mm, upwards.
    assert forces[-1] == pytest.approx(1000 * (heights[-1] - 0.02), abs=0.01)


@needs_core
def test_a_host_gets_one_line_for_a_pack_that_is_not_there(installed):
    said = said_by(installed / "build" / "consumer", "absent.pack")
    assert said[1].startswith("E-PACK-") and "absent.pack" in said[1]
    assert len(said) == 2


def frames(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Which frames of the recording hosts the samples are, each checked against what those hosts send."""
    numbers = np.round(columns["time_s"] * 1000).astype(int)
    assert np.array_equal(columns["time_s"], 0.001 * numbers)
    assert np.array_equal(columns["palm_position_m"][:, 2], 1e-6 * numbers)
    assert (columns["flexion_rad"] == (1e-3 * (numbers % 1000))[:, None, None]).all()
    assert columns["tracked"].all()
    return numbers


@needs_core
def test_a_c_host_and_a_ctypes_host_record_the_same_trace(installed, tmp_path):
    library = next((installed / "prefix").rglob("libpalmar.so"))
    said = said_by(installed / "build" / "record", tmp_path / "c.mcap", 300)
    assert said[-1] == "300 written, 0 dropped, 0 refused"
    said = said_by(sys.executable, CONSUMER / "record.py", library, tmp_path / "py.mcap", 300)
    assert said[-1].strip() == "300 written, 0 dropped, 0 refused"
    (header, columns, lost), (other_header, other_columns, _) = (
        _runtime.read_trace(str(tmp_path / name)) for name in ("c.mcap", "py.mcap")
    )
    assert not any(lost.values())
    assert header == other_header
    assert header["rate_hz"] == "1000" and header["device"] == "example"
    assert frames(columns).tolist() == list(range(300))
    for name, values in columns.items():
        assert np.array_equal(values, other_columns[name]), name


@needs_core
def test_a_recording_is_never_written_over(installed, tmp_path):
    path = tmp_path / "r.mcap"
    path.write_bytes(b"precious")
    (line,) = said_by(installed / "build" / "record", path, 10)
    assert line.startswith(f"E-TRACE-EXISTS {path}: ")
    assert path.read_bytes() == b"precious"


def killed_after(host: Path, path: Path, seconds: float) -> tuple[int, int, int]:
    """(taken, written, read back) of a recording host that is killed at a moment of its own."""
    process = subprocess.Popen([host, path], stdout=subprocess.PIPE, text=True)
    process.stdout.readline()  # it runs
    time.sleep(seconds)
    process.kill()
    # The last whole line that it could say before its end.
    taken, written = 10, 0
    for line in process.communicate()[0].splitlines():
        if found := re.fullmatch(r"(\d+) taken, (\d+) written", line):
            taken, written = map(int, found.groups())
    try:
        _, columns, lost = _runtime.read_trace(str(path))
    except BadTrace as error:
        assert error.code == "E-TRACE-MISSING"  # killed before it had the name
        return taken, written, 0
    assert lost["unclosed"] == 1
    numbers = frames(columns)
    assert numbers.tolist() == list(range(len(numbers)))
    return taken, written, len(numbers)


@needs_core
def test_the_c_interface_says_what_python_says(installed, tmp_path):
    palmar = host.load(str(CORE / "libpalmar.so"))
    session, message = ctypes.c_void_p(), ctypes.create_string_buffer(512)
    raw = (installed / "cube.pack").read_bytes()
    bad = {"cut": raw[:-8], "flipped": raw[:-9] + bytes([raw[-9] ^ 1]) + raw[-8:], "none": b"", "version": None}
    bad["version"] = re.sub(rb'(crc32)(\\": )', rb"crc31\2", raw.replace(b"palmar.pack/2", b"palmar.pack/7"))
    packs = [(installed / "cube.pack", text) for text in ("{", '{"rate_hz": -1}', '{"iteratons": 1}', '{"level": 9}')]
    for name, content in bad.items():
        packs.append((tmp_path / f"{name}.pack", "{}"))
        packs[-1][0].write_bytes(content)
    for pack, settings in [*packs, (tmp_path / "absent.pack", "{}")]:
        code = palmar.palmar_open(
            str(pack).encode(), None, settings.encode(), ctypes.byref(session), message, len(message)
        )
        assert code == PalmarError.exit_code and session.value is None
        said = message.value.decode()
        assert re.fullmatch(r"E-(PACK|CONF)-[A-Z]+ .+: .+", said)
        if settings != "{":  # Python has no settings that are no JSON
            with pytest.raises(PalmarError) as caught:
                _runtime.Session(str(pack), "", json.loads(settings))
            assert str(caught.value) == said


@needs_core
def test_all_that_a_killed_host_had_written_reads_back(installed, tmp_path, request):
    kills = request.config.getoption("--host-kills")
    moments = random.Random()
    losses = []
    for k in range(kills):
        moment = moments.uniform(0, 0.8)
        taken, written, read = killed_after(installed / "build" / "record", tmp_path / f"{k}.mcap", moment)
        assert read >= written, f"killed after {moment:.3f} s"
        losses.append(taken - read)  # of one frame a millisecond
    print(f"\n{kills} kills: {max(losses)} ms of samples lost at most, {sum(losses) / kills:.0f} on average")
    if kills >= 100:  # a measurement: the disk and the machine have their part in it
        assert max(losses) <= 250


def test_the_code_that_the_host_page_shows_is_that_of_the_tested_hosts():
    page = (TOP / "docs" / "host.md").read_text()
    hosts = "".join((CONSUMER / name).read_text() for name in ("main.c", "record.c", "host.py"))
    blocks = re.findall(r"```(?:c|python)\n(.*?)```", page, re.DOTALL)
    assert len(blocks) >= 3
    for block in blocks:
        assert block in hosts, block
