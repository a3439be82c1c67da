"""Trace and Run as columns: what the glove said and what the solver answered. Format: docs/formats.md."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar import _runtime

Array = NDArray[np.float64]

# Bits of a step's status. 0 is the plain answer; every other bit says why the step was hard.
STATUS = {
    1: "recovering",  # the hand started inside, was lost or let go; forces grow back
    2: "iteration_limit",  # the operation budget ended before the pose converged
    4: "yielded",  # a finger was blocked and the palm, the wrist or an abduction gave way
    8: "kept_previous",  # no better pose could be verified; the last one stays
    16: "bad_sample",  # the sample was not usable (lost tracking, not finite); the last good one stays
    32: "limit",  # a joint limit of the hand model clipped the sample
    64: "releasing",  # the hand was left behind and is led round the object; no force
    128: "contacts_cut",  # the step's list of contacts has no room for all of them
}


@dataclass(frozen=True)
class Trace:
    """Samples of the haptic hand in order, n of them, and the header."""

    header: dict[str, str]
    time_s: Array  # (n,)
    palm_position_m: Array  # (n, 3)
    palm_rotation_wxyz: Array  # (n, 4)
    flexion_rad: Array  # (n, 5, 3)
    abduction_rad: Array  # (n, 5)
    tracked: NDArray[np.bool_]  # (n,)
    has_object_pose: NDArray[np.bool_]  # (n,)
    object_position_m: Array  # (n, 3)
    object_rotation_wxyz: Array  # (n, 4)
    lost: dict[str, int] = field(default_factory=dict)  # what a damaged file had lost: bytes, chunks, messages

    @property
    def phases(self) -> list[dict[str, Any]]:
        return json.loads(self.header.get("phases", "[]"))


@dataclass(frozen=True)
class Run:
    """StepResults in order, n of them. Contacts of step i are rows contact_start[i] to contact_start[i + 1]."""

    header: dict[str, str]
    time_s: Array  # (n,)
    status: NDArray[np.uint32]  # (n,)
    palm_position_m: Array  # (n, 3) graphic
    palm_rotation_wxyz: Array  # (n, 4)
    flexion_rad: Array  # (n, 5, 3)
    abduction_rad: Array  # (n, 5)
    haptic_palm_position_m: Array  # (n, 3)
    haptic_palm_rotation_wxyz: Array  # (n, 4)
    haptic_flexion_rad: Array  # (n, 5, 3)
    haptic_abduction_rad: Array  # (n, 5)
    object_position_m: Array  # (n, 3)
    object_rotation_wxyz: Array  # (n, 4)
    palm_force_n: Array  # (n, 3)
    palm_torque_n_m: Array  # (n, 3)
    joint_torque_n_m: Array  # (n, 5, 3)
    fingertip_force_n: Array  # (n, 5, 3)
    equation14_force_n: Array  # (n, 5, 3)
    contacts: NDArray[np.uint32]  # (n,)
    operations: NDArray[np.uint32]  # (n,)
    state_hash: NDArray[np.uint64]  # (n,)
    cpu_us: Array  # (n,)
    wall_us: Array  # (n,)
    search_us: Array  # (n,)
    solve_us: Array  # (n,)
    verify_us: Array  # (n,)
    contact_start: NDArray[np.int64]  # (n + 1,)
    contact_link: NDArray[np.uint8]  # (c,)
    contact_object_sphere: NDArray[np.uint32]  # (c,)
    contact_palm_sphere: NDArray[np.uint32]  # (c,)
    contact_gap_m: Array  # (c,)
    contact_force_n: Array  # (c,)
    contact_point_m: Array  # (c, 3)
    contact_normal: Array  # (c, 3)
    lost: dict[str, int] = field(default_factory=dict)

    @property
    def phases(self) -> list[dict[str, Any]]:
        return json.loads(self.header.get("phases", "[]"))


def read_trace(path: str | Path) -> Trace:
    """Read a trace, as far as it is whole; `lost` counts what was not. Raises BadTrace if nothing can be read."""
    header, columns, lost = _runtime.read_trace(str(path))
    return Trace(header=header, lost=lost, **columns)


def write_trace(path: str | Path, trace: Trace) -> None:
    """Write a trace; the file appears whole or not at all. Raises BadTrace if a sample breaks the format."""
    columns = {name: getattr(trace, name) for name in Trace.__dataclass_fields__ if name not in ("header", "lost")}
    _runtime.write_trace(str(path), trace.header, columns)


def read_run(path: str | Path) -> Run:
    """Read a run, as far as it is whole; `lost` counts what was not. Raises BadTrace if nothing can be read."""
    header, columns, lost = _runtime.read_run(str(path))
    return Run(header=header, lost=lost, **columns)
