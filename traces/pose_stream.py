"""Palm poses from a second device: lines from a serial port, a socket or UDP, and its clock joined to ours."""

from __future__ import annotations

import math
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from palmar.errors import GloveError, PalmarError
from palmar.model import Array
from palmar.traces.line_buffer import LineBuffer
from palmar.traces.port import RETRY_S, Port, require_port

LONGEST_LINE = 512
FARTHEST_M = 1000.0  # what a replay takes
STALE_S = 0.1  # without a pose for so long, the palm is lost
KEPT = 256
FORGET = 1e-4  # seconds a second by which the least delay so far is forgotten: more than two clocks part

Pose = tuple[list[float], list[float]]  # 3 metres, 4 w x y z


class Placed(NamedTuple):
    """Where the palm is: metres, unit quaternion w x y z, world from palm; and whether that is known."""

    position_m: list[float]
    rotation_wxyz: list[float]
    known: bool


class PoseStream:
    """Lines `[TIME] X Y Z W QX QY QZ`, blanks or commas between: the sender's seconds, if it has any, metres, rotation.

    offset_s: how late the poses come compared with the glove's lines; they are put so much earlier. A sender's clock
    is joined to ours by the quickest arrival so far, so that a jittering link does not make the palm jitter. mount: the
    palm in the frame of the tracker that the poses are of.
    """

    def __init__(self, name: str, *, offset_s: float, mount: tuple[Array, Array], baud: int) -> None:
        self.wait_s = 0.05 + max(offset_s, 0.0)
        self._offset_s = offset_s
        self._mount = (mount[0].tolist(), mount[1].tolist())
        self._poses: deque[tuple[float, Pose]] = deque(maxlen=KEPT)
        self._least_delay: tuple[float, float] | None = None  # arrival less sender's time, and when it was seen
        self._counts = {"received": 0, "rejected": 0, "out of order": 0}
        self._name = name
        self._udp: socket.socket | None = None
        self._port: Port | None = None
        self._retry_s = -math.inf
        self._lines = LineBuffer(LONGEST_LINE)
        if name.startswith("udp://"):
            self._udp = _bind(name)
        else:
            self._port = Port([name], baud)
            require_port(self._port, "--pose")
        joined = f"put {offset_s * 1e3:g} ms earlier than they came" if offset_s else "taken to be of when they came"
        self.about = f"Palm poses came as a stream from {name} and are {joined}; samples between two are interpolated."

    @property
    def files(self) -> list[int]:
        if self._udp is not None:
            return [self._udp.fileno()]
        return [self._port.fileno()] if self._port is not None and self._port.is_open else []

    @property
    def counts(self) -> dict[str, Any]:
        lost = {"reconnected": len(self._port.opened) - 1} if self._port is not None else {}
        return {"from": self._name, **self._counts, "overlong": self._lines.overlong, **lost}

    def receive(self, time_s: float) -> bytes:
        """Take what has come by now; also tries again, now and then, to open a port that is gone."""
        if self._udp is not None:
            content = b""
            while len(content) < 65536:
                try:
                    datagram = self._udp.recv(65536)
                except BlockingIOError:
                    break
                content += datagram if datagram.endswith(b"\n") else datagram + b"\n"
        else:
            assert self._port is not None
            if not self._port.is_open:
                if time_s >= self._retry_s:
                    self._retry_s = time_s + RETRY_S
                    self._port.connect()
                return b""
            content = self._port.read() or b""
        for line in self._lines.feed(content):
            if line.strip():
                self._take(line, time_s)
        return content

    def at(self, time_s: float) -> Placed:
        """The pose at a time: between its neighbours, or the last one."""
        later: tuple[float, Pose] | None = None
        for when, pose in reversed(self._poses):
            if when <= time_s:
                if later is None or later[0] - when > STALE_S:
                    return Placed(*pose, time_s - when <= STALE_S)
                return between(pose, later[1], (time_s - when) / (later[0] - when))
            later = (when, pose)
        return Placed(*later[1], False) if later else Placed([0.0] * 3, [1.0, 0.0, 0.0, 0.0], False)

    @property
    def newest_s(self) -> float:
        """The time of the newest pose; samples up to it need not wait."""
        return self._poses[-1][0] if self._poses else -math.inf

    def close(self) -> None:
        for end in (self._udp, self._port):
            if end is not None:
                end.close()

    def _take(self, line: bytes, time_s: float) -> None:
        try:
            numbers = [float(part) for part in line.replace(b",", b" ").split()]
        except ValueError:
            numbers = []
        pose = numbers[-7:]
        length = math.hypot(*pose[3:])
        usable = len(numbers) in (7, 8) and all(map(math.isfinite, numbers)) and abs(length - 1.0) <= 1e-3
        if not usable or max(map(abs, pose[:3])) > FARTHEST_M:
            self._counts["rejected"] += 1
            return
        when = (time_s if len(numbers) == 7 else self._ours(numbers[0], time_s)) - self._offset_s
        if when <= self.newest_s:
            self._counts["out of order"] += 1
            return
        self._counts["received"] += 1
        placed = (pose[:3], [part / length for part in pose[3:]])
        self._poses.append((when, _after(placed, self._mount)))

    def _ours(self, sent_s: float, time_s: float) -> float:
        """A time of the sender's clock by ours."""
        delay = time_s - sent_s
        if self._least_delay is not None:
            least, seen_s = self._least_delay
            # A sender's clock that was set begins anew.
            if abs(delay - least) < 10.0:
                delay = min(delay, least + FORGET * (time_s - seen_s))
        self._least_delay = (delay, time_s)
        return sent_s + delay


