"""Work on a stranger's file in a process of its own, with an end to the memory and the time that it may take."""

from __future__ import annotations

import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh

OUT_OF_MEMORY = 12  # exit code of the child
Arrays = Sequence[NDArray[np.generic]]


def read_apart(where: str, read: Callable[[], Arrays], *, memory_bytes: int, cpu_s: int) -> list[NDArray[np.generic]]:
    """What `read` gives, worked out in a child of this process; a BadMesh of it is raised here.

    memory_bytes: that it may take beside what this process has; cpu_s: of processor time. Raises BadMesh E-MESH-LIMIT
    where it wants more, E-MESH-FORMAT where it is killed otherwise. On systems without fork it runs here, unlimited.
    """
    if not sys.platform.startswith("linux"):
        return list(read())
    into, out = os.pipe()
    with warnings.catch_warnings():
        # Of other threads that may hold a lock: the child takes none of theirs, and never comes back.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        os.close(into)
        _child(read, os.fdopen(out, "wb"), memory_bytes, cpu_s)
    os.close(out)
    try:
        with os.fdopen(into, "rb") as answer:
            found = _answer(answer)
    finally:
        status = os.waitpid(child, 0)[1]
    if isinstance(found, BadMesh):
        raise found
    if found is None:
        raise _ended(where, status, memory_bytes, cpu_s)
    return found


def _child(read: Callable[[], Arrays], out: BinaryIO, memory_bytes: int, cpu_s: int) -> None:
    """Write a line of JSON and the arrays, then end without any of this process's own tidying up."""
    import resource

    try:
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + memory_bytes
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            arrays = [np.ascontiguousarray(array) for array in read()]
            out.write(json.dumps({"arrays": [[array.dtype.str, array.shape] for array in arrays]}).encode() + b"\n")
            for array in arrays:
                out.write(array.data)
        except BadMesh as error:
            out.write(json.dumps({"error": [error.code, error.where, error.message]}).encode() + b"\n")
        out.flush()
        os._exit(0)
    except MemoryError:
        os._exit(OUT_OF_MEMORY)
    finally:
        os._exit(1)


def _answer(answer: BinaryIO) -> list[NDArray[np.generic]] | BadMesh | None:
    """What the child wrote; None if it did not come to its end."""
    try:
        head = json.loads(answer.readline())
        if "error" in head:
            return BadMesh(*head["error"])
        arrays = []
        for dtype, shape in head["arrays"]:
            array = np.empty(shape, dtype)
            raw = answer.read(array.nbytes)
            array.reshape(-1)[:] = np.frombuffer(raw, dtype)
            arrays.append(array)
        return arrays
    except ValueError:
        return None


def _ended(where: str, status: int, memory_bytes: int, cpu_s: int) -> BadMesh:
    by = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if by == signal.SIGXCPU:
        return BadMesh("E-MESH-LIMIT", where, f"reading it took more than {cpu_s} s of processor time")
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) == OUT_OF_MEMORY:
        return BadMesh("E-MESH-LIMIT", where, f"reading it took more than {memory_bytes >> 20} MiB")
    how = f"signal {by}" if by else f"exit code {os.WEXITSTATUS(status)}"
    return BadMesh("E-MESH-FORMAT", where, f"its reader crashed ({how})")
