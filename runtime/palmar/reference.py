"""The converged coupled solution that a run's answers are compared with: same hand, same object, any time it takes.

Palm, wrist, abduction and fingers count with their stiffness alone, and a step goes on until it has converged. Only the
run and its pack are needed: the run holds the haptic hand of every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar._runtime import Session
from palmar.records import STATUS, Run

CONVERGED: dict[str, Any] = {
    "solver": "progressive",
    "palm_priority": 1.0,
    "imposed_priority": 1.0,
    "iterations": 200,
    "joint_step_rad": 100.0,
}
MOST_STEPS = 300  # each opens a session of its own, some 4 ms at 3,000 spheres
REPEATS = 20
POSE = ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad")
BITS = {name: bit for bit, name in STATUS.items()}

Progress = Callable[[float], None]


def same_start(run: Run, pack: Path, progress: Progress = lambda fraction: None) -> Run:
    """Answers to at most MOST_STEPS steps, each from the pose that `run` had one step before; NaN poses elsewhere.

    Steps are spread evenly over those with a force. One is left out where the solver cannot start from that pose, since
    it sinks in; where that is every other step or more none is answered, for the rest would not speak for the run.
    Raises BadPack, PalmarError.
    """
    answer = _empty(run)
    pushed = np.flatnonzero(_is_pushed(run)[1:] & (run.status[1:] & BITS["bad_sample"] == 0)) + 1
    steps = np.unique(pushed[np.linspace(0, len(pushed) - 1, min(MOST_STEPS, len(pushed))).astype(int)])
    for done, i in enumerate(steps):
        session = _session(run, pack)
        before = _step(session, 0.0, [getattr(run, name)[i - 1] for name in POSE], run, i - 1)
        if all(np.allclose(before[name], getattr(run, name)[i - 1], rtol=0, atol=1e-9) for name in POSE):
            _store(answer, i, _converge(session, run, i))
        progress((done + 1) / len(steps))
    answered = np.isfinite(answer.palm_position_m[steps]).all(axis=1)
    return answer if answered.sum() > len(steps) / 2 else _empty(run)


def _session(run: Run, pack: Path) -> Session:
    return Session(str(pack), run.header.get("object", ""), CONVERGED | {"level": int(run.header.get("level", -1))})


def _is_pushed(run: Run) -> NDArray[np.bool_]:
    """(n,) whether anything holds the graphic hand off the haptic one, by a micrometre or a microradian."""
    apart = [np.abs(getattr(run, name) - getattr(run, f"haptic_{name}")) for name in POSE]
    return np.hstack([each.reshape(len(run.time_s), -1) for each in apart]).max(axis=1) > 1e-6


def _converge(session: Session, run: Run, i: int) -> dict[str, Any]:
    asked = [getattr(run, f"haptic_{name}")[i] for name in POSE]
    for _ in range(REPEATS):
        answer = _step(session, float(run.time_s[i]), asked, run, i)
        if not answer["status"] & BITS["iteration_limit"]:
            break
    return answer


def _step(session: Session, time_s: float, pose: list[Any], run: Run, i: int) -> dict[str, Any]:
    position, rotation, flexion, abduction = pose
    at, turn = run.object_position_m[i], run.object_rotation_wxyz[i]
    return session.step(time_s, position, rotation, flexion, abduction, object_position_m=at, object_rotation_wxyz=turn)


def _empty(run: Run) -> Run:
    """The run with poses that are not a number."""
    return replace(run, **{name: np.full_like(getattr(run, name), np.nan) for name in POSE})


def _store(answer: Run, i: int, row: dict[str, Any]) -> None:
    for name in POSE:
        getattr(answer, name)[i] = row[name]
