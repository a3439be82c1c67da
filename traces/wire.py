"""The glove's end of a connection: a pseudo-terminal that looks like a serial port, or a TCP server."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
import tty
from pathlib import Path

from palmar.errors import PalmarError

OPENED_S = 0.02  # what a host needs between opening a port and having set it up


class Pty:
    """A pseudo-terminal. `name` is what a host opens; with `link` a symbolic link of that name points to it.

    After an unplug the link comes back as LINK-1, LINK-2, ... as a serial port of USB comes back under another number.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link, self._times = link, 0
        if link is not None and link.exists() and not link.is_symlink():
            raise PalmarError("E-FILE-PLACE", str(link), "is there and no symbolic link; another name is needed")
        self._made: Path | None = None
        self.plug()

    def plug(self) -> None:
        """Appear. Raises PalmarError E-FILE-PLACE if the link cannot be made."""
        self._host, device = os.openpty()
        tty.setraw(device)
        self.name = os.ttyname(device)
        os.close(device)  # so that it shows whether a host has it open
        os.set_blocking(self._host, False)
        self._poll = select.poll()
        self._poll.register(self._host, select.POLLIN)
        if self._link is not None:
            self._made = self._link if not self._times else self._link.with_name(f"{self._link.name}-{self._times}")
            try:
                self._made.unlink(missing_ok=True)
                self._made.symlink_to(self.name)
            except OSError as error:
                raise PalmarError("E-FILE-PLACE", str(self._made), f"{error.strerror}") from None
            self.name = str(self._made)
        self._times += 1

    def unplug(self) -> None:
        if self._made is not None:
            self._made.unlink(missing_ok=True)
        os.close(self._host)

    close = unplug

    def heard(self) -> bool:
        """Whether a host has the port open."""
        return not any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def send(self, content: bytes) -> bool:
        """Whether all of it was taken; like a serial line, it does not wait for long."""
        end = time.monotonic() + 1.0
        while content:
            try:
                content = content[os.write(self._host, content) :]
            except BlockingIOError:
                if time.monotonic() > end or not self.heard():
                    return False
                time.sleep(0.001)
            except OSError:
                return False
        return True

    def receive(self, wait_s: float) -> bytes:
        """What the host sent, after at most so long."""
        select.select([self._host], [], [], max(wait_s, 0.0))  # to the microsecond; poll waits whole milliseconds
        with contextlib.suppress(OSError):
            return os.read(self._host, 4096)
        return b""


class Server:
    """A TCP server for one host, which finds the glove at socket://HOST:PORT."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        if not port.isdigit() or not 0 <= int(port) < 65536:
            raise PalmarError("E-CONF", "--listen", f"{address!r}; HOST:PORT is needed, port 0 for any that is free")
        self._address = (host or "127.0.0.1", int(port))
        self._end: socket.socket | None = None
        self.plug()

    def plug(self) -> None:
        try:
            self._door = socket.create_server(self._address)
        except OSError as error:
            raise PalmarError("E-CONF", "--listen", f"{self._address[0]}: {error.strerror}") from None
        self._door.setblocking(False)
        self._address = self._door.getsockname()[:2]
        self.name = f"socket://{self._address[0]}:{self._address[1]}"

    def unplug(self) -> None:
        for end in (self._end, self._door):
            if end is not None:
                end.close()
        self._end = None

    close = unplug

    def heard(self) -> bool:
        if self._end is None:
            with contextlib.suppress(BlockingIOError):
                self._end, _ = self._door.accept()
                self._end.settimeout(1.0)
                self._end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._end is not None

    def send(self, content: bytes) -> bool:
        try:
            if self._end is not None:
                self._end.sendall(content)
        except OSError:
            self._lose()
        return self._end is not None

    def receive(self, wait_s: float) -> bytes:
        if self._end is None:
            time.sleep(max(wait_s, 0.0))
            return b""
        ready, _, _ = select.select([self._end], [], [], max(wait_s, 0.0))
        if not ready:
            return b""
        try:
            content = self._end.recv(4096)
        except OSError:
            content = b""
        if not content:
            self._lose()
        return content

    def _lose(self) -> None:
        if self._end is not None:
            self._end.close()
            self._end = None
