"""A hand with mass on the other side of the loop: the force that is computed moves the hand that is sampled.

`python tests/runtime/closed_loop.py` prints for hands, delays and rates the stiffness at which the loop begins to
swing, of the solver's hand on a plate and of an ideal spring of the same stiffness beside it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmar import _runtime
from palmar.model import AssetPack, save_pack
from palmar.tools.hand_file import default_hand
from palmar.tools.lattice import scene_object

PLATE = {"kind": "plate", "radius_m": 0.003, "pitch_m": 0.003, "width_m": 0.2, "length_m": 0.24}
STEP_S = 0.001
MASS_KG = 0.1
PRESS_M = 0.005  # how deep the hand would like to be
START_M = 0.03


@dataclass(frozen=True)
class Loop:
    """The user's arm, and what lies between hand and solver."""

    spring_n_per_m: float  # that pulls the hand to where it wants to be
    damper_n_s_per_m: float
    delay_s: float = 0.0
    rate_hz: float = 1000.0  # of the samples; held between
    quantum_n: float = 0.0  # steps in which the force is given
    gain: float = 1.0  # of the force: changes the stiffness that is felt


def swing(loop: Loop, force_of: Callable[[float, float], float], touch_m: float, lasts_s: float) -> np.ndarray:
    """Heights of the hand, (n,) metres, from START_M above where it touches. force_of(time_s, height_m): N, upwards."""
    wanted = touch_m - PRESS_M
    height, speed, held = touch_m + START_M, 0.0, touch_m + START_M
    waiting = [0.0] * (round(loop.delay_s / STEP_S) + 1)
    heights = []
    for step in range(round(lasts_s / STEP_S)):
        time_s = step * STEP_S
        if step == 0 or np.floor(time_s * loop.rate_hz + 1e-9) != np.floor((time_s - STEP_S) * loop.rate_hz + 1e-9):
            held = height
        force = loop.gain * force_of(time_s, held)
        if loop.quantum_n:
            force = loop.quantum_n * round(force / loop.quantum_n)
        waiting.append(force)
        felt = waiting.pop(0)
        # Ten steps of the hand in one of the solver.
        for _ in range(10):
            pull = loop.spring_n_per_m * (wanted - height) - loop.damper_n_s_per_m * speed + felt
            speed += 0.1 * STEP_S * pull / MASS_KG
            height += 0.1 * STEP_S * speed
        heights.append(height)
    return np.array(heights)


def solver_force(pack: Path) -> Callable[[float, float], float]:
    """The solver's force on the palm, upwards, for a hand that lies on its back at a height over the plate."""
    session = _runtime.Session(str(pack), "plate", {})
    flexion = np.tile([0.1, 0.1, 0.05], (5, 1))

    def force_of(time_s: float, height_m: float) -> float:
        answer = session.step(
            time_s,
            np.array([-0.02, -0.09, height_m]),
            np.array([0.0, 0.0, 1.0, 0.0]),  # on its back: the palm touches first, and not the thumb
            flexion,
            np.zeros(5),
        )
        return float(answer["palm_force_n"][2])

    return force_of


def measure_wall(pack: Path) -> tuple[float, float]:
    """Height at which the hand touches the plate, and the stiffness that it then feels, N/m."""
    force_of = solver_force(pack)
    heights = np.linspace(0.06, -0.02, 1601)
    forces = np.array([force_of(STEP_S * k, float(height)) for k, height in enumerate(heights)])
    touched = int(np.argmax(forces > 0))
    rest = [force_of(2.0 + STEP_S * k, float(heights[touched] - PRESS_M / 2)) for k in range(200)][-1]
    return float(heights[touched - 1]), rest / (PRESS_M / 2)


def wall_force(touch_m: float, stiffness_n_per_m: float) -> Callable[[float, float], float]:
    """An ideal spring in place of the solver."""
    return lambda time_s, height_m: stiffness_n_per_m * max(0.0, touch_m - height_m)


def still_swings(heights: np.ndarray) -> float:
    """Peak to peak of the last quarter, metres."""
    return float(np.ptp(heights[-len(heights) // 4 :]))


def critical_gain(loop: Loop, make_force: Callable[[], Callable[[float, float], float]], touch_m: float) -> float:
    """The gain, up to 8, above which the hand still swings by 0.1 mm after three seconds; by bisection to 3 percent."""

    def swings(gain: float) -> bool:
        return still_swings(swing(Loop(**{**vars(loop), "gain": gain}), make_force(), touch_m, 3.0)) > 1e-4

    low, high = 0.01, 8.0
    if not swings(high):
        return high
    if swings(low):
        return low
    while high / low > 1.03:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if swings(middle) else (middle, high)
    return low


def make_pack(folder: Path) -> Path:
    pack = folder / "plate.pack"
    save_pack(pack, AssetPack(default_hand(), {"plate": scene_object(PLATE)}, {"tools": {}, "seed": 0}))
    return pack


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        pack = make_pack(Path(folder))
        touch_m, stiffness = measure_wall(pack)
        print(f"hand on its back on a plate: {stiffness:.0f} N/m felt, hand of {MASS_KG} kg")
        print("arm N/m  arm N s/m  delay ms  rate Hz  critical N/m, solver  critical N/m, ideal spring")
        for spring, damper in ((50.0, 1.0), (200.0, 3.0), (800.0, 10.0)):
            for delay_s, rate_hz in ((0.001, 1000.0), (0.005, 1000.0), (0.02, 1000.0), (0.001, 60.0)):
                loop = Loop(spring, damper, delay_s, rate_hz)
                ours = critical_gain(loop, lambda: solver_force(pack), touch_m)
                ideal = critical_gain(loop, lambda: wall_force(touch_m, stiffness), touch_m)
                row = f"{spring:7.0f}  {damper:9.0f}  {1e3 * delay_s:8.0f}  {rate_hz:7.0f}"
                print(f"{row}  {ours * stiffness:20.0f}  {ideal * stiffness:26.0f}", flush=True)


if __name__ == "__main__":
    main()
