"""Processes that work for a verb end with it, whether it is asked to stop or killed."""

import os
import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import os, signal, time
from palmar import cli
from palmar.workers import workers

def work():
    print(os.getpid(), flush=True)
    time.sleep(600)

def verb(arguments):
    with workers(1) as pool:
        pool.submit(work).result()

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # the background jobs of a shell are born deaf to it
    cli.run = verb
    cli.main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_workers_die_with_the_verb(tmp_path, stop):
    (tmp_path / "verb.py").write_text(PROGRAM)
    verb = subprocess.Popen(
        [sys.executable, "verb.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    worker = int(verb.stdout.readline())
    verb.send_signal(stop)
    verb.wait(60)
    for _ in range(600):  # a minute, on any machine; it takes no more than it has to
        if not is_alive(worker):
            break
        time.sleep(0.1)
    assert not is_alive(worker)


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
