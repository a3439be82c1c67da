"""How much of each package the tests reach, from what `make coverage` counted, and where the rest is.

    build/coverage/env/bin/python tests/reached.py [--files]

A package a line: lines and branches reached and there. `--files` lists below it each file that is not reached whole,
with the numbers of its missing lines.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

COUNTED = Path(__file__).resolve().parents[1] / "build" / "coverage"
PYTHON = ("runtime/palmar", "eval", "tools", "traces")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", action="store_true", help="each file that is not reached whole")
    options = parser.parse_args()
    found = python_files() | core_files()
    print("| package | lines | branches |\n| --- | --- | --- |")
    for package in ("runtime/src", *PYTHON):
        files = {name: counts for name, counts in found.items() if name.startswith(package + "/")}
        lines, all_lines, branches, all_branches = (sum(counts[k] for counts in files.values()) for k in range(4))
        print(f"| `{package}` | {share(lines, all_lines)} | {share(branches, all_branches)} |")
        for name, (*counts, missing) in sorted(files.items()) if options.files else ():
            if counts[0] < counts[1] or counts[2] < counts[3]:
                print(f"    {name}: {share(*counts[:2])} {share(*counts[2:])} {' '.join(map(str, missing))}")


def share(reached: int, there: int) -> str:
    return f"{100 * reached / max(there, 1):.1f} % ({reached} of {there})"


def python_files() -> dict[str, tuple]:
    files = json.loads((COUNTED / "python.json").read_text())["files"]
    return {name: python_counts(file["summary"], file["missing_lines"]) for name, file in files.items()}


def python_counts(summary: dict[str, int], missing: list[int]) -> tuple:
    names = ("covered_lines", "num_statements", "covered_branches", "num_branches")
    return (*(summary[name] for name in names), missing)


def core_files() -> dict[str, tuple]:
    files = json.loads((COUNTED / "core.json").read_text())["files"]
    return {f"runtime/{file['file']}": core_counts(file["lines"]) for file in files}


def core_counts(lines: list[dict]) -> tuple:
    """A line of a template is there once for each type; reached where one of them is. Branches are each type's."""
    numbers = {line["line_number"] for line in lines}
    missing = sorted(numbers - {line["line_number"] for line in lines if line["count"] > 0})
    branches = [branch["count"] > 0 for line in lines for branch in line["branches"]]
    return len(numbers) - len(missing), len(numbers), sum(branches), len(branches), missing


if __name__ == "__main__":
    main()
