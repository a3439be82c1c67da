"""Where the palm is while a glove is recorded that says nothing of it: one place, a script, or the keyboard.

A second device that sends poses is in `pose_stream`. All of them have the same few members: `about`, a sentence for
the trace; `files`, what to wait for; `receive(time_s)`, which gives the raw bytes that came; `at(time_s)`, the pose at
a time of the recording, final up to `newest_s` or once `wait_s` has passed; `counts`; `close`.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from palmar.errors import PalmarError
from palmar.model import Array, HandModel
from palmar.records import Trace, read_trace
from palmar.traces.columns import nearest
from palmar.traces.pose_stream import Placed, PoseStream, between, unit_pose

KEY_STEP_M = 0.005
KEY_STEP_RAD = 0.05
KEY_SPEED_M_PER_S = 0.2  # at which the palm follows the keys, so that a key is a motion and no jump
KEY_SPEED_RAD_PER_S = 2.0
# Of the world's axes: what a key adds to the target.
KEYS: dict[str, tuple[int, float]] = {
    **{"d": (0, 1.0), "a": (0, -1.0), "w": (1, 1.0), "s": (1, -1.0), "r": (2, 1.0), "f": (2, -1.0)},
    **{"i": (3, 1.0), "k": (3, -1.0), "u": (4, 1.0), "o": (4, -1.0), "l": (5, 1.0), "j": (5, -1.0)},
}


class PoseSource(Protocol):
    about: str
    wait_s: float
    newest_s: float

    @property
    def files(self) -> list[int]: ...
    @property
    def counts(self) -> dict[str, Any]: ...
    def receive(self, time_s: float) -> bytes: ...
    def at(self, time_s: float) -> Placed: ...
    def close(self) -> None: ...


def open_pose(text: str, hand: HandModel, *, offset_s: float = 0.0, mount: str = "", baud: int = 115200) -> PoseSource:
    """The source that `--pose` names. Raises PalmarError, GloveError, BadTrace.

    constant[:X,Y,Z[,W,QX,QY,QZ]]; keyboard; a scene of kind keys or random (TOML); a trace, whose palm is taken; else a
    stream: udp://HOST:PORT, or what `--port` takes. offset_s, mount: of a stream, see `PoseStream`.
    """
    kind, _, rest = text.partition(":")
    if kind not in ("constant", "keyboard") and Path(text).suffix not in (".toml", ".mcap"):
        if not text.startswith(("/", "./", "usb:")) and "://" not in text:
            known = ["constant", "keyboard"]
            kinds = "constant, keyboard, a .toml or .mcap file, udp://, socket://, usb: or the path of a port"
            raise PalmarError("E-CONF", "--pose", f"{text!r}{nearest(text, known)}; {kinds} is allowed")
        return PoseStream(text, offset_s=offset_s, mount=unit_pose("--pose-mount", mount), baud=baud)
    for flag, given in (("--pose-offset-ms", offset_s), ("--pose-mount", mount)):
        if given:
            raise PalmarError("E-USAGE", flag, f"is for a stream of poses; --pose is {text}")
    if kind == "constant":
        return ConstantPose(unit_pose("--pose", rest))
    if kind == "keyboard":
        return KeyboardPose()
    if Path(text).suffix == ".mcap":
        return PlayedPose(read_trace(text), f"the palm of {Path(text).name}")
    return _scene_pose(text, hand)


class ConstantPose:
    """One place for the whole recording."""

    wait_s = 0.0
    newest_s = math.inf

    def __init__(self, pose: tuple[Array, Array]) -> None:
        self._pose = Placed(pose[0].tolist(), pose[1].tolist(), True)
        place = ", ".join(f"{x:g}" for x in pose[0])
        self.about = f"The palm is taken to stand still, at {place} m: nothing measured it."

    @property
    def files(self) -> list[int]:
        return []

    @property
    def counts(self) -> dict[str, Any]:
        return {}

    def receive(self, time_s: float) -> bytes:
        return b""

    def at(self, time_s: float) -> Placed:
        return self._pose

    def close(self) -> None:
        pass


class PlayedPose(ConstantPose):
    """The palm of a trace, from the first sample of the recording on; its last pose is kept."""

    def __init__(self, trace: Trace, name: str) -> None:
        seen = trace.tracked
        self._time_s = trace.time_s[seen] - trace.time_s[seen][0]
        self._position, self._rotation = trace.palm_position_m[seen], trace.palm_rotation_wxyz[seen]
        self._start_s: float | None = None
        self.about = f"The palm is not measured: it follows {name}, from the first sample on."

    def at(self, time_s: float) -> Placed:
        if self._start_s is None:
            self._start_s = time_s
        after = time_s - self._start_s
        k = int(np.searchsorted(self._time_s, after, side="right"))
        if k == 0 or k == len(self._time_s):
            k = min(k, len(self._time_s) - 1)
            return Placed(self._position[k].tolist(), self._rotation[k].tolist(), True)
        share = (after - self._time_s[k - 1]) / (self._time_s[k] - self._time_s[k - 1])
        before, behind = ((self._position[j].tolist(), self._rotation[j].tolist()) for j in (k - 1, k))
        return between(before, behind, float(share))


class KeyboardPose:
    """Keys move the palm: W S A D R F forwards, back, left, right, up, down; I K U O L J turn it; space goes back.

    The terminal is put into its unbuffered mode until `close`.
    """

    wait_s = 0.0
    newest_s = math.inf
    about = "The palm was moved by keys."

    def __init__(self) -> None:
        import termios
        import tty

        if not sys.stdin.isatty():
            raise PalmarError("E-CONF", "--pose", "keyboard needs a terminal on stdin")
        self._file = sys.stdin.fileno()
        before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        self._restore: Callable[[], None] = lambda: termios.tcsetattr(self._file, termios.TCSADRAIN, before)
        self._target, self._now = np.zeros(6), np.zeros(6)
        self._time_s: float | None = None
        self._pressed = 0

    @property
    def files(self) -> list[int]:
        return [self._file]

    @property
    def counts(self) -> dict[str, Any]:
        return {"keys": self._pressed}

    def receive(self, time_s: float) -> bytes:
        keys = os.read(self._file, 64)
        for letter in keys.decode("ascii", "replace").lower():
            if letter == " ":
                self._target = np.zeros(6)
            elif letter in KEYS:
                axis, sign = KEYS[letter]
                self._target[axis] += sign * (KEY_STEP_M if axis < 3 else KEY_STEP_RAD)
            else:
                continue
            self._pressed += 1
        return keys

    def at(self, time_s: float) -> Placed:
        from scipy.spatial.transform import Rotation

        passed = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        self._time_s = time_s
        most = np.array([KEY_SPEED_M_PER_S] * 3 + [KEY_SPEED_RAD_PER_S] * 3) * passed
        self._now = self._now + np.clip(self._target - self._now, -most, most)
        rotation = np.roll(Rotation.from_euler("xyz", self._now[3:]).as_quat(), 1)
        return Placed(self._now[:3].tolist(), rotation.tolist(), True)

    def close(self) -> None:
        self._restore()


def _scene_pose(text: str, hand: HandModel) -> PlayedPose:
    # What scenes need takes half a second to load; other recordings start without.
    from palmar.traces.keyframes import key_trace
    from palmar.traces.scene_file import Sampled, cases_of, check_scene
    from palmar.traces.scripted import load_scene

    keys, where, _ = load_scene(text)
    scene = check_scene(cases_of(keys, str(where))[0][1] if "sweep" in keys else keys, str(where))
    if not isinstance(scene, Sampled):
        needed = f"a scene of kind keys or random is needed; or `palmar script {text} PACK -o X.mcap` and --pose X.mcap"
        raise PalmarError("E-CONF", str(where), f"kind {scene.kind!r} is made to fit an object; {needed}")
    return PlayedPose(key_trace(scene, hand), f"the scene {where.name}")
