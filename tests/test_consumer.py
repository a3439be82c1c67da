"""The core as an outside C project sees it: installed with CMake alone, found, linked, run."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]
CORE = TOP / "build" / "tests"  # `make test` configures and builds it, without Python
CMAKE = Path(sys.executable).parent / "cmake"


@pytest.mark.skipif(not (CORE / "libpalmar.a").exists(), reason="the core is not built alone; `make test` does it")
def test_an_outside_c_project_finds_links_and_runs_the_installed_core(tmp_path):
    environment = os.environ | {"PATH": f"{CMAKE.parent}{os.pathsep}{os.environ['PATH']}"}

    def cmake(*arguments):
        done = subprocess.run([CMAKE, *map(str, arguments)], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    cmake("--install", CORE, "--component", "palmar", "--prefix", tmp_path / "prefix")
    cmake(
        "-S",
        TOP / "tests" / "consumer",
        "-B",
        tmp_path / "build",
        "-G",
        "Ninja",
        f"-DCMAKE_PREFIX_PATH={tmp_path / 'prefix'}",
    )
    cmake("--build", tmp_path / "build")

    said = subprocess.run([tmp_path / "build" / "consumer"], cwd=tmp_path, capture_output=True, text=True).stdout.split(
        "\n"
    )
    assert said[0] == version("palmar")
    assert said[1] == "2"
    assert said[2].startswith("E-PACK-") and "absent.pack" in said[2]
