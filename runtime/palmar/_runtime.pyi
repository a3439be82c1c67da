"""The C++ core. Its doors are few: trace files, replay, and one solver session."""

from collections.abc import Callable
from typing import Any

import numpy as np

def write_trace(path: str, header: dict[str, str], columns: dict[str, np.ndarray]) -> None:
    """Columns as in `palmar.records.Trace`; has_object_pose and the object pose may be left out. Raises BadTrace."""

def read_trace(path: str) -> tuple[dict[str, str], dict[str, np.ndarray], dict[str, int]]:
    """Header, columns, and what was lost (all zero for a sound file). Raises BadTrace."""

def read_run(path: str) -> tuple[dict[str, str], dict[str, np.ndarray], dict[str, int]]:
    """Header, columns as in `palmar.records.Run`, and what was lost. Raises BadTrace."""

def resample(
    header: dict[str, str], columns: dict[str, np.ndarray], method: str, rate_hz: float
) -> dict[str, np.ndarray]:
    """The columns of a trace on a uniform grid: what a replay steps on. method: "hold", "linear" or "pchip".

    Raises BadTrace, PalmarError.
    """

def replay(
    pack: str,
    trace: str,
    out: str,
    object: str,
    settings: dict[str, Any],
    header: dict[str, str],
    progress: Callable[[int, int], bool] | None = None,
) -> dict[str, Any]:
    """Replay a trace on a pack's object ("" for the only one); `header` is stored beside what replay itself knows.

    settings: see `default_settings()`; an unknown key raises. progress(done, total) is called now and then; False
    stops and writes nothing. Returns counts: steps, and steps by status. Raises BadPack, BadTrace, PalmarError.
    """

def default_settings() -> dict[str, Any]:
    """Every setting with its default."""

def solver_names() -> list[str]: ...
def build_info() -> dict[str, str]:
    """Compiler, flags, version, instruction sets: what makes two builds the same."""

class Session:
    """A pack's hand and one object, settings, and the last verified pose."""

    def __init__(self, pack: str, object: str = "", settings: dict[str, Any] = ...) -> None: ...
    def step(
        self,
        time_s: float,
        palm_position_m: np.ndarray,
        palm_rotation_wxyz: np.ndarray,
        flexion_rad: np.ndarray,
        abduction_rad: np.ndarray,
        tracked: bool = True,
        object_position_m: np.ndarray | None = None,
        object_rotation_wxyz: np.ndarray | None = None,
    ) -> dict[str, Any]:
        """One step towards the haptic hand given: one row of `palmar.records.Run`, `contacts` as a list of dicts."""
