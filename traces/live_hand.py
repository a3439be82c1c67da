"""The solver on the hand that is being recorded, and the force that goes back to its fingers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from palmar._runtime import Session
from palmar.traces.actuator import Actuator, Feedback
from palmar.traces.opengloves import encode_force
from palmar.traces.pose_stream import Placed


class LiveHand:
    """One solver step for each line of the glove. Without an actuator nothing is sent back."""

    def __init__(self, pack: Path, object: str, settings: dict[str, Any], actuator: Actuator | None) -> None:
        self._session = Session(str(pack), object, settings)
        self._feedback = None if actuator is None else Feedback(actuator)
        self.levels: list[int] = []  # of the last step; empty where there is nothing to send
        self._steps = self._in_contact = 0

    def step(self, time_s: float, placed: Placed, flexion_rad: list[float], abduction_rad: list[float]) -> None:
        """15 flexions and 5 abductions. Times must rise."""
        position, rotation = np.array(placed.position_m), np.array(placed.rotation_wxyz)
        answer = self._session.step(time_s, position, rotation, np.array(flexion_rad), np.array(abduction_rad))
        self._steps += 1
        self._in_contact += bool(answer["contacts"])
        if self._feedback is not None:
            self.levels = self._feedback.levels(time_s, answer["fingertip_force_n"], answer["joint_torque_n_m"])

    def command(self) -> bytes:
        return encode_force(self.levels)

    def let_go(self) -> None:
        self.levels = []
        if self._feedback is not None:
            self._feedback.let_go()

    @property
    def counts(self) -> dict[str, Any]:
        counts: dict[str, Any] = {"steps": self._steps, "in contact": self._in_contact}
        if self._feedback is not None:
            counts |= {"largest_n": self._feedback.largest_n, "above the cap": self._feedback.clipped}
        return counts
