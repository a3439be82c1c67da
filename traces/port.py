"""A serial port that may go away and come back under another name, and what is read from it without waiting."""

from __future__ import annotations

import contextlib
import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palmar.errors import GloveError

BAUD = 115200
RETRY_S = 0.25  # between two looks whether the device is back
CHUNK = 65536


class Port:
    """One device under any of several names: a path, a pattern of paths, socket://HOST:PORT or usb:SERIAL-NUMBER.

    Nothing here waits. A port that fails is closed, and `connect` opens the first name that answers.
    """

    def __init__(self, names: Sequence[str], baud: int = BAUD) -> None:
        self.names = list(names)
        self.baud = baud
        self.opened: list[str] = []  # under which name, each time
        self.lost: list[str] = []  # why, each time
        self.refused = 0  # writes that the device took no part or not all of
        self.problem = "no such port"  # why the last try to open failed
        self._serial: Any = None

    @property
    def is_open(self) -> bool:
        return self._serial is not None

    def fileno(self) -> int:
        return int(self._serial.fileno())

    def connect(self) -> bool:
        """Try every name once. Port settings are 8 data bits, no parity, 1 stop bit; DTR is asserted."""
        import serial

        for name in candidates(self.names):
            try:
                # Exclusively, so that no other program takes half of the bytes.
                port = serial.serial_for_url(name, baudrate=self.baud, timeout=0, exclusive=True)
            except (serial.SerialException, OSError, ValueError) as error:
                self.problem = f"{name}: {_reason(error)}"
                continue
            self._serial = port
            self.opened.append(name)
            return True
        if not candidates(self.names):
            self.problem = f"{', '.join(self.names)}: no such port"
        return False

    def read(self) -> bytes | None:
        """What has come, at most 64 KiB; None if the device is gone, and then the port is closed."""
        try:
            content = os.read(self.fileno(), CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._drop(_reason(error))
            return None
        if not content:
            self._drop("the other end closed it")
            return None
        return content

    def write(self, content: bytes) -> bool:
        """Send at once or not at all: a device that does not take it is counted, one that is gone is closed."""
        if not self.is_open:
            return False
        try:
            whole = os.write(self.fileno(), content) == len(content)
        except BlockingIOError:
            whole = False
        except OSError as error:
            self._drop(_reason(error))
            return False
        self.refused += not whole
        return whole

    def close(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            # Closing a tty whose other end is gone may fail; it is closed all the same.
            with contextlib.suppress(OSError):
                port.close()

    def _drop(self, why: str) -> None:
        self.lost.append(why)
        self.close()


def candidates(names: Sequence[str]) -> list[str]:
    """The names that may be opened now: patterns and serial numbers as the ports that they mean."""
    found: list[str] = []
    for name in names:
        if name.startswith("usb:"):
            found += [port.device for port in _listed() if port.serial_number == name.removeprefix("usb:")]
        elif "://" in name:
            found.append(name)
        else:
            found += sorted(glob.glob(name)) or ([name] if Path(name).exists() else [])  # noqa: PTH207
    return list(dict.fromkeys(found))


def require_port(port: Port, flag: str) -> None:
    """Open a port for the first time. Raises GloveError E-GLOVE-PORT that names those that are there."""
    if not port.connect():
        there = [f"{p.device} ({p.description}, usb:{p.serial_number})" for p in _listed() if p.serial_number]
        seen = f"; ports here: {', '.join(there)}" if there else "; no USB serial port is plugged in"
        raise GloveError("E-GLOVE-PORT", flag, f"{port.problem}{seen}")


def _listed() -> list[Any]:
    from serial.tools import list_ports

    return list(list_ports.comports())


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) else " ".join(str(error).split())
