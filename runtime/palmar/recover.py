"""The `recover` verb: a truncated or damaged trace -> a sound one, opened again and held against what was read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palmar import _runtime
from palmar.errors import BadTrace, PalmarError
from palmar.records import read_trace


def recover_file(path: Path, out: Path, header_of: Path | None = None) -> dict[str, Any]:
    """Write the whole chunks of a damaged trace as a sound trace; `out` appears only after it was read back and equal.

    header_of: a sound trace of the same device and hand, whose header is taken where the damaged file has lost its own.
    Returns out, how many there are of samples, device_readings, device_bytes and pose_bytes, duration_s, lost (bytes,
    chunks, messages, unclosed: how the file was found) and header_from.
    Raises BadTrace if there is nothing to recover, or for a run; PalmarError if `out` is the damaged file itself.
    """
    if out.exists() and out.samefile(path):
        raise PalmarError("E-FILE-PLACE", str(out), "is the damaged file itself; another name is needed")
    spare = {} if header_of is None else _sound_header(header_of)
    part = out.with_name(f".{out.name}.recovered")
    try:
        try:
            header, duration_s, kept, lost = _runtime.recover_trace(str(path), str(part), spare)
        except BadTrace as error:
            raise BadTrace(error.code, error.where, f"{error.message}{_advice(error)}") from None
        part.replace(out)
    finally:
        part.unlink(missing_ok=True)
    return {
        "out": str(out),
        **kept,
        "duration_s": duration_s,
        "lost": lost,
        "header_from": str(header_of) if spare and header == spare else str(path),
    }


def _sound_header(path: Path) -> dict[str, str]:
    trace = read_trace(path)
    if any(trace.lost.values()):
        raise BadTrace("E-TRACE-LOSS", str(path), "is damaged too; a sound trace of the same device and hand is needed")
    return trace.header


def _advice(error: BadTrace) -> str:
    if error.message.startswith("schema palmar.run/"):
        return "; a damaged run is made anew by replaying its trace"
    if error.code == "E-TRACE-CRC" and "header is damaged" in error.message:
        return "; --header-of names a sound trace of the same device and hand to take it from"
    return ""
