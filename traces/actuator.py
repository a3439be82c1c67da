"""Forces of the solver as what a glove's actuators can do, finger by finger: capped, quantised, limited in rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from palmar.errors import PalmarError
from palmar.model import Array
from palmar.traces.columns import nearest
from palmar.traces.opengloves import FORCE_FULL_SCALE

ALLOWED = {
    "cap_n": (0.01, 1000.0),
    "rate_n_per_s": (0.0, 1e6),
    "quantum_n": (0.0, 100.0),
}


@dataclass(frozen=True)
class Actuator:
    """What one finger's actuator can do. Defaults: a servo that stops the finger, full scale at 20 N."""

    cap_n: float = 20.0  # the force that the full scale stands for; more is clipped
    brake_only: bool = True  # it can hold a finger back from closing, and push nothing
    rate_n_per_s: float = 0.0  # change of force; 0: at once. Letting go for safety is always at once
    quantum_n: float = 0.0  # step of force, rounded down; 0: that of the full scale


def actuator_of(values: Mapping[str, Any]) -> Actuator:
    """From `key=value`. Raises PalmarError E-CONF that names the key and what is allowed."""
    known = [field.name for field in fields(Actuator)]
    for key, value in values.items():
        where = f"--actuator {key}"
        if key not in known:
            raise PalmarError("E-CONF", where, f"unknown key{nearest(key, known)}; known are {', '.join(known)}")
        if key == "brake_only":
            if not isinstance(value, bool):
                raise PalmarError("E-CONF", where, f"{value!r}; true or false is allowed")
            continue
        low, high = ALLOWED[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise PalmarError("E-CONF", where, f"{value!r}; {low:g} to {high:g} is allowed")
    return Actuator(**values)


class Feedback:
    """Five levels from 0, free, to 1000, blocked, from the solver's answers."""

    def __init__(self, actuator: Actuator) -> None:
        self.actuator = actuator
        self.largest_n = 0.0  # asked for by the solver
        self.clipped = 0  # answers with a finger above the cap
        self._force_n = np.zeros(5)
        self._time_s: float | None = None

    def levels(self, time_s: float, tip_force_n: Array, joint_torque_n_m: Array) -> list[int]:
        """tip_force_n: (5, 3), on the user. joint_torque_n_m: (5, 3), positive closes. Not finite is no force."""
        asked = np.linalg.norm(tip_force_n, axis=1)
        asked = np.where(np.isfinite(asked), asked, 0.0)
        if self.actuator.brake_only:
            asked = np.where(joint_torque_n_m.sum(axis=1) <= 0, asked, 0.0)
        self.largest_n = max(self.largest_n, float(asked.max()))
        self.clipped += bool((asked > self.actuator.cap_n).any())
        force = np.clip(asked, 0.0, self.actuator.cap_n)
        passed = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        if self.actuator.rate_n_per_s > 0:
            most = self.actuator.rate_n_per_s * passed
            force = np.clip(force, self._force_n - most, self._force_n + most)
        self._force_n, self._time_s = force, time_s
        if self.actuator.quantum_n > 0:
            # The tiny share keeps a whole number of steps from being taken for just below it.
            force = np.floor(force / self.actuator.quantum_n + 1e-9) * self.actuator.quantum_n
        return [round(f) for f in np.clip(force / self.actuator.cap_n * FORCE_FULL_SCALE, 0, FORCE_FULL_SCALE)]

    def let_go(self) -> None:
        """No force, at once; the next grows from none."""
        self._force_n, self._time_s = np.zeros(5), None
