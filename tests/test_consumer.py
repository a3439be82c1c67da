"""The core as outside projects see it: installed with CMake alone, stepped from C, loaded by ctypes."""

import os
import re
import subprocess
import sys
from importlib.metadata import version
from itertools import product
from pathlib import Path

import pytest

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


def test_the_code_that_the_host_page_shows_is_that_of_the_tested_hosts():
    page = (TOP / "docs" / "host.md").read_text()
    hosts = (CONSUMER / "main.c").read_text() + (CONSUMER / "host.py").read_text()
    blocks = re.findall(r"```(?:c|python)\n(.*?)```", page, re.DOTALL)
    assert len(blocks) >= 2
    for block in blocks:
        assert block in hosts, block
