"""The same poses, forces and contacts from every compiler, optimisation, instruction set and number of threads.

python tests/runtime/same_bits.py [--all] [--only "c++ -O3 -march=x86-64-v3"]... [SCENE...]

Builds the library with each and compares what `hash_step` (each solver, wild motions, three objects) and `hash_runs`
(scenes as files, in 1, 2, 4 and 8 threads at once, so each fifteen times) say, here and with the C library of an old
machine. Prints a table of Markdown; exit code 1
where two differ. Builds stay under build/same_bits_*. Twelve builds, or twenty with --all: half an hour of a processor.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path

from palmar.records import read_run

TOP = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
# c++ is what `make test` builds with.
COMPILERS = [name for name in ("c++", "clang++", "clang++-19") if shutil.which(name)]
# What is optimised, and for which machine all of it is compiled: not the wide loops alone, which choose by themselves.
LEVELS = ("-O3", "-O0", "-O2", "-O3 -DNDEBUG")
MACHINES = ("-march=x86-64-v3", "-march=x86-64-v4")  # AVX2, AVX-512
# The C library takes other functions on a machine without these, and so do its sines; glibc lets a process ask for it.
OLD_MACHINE = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-FMA4,-AVX"}
REPEATS = ({}, {}, OLD_MACHINE)
THREADS = (1, 2, 4, 8)
UNOPTIMISED_THREADS = (1, 2)  # it takes thirty times as long
SCENES = (
    *("two_ears", "slide_ripple", "deep_press", "hold_noise", "samples_dropped", "object_hits_hand", "thin_shell"),
    "concave_notch",
)


def flags_of(every: bool) -> list[str]:
    """Flags of each build."""
    levels = LEVELS[:3] if every else LEVELS[:1]
    machines = [f"{level} {machine}" for machine in MACHINES for level in levels]
    return [*LEVELS[:2], *machines, *LEVELS[2:]]


def build(compiler: str, flags: str, folder: Path) -> Path:
    environment = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    configure = [
        *(BIN / "cmake", "-S", TOP / "runtime", "-B", folder, "-G", "Ninja", "-DPALMAR_TESTS=ON"),
        # Release is -O3; Plain has no flags but these.
        *(f"-DCMAKE_CXX_COMPILER={compiler}", f"-DCMAKE_CXX_FLAGS={flags.removeprefix('-O3')}"),
        f"-DCMAKE_BUILD_TYPE={'Release' if flags.startswith('-O3') else 'Plain'}",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    make = [BIN / "cmake", "--build", folder, "--parallel", "1", "--target", "hash_step_dispatched", "hash_runs"]
    for command in (configure, make):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
    return folder


def make_scenes(names: list[str], folder: Path) -> list[str]:
    """Pack, trace, object and settings of the worst run of each scene, as this machine's palmar finds it."""
    if not folder.exists():
        check = [BIN / "palmar", "check", *names, "--quick", "--runs", "-o", folder]
        if subprocess.run(check, stdout=subprocess.DEVNULL).returncode not in (0, 1):
            sys.exit(2)
    inputs = []
    for path in sorted(folder.rglob("*.run.mcap")):
        header = read_run(path).header
        trace = path.with_name(path.name.replace(".run.mcap", ".mcap"))
        pack = path.with_name(path.name.replace(".run.mcap", ".pack"))
        settings = json.loads(header["settings"])
        inputs += [str(pack), str(trace), header["object"], json.dumps(settings)]
    return inputs


def name_of(compiler: str) -> str:
    return said_by(compiler, "--version").splitlines()[0]


def said_by(*command: str | Path, environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, env=os.environ | (environment or {}), capture_output=True, check=True, text=True)
    return done.stdout


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--all", action="store_true", help="-O0 and -O2 for each machine as well")
    parser.add_argument("--only", action="append", help="compiler and flags, such as 'c++ -O0'; may be repeated")
    options = parser.parse_args()
    inputs = make_scenes(list(options.scenes), TOP / "build" / "same_bits_scenes")
    print(f"{len(inputs) // 4} scenes\n")
    print("| build | threads | solvers on made objects | scenes |\n| --- | --- | --- | --- |")
    answers = set()
    every = [(compiler, flags) for flags, compiler in product(flags_of(options.all), COMPILERS)]
    for compiler, flags in [one.split(maxsplit=1) for one in options.only or []] or every:
        slug = f"{compiler}_{flags}".replace(" ", "_")
        folder = build(compiler, flags, TOP / "build" / f"same_bits_{slug}")
        threads = UNOPTIMISED_THREADS if "-O0" in flags else THREADS
        stepped = {said_by(folder / "hash_step_dispatched", "dispatched", environment=like) for like in REPEATS}
        ran = {said_by(folder / "hash_runs", str(count), *inputs) for count in threads}
        ran.add(said_by(folder / "hash_runs", "1", *inputs, environment=OLD_MACHINE))
        steps, runs = sorted(stepped), sorted(ran)
        answers.add((*steps, *runs))
        (folder / "said.txt").write_text("".join(steps + runs))
        counts = ", ".join(map(str, threads))
        hashes = [" ".join(map(digest, said)) for said in (steps, runs)]
        print(f"| {name_of(compiler)} {flags} | {counts} | {hashes[0]} | {hashes[1]} |", flush=True)
    print("\nall the same" if len(answers) == 1 else f"\n{len(answers)} different answers")
    return int(len(answers) != 1)


if __name__ == "__main__":
    sys.exit(main())
