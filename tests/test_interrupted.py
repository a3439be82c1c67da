"""Verbs that are killed, run out of disk or lose their glove leave whole results or none. One moment of each."""

import subprocess
import sys
from pathlib import Path


def test_interrupted_verbs_leave_whole_results_or_none():
    # In a process of its own, since it makes children of itself.
    command = [sys.executable, Path(__file__).with_name("interrupted.py"), "--moments", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert sum(row.endswith("| 0 |") for row in done.stdout.splitlines()) == 9, done.stdout  # every way, none wrong
