"""The `replay` verb: a trace on a pack, with what the run says of where it comes from."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

from palmar import _runtime
from palmar.errors import BadTrace
from palmar.files import sha256_of
from palmar.model import load_pack
from palmar.records import STATUS, Trace


def replay_file(
    pack: Path,
    trace: Path,
    out: Path,
    *,
    object_name: str = "",
    settings: dict[str, Any] | None = None,
    progress: Callable[[str, float], None] = lambda text, fraction: None,
) -> dict[str, Any]:
    """Replay `trace` on an object of `pack` and write the run; same inputs, same poses and forces, bit for bit.

    Returns run, pack_sha256, trace_sha256, steps, status (steps by name), content_fnv1a64 and lost. Raises BadPack,
    BadTrace, PalmarError.
    """
    header = {
        "pack_sha256": sha256_of(pack),
        "trace_sha256": sha256_of(trace),
        "machine": json.dumps(machine(), sort_keys=True),
    }

    def step(done: int, total: int) -> bool:
        progress(f"replay {trace.name}", done / max(total, 1))
        return True

    counts = _runtime.replay(str(pack), str(trace), str(out), object_name, settings or {}, header, step)
    return {
        "run": str(out),
        "pack_sha256": header["pack_sha256"],
        "trace_sha256": header["trace_sha256"],
        "steps": counts["steps"],
        "status": count_status(counts["steps_by_status"]),
        "content_fnv1a64": counts["content_fnv1a64"],
        "lost": counts["lost"],
    }


def object_of(trace: Trace, pack: Path) -> str:
    """The object that the trace says it was made for, if the pack has it; else "", which stands for the only one."""
    named = trace.header.get("object", "")
    return named if named in load_pack(pack).objects else ""


def require_side(trace: Trace, path: Path, pack: Path) -> None:
    """Raise BadTrace E-TRACE-SIDE if the trace is of the other hand than the pack's: mirrored, it looks like one."""
    said, about = trace.header["side"], load_pack(pack).hand.about
    if said != about.get("side", said):
        found = f"is of a {said} hand; {about['name']} in {pack.name} is a {about['side']} one"
        raise BadTrace("E-TRACE-SIDE", str(path), found)


def hand_warning(trace: Trace, pack: Path) -> str:
    """What to say if the trace's angles are of another user's hand than the pack's; "" if nothing."""
    profile, about = trace.header.get("profile_sha256"), load_pack(pack).hand.about
    if profile is None or profile == about.get("profile_sha256"):
        return ""
    return (
        f"the trace is of hand {trace.header['hand']}, the pack has {about['name']}, fitted to another profile or none"
    )


def count_status(steps_by_status: dict[int, int]) -> dict[str, int]:
    """Steps by the name of each status bit, from steps by status; a step with two bits counts in both."""
    counts = {"ok": steps_by_status.get(0, 0)}
    for bit, name in STATUS.items():
        counts[name] = sum(steps for status, steps in steps_by_status.items() if status & bit)
    return counts


def machine() -> dict[str, Any]:
    """What a time measured here depends on."""
    cpu = platform.processor() or platform.machine()
    listing = Path("/proc/cpuinfo")
    if listing.is_file():
        names = [
            line.partition(":")[2].strip() for line in listing.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    return {"cpu": cpu, "cores": os.cpu_count(), "os": platform.platform(), "python": platform.python_version()}
