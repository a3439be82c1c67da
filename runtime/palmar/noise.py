"""How quiet the machine is: a fixed piece of work, timed before, between and after what is to be measured."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

REPEATS = 40
WORK = 12_000  # additions: about half a millisecond
# Beyond these a time of this sitting says little of another: drift of the least, spread of the times, waiting.
MOST_DRIFT, MOST_SPREAD, MOST_WAIT = 0.05, 0.10, 0.10


def kernel() -> dict[str, float]:
    """The work done REPEATS times: least and median us of thread CPU time, and wall time by CPU time of all."""
    cpu, wall = [], []
    for _ in range(REPEATS):
        start, began = time.thread_time_ns(), time.perf_counter_ns()
        total = 0
        for k in range(WORK):
            total += k * k
        cpu.append((time.thread_time_ns() - start) / 1e3)
        wall.append((time.perf_counter_ns() - began) / 1e3)
    return {"least_us": min(cpu), "median_us": float(np.median(cpu)), "wall_by_cpu": sum(wall) / sum(cpu)}


def noise_note(kernels: Sequence[dict[str, float]]) -> str:
    """What the kernels of a sitting say of its times; "" if the machine was quiet."""
    least = [each["least_us"] for each in kernels]
    drift = max(least) / min(least) - 1
    spread = max(each["median_us"] / each["least_us"] for each in kernels) - 1
    wait = max(each["wall_by_cpu"] for each in kernels) - 1
    said = []
    if drift > MOST_DRIFT:
        said.append(f"a fixed piece of work took {drift:.0%} longer at one time than at another")
    if spread > MOST_SPREAD:
        said.append(f"its median was {spread:.0%} above its least time")
    if wait > MOST_WAIT:
        said.append(f"it waited for the processor {wait:.0%} of the time that it worked")
    return f"The machine was noisy: {'; '.join(said)}." if said else ""
