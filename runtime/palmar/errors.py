"""What a user did wrong, in one line: a code, a place, what was found, what is allowed.

A hard moment in a step is not an error; it is the step's status (see `palmar.records.STATUS`).
"""

from __future__ import annotations


def one_line(text: str) -> str:
    """The text with all that cannot be printed written out, so that no file can break a line or steer a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class PalmarError(Exception):
    """Bad input from outside. `str()` is the line to show: `E-CODE where: what was found, what is allowed`.

    code: such as "E-MESH-OPEN"; where: file and place inside it, or the flag or key.
    """

    exit_code = 2

    def __init__(self, code: str, where: str, message: str) -> None:
        super().__init__(one_line(f"{code} {where}: {message}"))
        self.code = code
        self.where = where
        self.message = message

    def __reduce__(self) -> tuple[type[PalmarError], tuple[str, str, str]]:
        # From a worker to the process that waits for it.
        return type(self), (self.code, self.where, self.message)


class BadMesh(PalmarError):
    """A mesh that cannot become a SphereTree as it is."""


class BadPack(PalmarError):
    """A pack or hand file that breaks its format."""


class BadTrace(PalmarError):
    """A trace or run that breaks its format."""


class GloveError(PalmarError):
    """A device that cannot be read."""
