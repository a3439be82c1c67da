"""`replay --verify`: is a run what its pack, trace and settings give here and now, step by step and bit for bit?"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar import _runtime
from palmar.errors import BadPack, BadTrace
from palmar.files import sha256_of
from palmar.records import Run, read_run
from palmar.replay import replay_file

# Times are never the same twice; contacts are compared step by step below.
TIMES = {"cpu_us", "wall_us", "search_us", "solve_us", "verify_us"}
ROWS = tuple(name for name in Run.__dataclass_fields__ if not name.startswith("contact_") and name not in TIMES)
COLUMNS = tuple(name for name in ROWS if name not in ("header", "lost"))
CONTACTS = tuple(name for name in Run.__dataclass_fields__ if name.startswith("contact_") and name != "contact_start")


def verify_run(path: Path, pack: Path, trace: Path) -> dict[str, Any]:
    """Replay `trace` on `pack` as the run at `path` says it was, and compare each of its steps.

    Returns run, steps (in the run), differing (how many of them), first (None, or the first: step, time_s, columns that
    differ, state_hash of the run and of now), palm_mm (largest distance between the two palms), build (of then and now)
    and lost. Raises BadPack E-PACK-HASH and BadTrace E-TRACE-HASH where the run was made of other files.
    """
    run = read_run(path)
    for kind, given in (("pack", pack), ("trace", trace)):
        wanted, found = run.header.get(f"{kind}_sha256", ""), sha256_of(given)
        if wanted != found:
            error, code = (BadPack, "E-PACK-HASH") if kind == "pack" else (BadTrace, "E-TRACE-HASH")
            raise error(code, str(given), f"sha256 {found[:16]}; {path} was made of {wanted[:16] or '(not stored)'}")
    settings = json.loads(run.header["settings"])
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / "again.run.mcap"
        replay_file(pack, trace, again, object_name=run.header["object"], settings=settings)
        now = read_run(again)

    # A damaged run lacks steps: each is compared with the one of its time.
    at = np.searchsorted(now.time_s, run.time_s).clip(max=len(now.time_s) - 1)
    differs = {name: _differs(getattr(run, name), getattr(now, name)[at]) for name in COLUMNS}
    differs["contacts"] |= _contacts_differ(run, now, at, differs["contacts"])
    steps = np.any(list(differs.values()), axis=0)
    first = None
    if steps.any():
        k = int(np.argmax(steps))
        first = {
            "step": k,
            "time_s": float(run.time_s[k]),
            "columns": [name for name in COLUMNS if differs[name][k]],
            "state_hash": [f"{int(run.state_hash[k]):016x}", f"{int(now.state_hash[at[k]]):016x}"],
        }
    apart = np.linalg.norm(run.palm_position_m - now.palm_position_m[at], axis=1)
    return {
        "run": str(path),
        "steps": len(steps),
        "differing": int(steps.sum()),
        "first": first,
        "palm_mm": float(1e3 * np.nanmax(apart)),
        "build": {"then": json.loads(run.header.get("build", "{}")), "now": _runtime.build_info()},
        "lost": run.lost,
    }


def differing_line(answer: dict[str, Any]) -> str:
    """What `verify_run` found different, in the form of an error; "" if every step is the same."""
    first = answer["first"]
    if first is None:
        return ""
    then, now = ((f"{build.get('version')}, {build.get('compiler')}") for build in answer["build"].values())
    return (
        f"E-VERIFY {answer['run']}:step {first['step']}: at {first['time_s']:g} s the first that differs, in "
        f"{', '.join(first['columns'])} (state {first['state_hash'][0]} in the run, {first['state_hash'][1]} now); "
        f"{answer['differing']} of {answer['steps']} steps differ, palms by {answer['palm_mm']:.3g} mm at most; "
        f"made by {then}; this is {now}"
    )


def _differs(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """For each row: whether any bit is another. Numbers that are equal with other bits, -0 and 0, differ."""
    width = a.itemsize * int(np.prod(a.shape[1:]))
    one, other = (np.ascontiguousarray(x).reshape(-1).view(np.uint8).reshape(len(a), width) for x in (a, b))
    return (one != other).any(axis=1)


def _contacts_differ(run: Run, now: Run, at: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """For each step with equally many contacts (the others are `known` to differ): whether any of them is another."""
    found = known.copy()
    counts = np.diff(run.contact_start)
    found |= counts != np.diff(now.contact_start)[at]
    same = np.flatnonzero(~found & (counts > 0))
    step = np.repeat(same, counts[same])
    within = np.arange(len(step)) - np.repeat(np.cumsum(counts[same]) - counts[same], counts[same])
    here, there = run.contact_start[step] + within, now.contact_start[at[step]] + within
    for name in CONTACTS:
        other = _differs(getattr(run, name)[here], getattr(now, name)[there])
        found[step[other]] = True
    return found
