"""The `replay` verb: a trace on a pack, with what the run says of where it comes from."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

from palmar import _runtime
from palmar.files import sha256_of


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

    Returns the counts of `_runtime.replay` with the hashes and the path. Raises BadPack, BadTrace, PalmarError.
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
    return {"run": str(out), "pack_sha256": header["pack_sha256"], "trace_sha256": header["trace_sha256"], **counts}


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
