"""A trace that `palmar export` wrote as CSV, JSON or Parquet -> Trace, the same numbers to the bit."""

from __future__ import annotations

import json
from pathlib import Path

from palmar.errors import BadTrace, PalmarError
from palmar.export import SAMPLES, trace_of
from palmar.records import Trace
from palmar.tables import Table, read_table
from palmar.traces.columns import read_log

COLUMNS = list(SAMPLES)
OWN = ("hand_name", "side", "device")


def read_samples(path: str | Path, *, hand_name: str = "", side: str = "", device: str = "") -> Trace:
    """Read samples. hand_name, side, device: of a CSV, which has no header: its hand model, right or left, device.

    Raises BadTrace, PalmarError E-CONF for an option that is missing or not wanted.
    """
    path = Path(path)
    given = dict(zip(OWN, (hand_name, side, device), strict=True))
    if path.suffix not in (".json", ".parquet"):
        for key in OWN[:2]:
            if not given[key]:
                raise PalmarError("E-CONF", f"--option {key}", "is missing; a CSV does not say it")
        log = read_log(path, COLUMNS, "time_s")
        about = {
            "device": device or "csv",
            "hand": hand_name,
            "side": side,
            "source": path.name,
            "source_sha256": log.sha256,
            "assumptions": json.dumps(["The columns are those of `palmar export`; the header was given."]),
        }
        return trace_of(Table(log.columns, about))
    for key, value in given.items():
        if value:
            raise PalmarError("E-CONF", f"--option {key}", f"{path.name} says it itself; leave it out")
    table = read_table(path)
    missing = [name for name in COLUMNS if name not in table.columns]
    unknown = [name for name in table.columns if name not in COLUMNS]
    if missing or unknown:
        found = f"column {missing[0]!r} is missing" if missing else f"unknown column {unknown[0]!r}"
        raise BadTrace("E-TRACE-COLUMNS", str(path), f"{found}; samples as `palmar export` writes them are needed")
    try:
        return trace_of(table)
    except ValueError as error:
        raise BadTrace("E-TRACE-VALUE", str(path), f"a column is no column of numbers ({error})") from None
