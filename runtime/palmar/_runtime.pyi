"""The C++ core. Its doors are few: trace files, replay, and one solver session."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

def write_trace(path: str, header: dict[str, str], columns: dict[str, np.ndarray]) -> None:
    """Columns as in `palmar.records.Trace`; has_object_pose and the object pose may be left out. Raises BadTrace."""

def read_trace(path: str) -> tuple[dict[str, str], dict[str, np.ndarray], dict[str, int]]:
    """Header, columns, and what was lost (all zero for a sound file). Raises BadTrace."""

def read_device_bytes(path: str) -> tuple[dict[str, str], list[tuple[float, bytes]]]:
    """Header of a trace, and the raw bytes in it, each with its time of arrival in seconds. Raises BadTrace."""

class DeviceRecording:
    """A trace that is written while a device is recorded, on a thread of its own. Readable at every moment.

    A quarter of a second is lost at most if the process is killed. Values have to be storable and times of samples to
    rise. Raises BadTrace, every method E-TRACE-WRITE once the disk took no more.
    """

    def __init__(self, path: str, header: dict[str, str]) -> None: ...
    def add_sample(
        self,
        time_s: float,
        tracked: bool,
        palm_position_m: Sequence[float],
        palm_rotation_wxyz: Sequence[float],
        flexion_rad: Sequence[float],
        abduction_rad: Sequence[float],
    ) -> None:
        """3, 4, 15 and 5 numbers."""

    def add_reading(
        self,
        time_s: float,
        flexion: Sequence[float],
        abduction: Sequence[float],
        joystick: Sequence[float],
        trigger: float,
        buttons: int,
    ) -> None:
        """15, 5 and 2 numbers, as shares of the device's full scale."""

    def add_device_bytes(self, time_s: float, content: bytes) -> None: ...
    def add_pose_bytes(self, time_s: float, content: bytes) -> None: ...
    def close(self, end: dict[str, str]) -> None:
        """end: what is known of the whole only now; readers find it in the header."""

    @property
    def dropped(self) -> int:
        """Messages for which a disk that stalled for long left no room."""

def recover_trace(
    path: str, out: str, spare: dict[str, str]
) -> tuple[dict[str, str], float, dict[str, int], dict[str, int]]:
    """Write what is sound of a damaged trace, all that a recording keeps, to `out`, and hold that against it.

    A message with values that break the format is left out and counted. spare: header to use where the file's own is
    damaged; empty for none. Gives the header, the duration, s, how many of each kind of message there are, and what was
    lost. Raises BadTrace.
    """

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

def union_nearest(spheres: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least |point - centre| - radius (n,) over spheres (m, 4), and the sphere (n,) that has it.

    The distance to the union where positive; 0 or below is inside.
    """

def union_exits(spheres: np.ndarray, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays along unit directions (n, 3) leave the union first: lengths (n,), and the spheres (n,) left there.

    0 and -1 for a point outside.
    """

def union_skin(
    spheres: np.ndarray, offset: float, spacing: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples of the skin of spheres (m, 4) grown by offset: sphere (n,), direction (n, 3), solid angle (n,)."""

def radii_to_cover(spheres: np.ndarray, vertices: np.ndarray, faces: np.ndarray, finest: float) -> np.ndarray:
    """Radii (m,), none less than before, with which the spheres (m, 4) cover every point of the triangles.

    A triangle with its corners in one sphere is covered; others are cut in four, until that spares a sphere less than
    `finest`.
    """

def bound_tree(spheres: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Balls over spheres (n, 4), each with at most 8 children and containing them in float64 and float32.

    Few of them are met by a ball of radius `reach`. Returns an order (n,) of the spheres in which branches stand
    together, and in that order the ball that holds each (n,); the balls (m, 4), root first, and each one's parent (m,).
    """

class TriangleTree:
    """Exact distances to a mesh: vertices (v, 3) and faces (f, 3), int64."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None: ...
    def shoot(
        self, points: np.ndarray, inward: np.ndarray, faces: np.ndarray, slack: float, start: float
    ) -> np.ndarray:
        """Centres and inside distances (k, 4), k <= n, of the largest balls tangent at surface points (n, 3).

        The surface enters a ball by at most slack; they are shrunk from the radius start. inward (n, 3): unit normals;
        faces (n,): on which the points lie.
        """

    def distances(self, centers: np.ndarray) -> np.ndarray:
        """The centres (n, 3) and their distance to the surface, without a sign: (n, 4)."""

def held_inside(zones: list[tuple[TriangleTree, float]], balls: np.ndarray, excess: float) -> np.ndarray:
    """What balls (n, 4), centre and inside distance, count with (n,): grown by `excess`, they stick out of no zone by
    more than its share of that."""

class CoverFit:
    """Balls (centre, inside distance) moved and exchanged until few surface samples have a gap above a budget.

    The gap of a sample is the least of |sample - centre| - inside over all balls; it costs 0 up to the budget's low
    end, 1 from its high end on. Same seed, same result, for any number of threads. zones: parts of the surface with
    the share of the error that each allows; zone (n,): of each sample, 0 for none, k + 1 for zones[k].
    """

    def __init__(
        self,
        tree: TriangleTree,
        zones: list[tuple[TriangleTree, float]],
        points: np.ndarray,
        inward: np.ndarray,
        faces: np.ndarray,
        zone: np.ndarray,
        seed: int,
        threads: int,
    ) -> None: ...
    def set_balls(self, tree: TriangleTree, balls: np.ndarray, fixed: int = 0) -> None:
        """Balls (n, 4), of which the first `fixed` stay where they are."""

    def balls(self) -> np.ndarray: ...
    def set_budget(self, low: float, high: float, excess: float) -> None:
        """excess: what the balls will be grown by; a zone gets its share of it, and of what its samples may lie out."""

    def quantile(self, share: float) -> float:
        """The gap that this share of each zone's samples does not exceed, if below the budget's high end."""

    def polish(self, step: float, moves: int, temperature: float) -> int:
        """Each ball tries `moves` places up to `step` discs away. Returns how many moved."""

    def exchange(self, trials: int, candidates: int) -> int:
        """Puts balls of little use where samples are bare. Returns how many."""

    def remove(self, count: int) -> None:
        """Takes the `count` balls of least use out."""

    def remove_useless(self) -> None:
        """Takes balls out without which no sample costs more."""

    def add(self, count: int, candidates: int) -> int:
        """Puts up to `count` balls where samples are bare. Returns how many."""