def between(before: Pose, behind: Pose, share: float) -> Placed:
    """The pose at a share of the way; rotations turn along the great circle, nearly evenly (normalised sum)."""
    position = [a + share * (b - a) for a, b in zip(before[0], behind[0], strict=True)]
    sign = 1.0 if sum(a * b for a, b in zip(before[1], behind[1], strict=True)) >= 0 else -1.0
    rotation = [a + share * (sign * b - a) for a, b in zip(before[1], behind[1], strict=True)]
    length = math.hypot(*rotation)
    return Placed(position, [part / length for part in rotation], True)


def unit_pose(flag: str, text: str) -> tuple[Array, Array]:
    """`X,Y,Z[,W,QX,QY,QZ]` as metres and a unit quaternion; an empty text is the identity. Raises PalmarError."""
    try:
        numbers = [float(part) for part in text.split(",")] if text else [0.0] * 3
    except ValueError:
        numbers = []
    rotation = np.array(numbers[3:] or [1.0, 0.0, 0.0, 0.0])
    fits = len(numbers) in (3, 7) and np.isfinite(numbers).all() and abs(np.linalg.norm(rotation) - 1.0) <= 1e-3
    if not fits or max(map(abs, numbers[:3])) > FARTHEST_M:
        needed = "X,Y,Z or X,Y,Z,W,QX,QY,QZ is needed, in metres and as a unit quaternion"
        raise PalmarError("E-CONF", flag, f"{text!r}; {needed}")
    return np.array(numbers[:3]), rotation / np.linalg.norm(rotation)


def _after(first: Pose, then: Pose) -> Pose:
    """world from tracker, then tracker from palm: world from palm."""
    w, x, y, z = first[1]
    a, b, c = then[0]
    # v + 2 w (u x v) + 2 u x (u x v)
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    turned = (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)
    position = [p + t for p, t in zip(first[0], turned, strict=True)]
    return position, _product(first[1], then[1])


def _product(p: Sequence[float], q: Sequence[float]) -> list[float]:
    return [
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    ]


def _bind(name: str) -> socket.socket:
    try:
        parts = urlsplit(name)
        address = (parts.hostname or "127.0.0.1", parts.port or 0)
    except ValueError:
        address = ("", 0)
    if not address[1]:
        raise PalmarError("E-CONF", "--pose", f"{name!r}; udp://HOST:PORT is needed, of this machine")
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.setblocking(False)
    try:
        end.bind(address)
    except OSError as error:
        end.close()
        raise GloveError("E-GLOVE-PORT", "--pose", f"{name}: {error.strerror}") from None
    return end
