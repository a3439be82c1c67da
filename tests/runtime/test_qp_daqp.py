"""The step's programme against DAQP, an active-set solver of other hands, on the families of made_programmes.h."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import daqp
import numpy as np
import pytest

PROGRAM = Path(__file__).resolve().parents[2] / "build" / "tests" / "test_qp"
SOURCE = Path(__file__).with_name("test_qp.cpp")
BUILT = PROGRAM.exists() and PROGRAM.stat().st_mtime > SOURCE.stat().st_mtime
TOLERANCE = 1e-9  # metres by which a row may be broken, in either solver
WITHOUT_ANSWER = {"closed wedge"}


def answers(program: Path) -> list[dict]:
    lines = subprocess.run([program, "--lines"], capture_output=True, check=True, text=True).stdout
    return [json.loads(line) for line in lines.splitlines()]


def daqp_answer(case: dict) -> tuple[np.ndarray | None, float]:
    """(x, sum of multipliers); x is None where DAQP says that there is none."""
    # In y = L' x with L L' the objective's matrix the objective is 1/2 |y - y_target|^2: no weights to lose digits
    # over. The bounds become rows like the others.
    root = np.linalg.cholesky(np.array(case["stiffness"])).T
    rows = np.array(case["rows"])
    everything = np.linalg.solve(root.T, np.vstack([np.eye(len(root)), rows[:, :-1]]).T).T
    y, _, flag, info = daqp.solve(
        np.eye(len(root)),
        -root @ np.array(case["target"]),
        np.ascontiguousarray(everything),
        np.concatenate([np.array(case["high"]), np.full(len(rows), 1e30)]),
        np.concatenate([np.array(case["low"]), rows[:, -1]]),
        primal_tol=TOLERANCE,
        iter_limit=10000,
    )
    return (np.linalg.solve(root, np.array(y)) if flag == 1 else None), float(np.abs(info["lam"]).sum())


def cost(case: dict, x: np.ndarray) -> float:
    way = x - np.array(case["target"])
    return float(0.5 * way @ np.array(case["stiffness"]) @ way)


def compare(program: Path) -> dict[str, Counter]:
    """Per family: how many have the same optimum, and how many differ in which way."""
    table: dict[str, Counter] = {}
    for case in answers(program):
        count = table.setdefault(case["family"], Counter())
        ours = np.array(case["x"]) if case["status"] == "solved" else None
        theirs, multipliers = daqp_answer(case)
        if ours is None or theirs is None:
            verdict = "none" if theirs is None else "some"
            count["both none" if ours is theirs else f"{case['status']}, DAQP {verdict}"] += 1
            continue
        rows = np.array(case["rows"])
        broken = float(np.max(rows[:, -1] - rows[:, :-1] @ ours))
        if broken > 2 * TOLERANCE:
            count["row broken"] += 1
        # A row that gives by the tolerance saves its multiplier times that; both may, and DAQP's rows are in scaled
        # units. 1e-9 of the cost for rounding.
        allowed = 4 * TOLERANCE * max(multipliers, case["multipliers"]) + 1e-9 * cost(case, theirs) + 1e-12
        difference = cost(case, ours) - cost(case, theirs)
        count["same optimum" if abs(difference) <= allowed else "worse" if difference > 0 else "better"] += 1
    return table


@pytest.mark.skipif(not BUILT, reason="build/tests/test_qp is missing or older than its source: make programs")
def test_the_optimum_is_daqps_and_what_has_an_answer_is_never_called_infeasible():
    table = compare(PROGRAM)
    assert len(table) >= 10
    for family, count in table.items():
        expected = "both none" if family in WITHOUT_ANSWER else "same optimum"
        assert set(count) == {expected}, f"{family}: {dict(count)}"
