"""Verbs that are killed, run out of disk or lose their glove leave whole results or none. One moment of each."""

import subprocess
import sys
from pathlib import Path


def test_interrupted_verbs_leave_whole_results_or_none():
    # In a process of its own, since it makes children of itself.
    program = Path(__file__).with_name("interrupted.py")
    command = [sys.executable, program, "build", "replay", "record", "--moments", "1"]  # a report takes half a minute
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert sum(row.endswith("| 0 |") for row in done.stdout.splitlines()) == 7, done.stdout  # every way, none wrong
