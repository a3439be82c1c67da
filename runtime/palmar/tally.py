"""What the replays of one scene by one solver came to, and how it is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palmar.eval.metrics import margin_db, standing, worst_margin
from palmar.records import Run

FELT_N = 0.05  # a force below it says nothing of a contact

Row = dict[str, Any]


@dataclass
class Tally:
    """What the replays of one scene by one solver came to."""

    scene: str
    id: str
    solver: str
    runs: int = 0
    steps: int = 0
    failed: int = 0
    margin_db: float = float("inf")
    worst: Row | None = None  # the row that sets the margin, with its case and start
    fails: dict[str, Row] = field(default_factory=dict)  # METRIC STAT -> its worst row, with the number of runs
    figures: dict[str, float] = field(default_factory=dict)  # METRIC STAT -> the largest value
    contact_steps: dict[str, int] = field(default_factory=dict)  # of each case
    end_force_n: list[list[float]] = field(default_factory=list)  # of each run, the last on each fingertip
    end_palm_m: list[list[float]] = field(default_factory=list)  # of each run, the last place of the palm shown
    why: str = ""
    moment: Row | None = None  # of the run that set the margin, if a matrix is to be drawn

    @property
    def passed(self) -> bool:
        return self.worst is not None and not self.fails and not self.untouched

    @property
    def untouched(self) -> list[str]:
        """Cases in which the hand never met the object: they would show nothing."""
        return [case for case, steps in self.contact_steps.items() if not steps]

    def see(self, run: Run, case: str) -> None:
        """Count a run's steps and contacts, whatever its metrics say."""
        self.runs, self.steps = self.runs + 1, self.steps + len(run.time_s)
        # A solver may report no contact where it sinks in; a force then still tells that the hand was stopped.
        force_n = np.linalg.norm(np.hstack([run.fingertip_force_n.reshape(-1, 15), run.palm_force_n]), axis=1)
        met = (run.contacts > 0) | (force_n > FELT_N)
        self.contact_steps[case] = self.contact_steps.get(case, 0) + int(met.sum())
        self.end_force_n.append(np.linalg.norm(run.fingertip_force_n[-1], axis=1).tolist())
        self.end_palm_m.append(run.palm_position_m[-1].tolist())

    def compare_ends(self, force_limit_n: float | None, place_limit_m: float | None) -> None:
        """Add how far the last forces and places of the runs are from those of the first, where there is a limit."""
        if force_limit_n is not None:
            spread = float(np.abs(np.array(self.end_force_n) - self.end_force_n[0]).max())
            self.take(
                [row_of("end_force_spread", "N", spread, force_limit_n)], "all cases", 0, ["end_force_spread value"]
            )
        if place_limit_m is not None:
            apart_m = np.linalg.norm(np.array(self.end_palm_m) - self.end_palm_m[0], axis=1).max()
            row = row_of("end_place_spread", "mm", 1e3 * float(apart_m), 1e3 * place_limit_m)
            self.take([row], "all cases", 0, ["end_place_spread value"])

    def take(self, rows: list[Row], case: str, start: int, asked: Sequence[str]) -> bool:
        """Add the rows of one run; whether it set a new worst margin."""
        at = {"case": case, "start": start}
        above = [row for row in rows if row["limit"] is not None and row["value"] > row["limit"]]
        self.failed += bool(above)
        for row in above:
            name = f"{row['metric']} {row['stat']}"
            before = self.fails.get(name)
            worse = before is None or row["value"] / max(row["limit"], 1e-9) > before["value"] / max(
                before["limit"], 1e-9
            )
            runs = before["runs"] + 1 if before else 1
            self.fails[name] = {**({**row, **at} if before is None or worse else before), "runs": runs}
        for row in rows:
            name = f"{row['metric']} {row['stat']}"
            if name in asked and row["value"] is not None:
                self.figures[name] = max(row["value"], self.figures.get(name, row["value"]))
        score = worst_margin(rows)
        if score is None:
            return False
        # Of two margins without bound the larger value is the worse.
        if self.worst is not None:
            so_far = standing(self.margin_db, self.worst), -self.worst["value"]
            if (standing(*score), -score[1]["value"]) >= so_far:
                return False
        self.margin_db, self.worst = score[0], {**score[1], **at}
        return True

    def told(self) -> dict[str, Any]:
        """As in check.json; a margin without bound is null."""
        told = dict(vars(self))
        told["margin_db"] = self.margin_db if abs(self.margin_db) < float("inf") else None
        told["passed"], told["untouched"] = self.passed, self.untouched
        del told["end_force_n"], told["end_palm_m"], told["moment"]
        return told

    def line(self) -> str:
        """One line for a person: what held by how much, or what failed where."""
        touched = sum(self.contact_steps.values()) / max(self.steps, 1)
        head = f"{self.id:<4} {self.scene:<20} {self.solver:<12} {self.runs:>4} runs, {touched:>3.0%} contact "
        if self.worst is None:
            return f"{head} nothing that has a limit could be measured"
        parts = [_say_fail(name, row) for name, row in self.fails.items()]
        if self.untouched:
            parts.append(f"no contact in {len(self.untouched)} cases ({self.untouched[0]})")
        if parts:
            said = f"FAILS {self.failed}: " + "; ".join(parts)
        else:
            said = f"{_decibels(self.margin_db)} {self.worst['metric']} {self.worst['stat']} {_say_value(self.worst)}"
        shown = ", ".join(f"{name} {value:.4g}" for name, value in self.figures.items())
        return f"{head} {said}{f' | {shown}' if shown else ''}"


def row_of(name: str, unit: str, value: float, limit: float) -> Row:
    """A number that a scene asks for beside those of eval, in the form of theirs."""
    found = {"metric": name, "stat": "value", "unit": unit, "value": value, "limit": limit}
    return {**found, "margin_db": margin_db(value, limit)}


def _say_fail(name: str, row: Row) -> str:
    where = ", ".join(part for part in (row["case"], f"start {row['start']}") if part)
    return f"{name} {_say_value(row)} above {row['limit']:.4g} in {row['runs']} ({where})"


def _say_value(row: Row) -> str:
    return f"{row['value']:.4g}{'' if row['unit'] == '1' else ' ' + row['unit']}"


def _decibels(margin: float) -> str:
    return f"{margin:+.1f} dB" if abs(margin) < float("inf") else "all kept:"
