"""Reading in a process of its own: what comes back, and what becomes of a reader that has no end."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from palmar.errors import BadMesh
from palmar.tools.apart import read_apart


def apart(read, **limits):
    return read_apart("file.obj", read, **({"memory_bytes": 2**28, "cpu_s": 10} | limits))


def test_arrays_come_back_as_they_are():
    made = [np.random.default_rng(0).normal(size=(100_000, 3)), np.arange(7, dtype=np.int64), np.zeros((0, 3))]
    for want, found in zip(made, apart(lambda: made), strict=True):
        assert found.dtype == want.dtype and np.array_equal(found, want)


def test_an_error_of_the_reader_is_raised_here():
    def read():
        raise BadMesh("E-MESH-NAN", "file.obj:3", "nan is not finite")

    with pytest.raises(BadMesh, match=r"^E-MESH-NAN file.obj:3: nan is not finite$"):
        apart(read)


def ever_more():
    kept = []
    while True:
        kept.append(bytes(2**24))


def no_end():
    while True:
        pass


def children():
    """Processes that this one has begun and not yet seen the end of, by number."""
    return {
        int(number) for task in Path("/proc/self/task").iterdir() for number in (task / "children").read_text().split()
    }


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (ever_more, "E-MESH-LIMIT file.obj: reading it took more than 256 MiB"),
        (no_end, "E-MESH-LIMIT file.obj: reading it took more than 1 s of processor time"),
        (lambda: os.kill(os.getpid(), signal.SIGTERM), r"E-MESH-FORMAT file.obj: its reader crashed \(signal 15\)"),
        (lambda: 1 / 0, r"E-MESH-FORMAT file.obj: its reader crashed \(exit code 1\)"),
        (lambda: os._exit(0), r"E-MESH-FORMAT file.obj: its reader crashed \(exit code 0\)"),
    ],
)
def test_a_reader_without_end_is_ended(read, said):
    before = children()
    with pytest.raises(BadMesh, match=said):
        apart(read, cpu_s=1)
    assert children() <= before  # other tests may have processes of their own
