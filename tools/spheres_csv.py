"""Spheres from a CSV file: one a row, in the order of the file."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.tools.mesh import METRES_PER_UNIT

RADIUS_NAMES = ("radius", "r")


def read_spheres_csv(path: str | Path, units: str = "m") -> tuple[NDArray[np.float64], str]:
    """Spheres (n, 4) in metres, x, y, z, radius, in the file's order, and the sha256 of its bytes.

    The first row names the columns: x, y, z and radius (or r), in `units`; or each with the ending of a unit, as x_m.
    Raises BadPack with the line and the column.
    """
    where = str(path)
    if units not in METRES_PER_UNIT:
        raise BadPack("E-CSV-UNITS", where, f"units {units!r}; known are {', '.join(METRES_PER_UNIT)}")
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise BadPack("E-CSV-MISSING", where, f"{error.strerror}; a CSV of spheres is needed") from None
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8-sig", "replace"), newline=None)))
    except csv.Error as error:
        raise BadPack("E-CSV", where, f"not a CSV ({error})") from None
    header = [name.strip().lower() for name in rows[0]] if rows else []
    columns, metres = _find_columns(where, header, units)
    spheres = []
    for line, row in enumerate(rows[1:], 2):
        if not row:
            continue
        if len(row) != len(header):
            raise BadPack("E-CSV", f"{where}:line {line}", f"{len(row)} fields; the header names {len(header)}")
        spheres.append([_number(f"{where}:line {line}, column {header[k]}", row[k], k == columns[3]) for k in columns])
    if not spheres:
        raise BadPack("E-CSV", where, "no spheres; at least one is needed")
    return np.array(spheres) * metres, hashlib.sha256(content).hexdigest()


def _find_columns(where: str, header: list[str], units: str) -> tuple[list[int], float]:
    """Places of x, y, z and radius among the columns, and metres per unit."""
    for unit in ("", *METRES_PER_UNIT):
        ending = f"_{unit}" if unit else ""
        for radius in RADIUS_NAMES:
            names = [name + ending for name in ("x", "y", "z", radius)]
            if sorted(header) == sorted(names):
                if unit and units not in ("m", unit):
                    raise BadPack("E-CSV-UNITS", f"{where}:line 1", f"columns in {unit}, but {units} asked for")
                return [header.index(name) for name in names], METRES_PER_UNIT[unit or units]
    found = ",".join(header)[:60]
    raise BadPack(
        "E-CSV", f"{where}:line 1", f"columns {found!r}; x, y, z, radius or x_m, y_m, z_m, radius_m are needed"
    )


def _number(at: str, text: str, is_radius: bool) -> float:
    try:
        value = float(text)
    except ValueError:
        raise BadPack("E-CSV", at, f"{text[:20]!r}; a number is needed") from None
    if not math.isfinite(value) or (is_radius and value <= 0):
        raise BadPack("E-CSV", at, f"{text[:20]}; {'a radius above 0' if is_radius else 'a finite number'} is needed")
    return value
