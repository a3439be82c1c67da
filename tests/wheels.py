"""A wheel for each Python named: built, installed with the newest libraries in an environment of its own, and tried.

python tests/wheels.py FOLDER PYTHON... -- TEST...: a row for each, with its time. A Python that is not here is passed
over and said; the exit code is 1 where one failed or none was here.
"""

import subprocess
import sys
import time
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]


def version(python: str) -> str | None:
    """Such as `3.14`. None where it does not run: what lies on the path may point to nothing."""
    try:
        asked = [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def made(python: str, into: Path, tests: list[str]) -> str:
    """Name and size of the wheel that was built and passed. CalledProcessError: what failed has said why."""
    subprocess.run([python, "-m", "venv", "--clear", into / "env"], check=True)
    inside = into / "env" / "bin" / "python"
    pip = [inside, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    # The build is its own too: what CMake remembers of pip's own build environment is gone when that is.
    built = ["--wheel-dir", into, "--config-settings", f"build-dir={into / 'env' / 'core'}"]
    for old in into.glob("*.whl"):
        old.unlink()
    subprocess.run([*pip, "wheel", TOP, "--no-deps", *built], check=True)
    (wheel,) = into.glob("*.whl")
    subprocess.run([*pip, "install", f"{wheel}[test]"], check=True)
    subprocess.run([inside, "-m", "pytest", "-p", "no:cacheprovider", *tests], cwd=TOP, check=True)
    return f"{wheel.relative_to(TOP)} ({wheel.stat().st_size / 1e6:.1f} MB)"


def main(folder: str, pythons: list[str], tests: list[str]) -> int:
    rows, failed, passed = [], 0, 0
    for python in pythons:
        began, found = time.monotonic(), version(python)
        if found is None:
            rows.append(f"{python}: not here")
            continue
        try:
            what = made(python, (TOP / folder / found), tests) + ": built, installed, tests passed"
            passed += 1
        except subprocess.CalledProcessError as error:
            what = f"failed: {' '.join(map(str, error.cmd))}"
            failed += 1
        rows.append(f"{python} ({found}): {what}, {time.monotonic() - began:.0f} s")
    print(*rows, sep="\n")
    return int(failed > 0 or passed == 0)


if __name__ == "__main__":
    if len(sys.argv) < 4 or "--" not in sys.argv:
        sys.exit(__doc__)
    end = sys.argv.index("--")
    sys.exit(main(sys.argv[1], sys.argv[2:end], sys.argv[end + 1 :]))
