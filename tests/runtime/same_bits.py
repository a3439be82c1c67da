"""The same poses, forces and contacts from every compiler and optimisation: builds hash_step with each and compares.

python tests/runtime/same_bits.py [FOLDER]  (some minutes; the folder keeps the builds, build/same_bits if left out)
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
COMPILERS = [name for name in ("g++", "clang++", "clang++-19") if shutil.which(name)]
FLAGS = ("-O0", "-O2", "-O3", "-O3 -DNDEBUG")
# Instruction sets of everything, not of the wide loops alone.
SETS = ("-O3 -march=x86-64-v3",)


def build(compiler: str, flags: str, folder: Path) -> Path:
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    configure = [
        *(BIN / "cmake", "-S", TOP / "runtime", "-B", folder, "-G", "Ninja", "-DPALMAR_TESTS=ON"),
        *(f"-DCMAKE_CXX_COMPILER={compiler}", f"-DCMAKE_CXX_FLAGS={flags}"),
        "-DCMAKE_BUILD_TYPE=Plain",  # no flags but these
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    for command in (configure, [BIN / "cmake", "--build", folder, "--target", "hash_step_dispatched"]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
    return folder / "hash_step_dispatched"


def main(folder: Path) -> int:
    said = {}
    for compiler in COMPILERS:
        for flags in (*FLAGS, *SETS):
            program = build(compiler, flags, folder / f"{compiler} {flags}".replace(" ", "_"))
            runs = {subprocess.run([program, "dispatched"], capture_output=True, check=True).stdout for _ in range(3)}
            digests = sorted(hashlib.sha256(output).hexdigest()[:16] for output in runs)
            said[compiler, flags] = digests
            print(f"{compiler} {flags}: {' '.join(digests)}", flush=True)
    different = {digest for digests in said.values() for digest in digests}
    print(f"{len(said)} builds, 3 runs each: {len(different)} different answer(s)")
    return int(len(different) != 1)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else TOP / "build" / "same_bits"))
