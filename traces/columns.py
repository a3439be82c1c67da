"""A comma-separated log as named columns of numbers, with every fault named by its line and column."""

from __future__ import annotations

import csv
import difflib
import hashlib
import io
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadTrace

Array = NDArray[np.float64]

UNIT_TOLERANCE = 1e-3  # a quaternion farther from unit length than this was not one


@dataclass(frozen=True)
class Log:
    """Columns of a log by name, each (n,) float64, finite, or NaN where a field may be empty and is.

    Lines are counted from the header, which is line 1.
    """

    where: str
    sha256: str
    columns: dict[str, Array]

    def stack(self, names: list[str]) -> Array:
        """The named columns side by side: (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names])


def read_header(path: Path, delimiter: str = ",") -> list[str]:
    """Names in the first line of a log. Raises BadTrace E-TRACE-MISSING, E-TRACE-FORMAT or E-TRACE-EMPTY."""
    return _split(path, _text(path)[0], delimiter)[0]


def read_log(
    path: str | Path,
    required: list[str],
    time_column: str,
    *,
    optional: Sequence[str] = (),
    may_be_empty: Collection[str] = (),
    unused: Collection[str] = (),
    delimiter: str = ",",
    repair: bool = False,
) -> Log:
    """Read a whole log of finite numbers in which time increases.

    optional: columns that may be there too. may_be_empty: columns whose fields may be empty; they are NaN then.
    unused: columns that are not read, whatever they hold. repair: what is no finite number is NaN, a last line that
    does not end is left out, and times may go back.

    Raises BadTrace: E-TRACE-MISSING (no file), E-TRACE-FORMAT (not text), E-TRACE-EMPTY (no rows), E-TRACE-COLUMNS (a
    column is missing, unknown or doubled, or a line has too few fields), E-TRACE-VALUE (not a finite number, or the
    last line is cut), E-TRACE-TIME (time does not increase).
    """
    path = Path(path)
    text, sha256 = _text(path)
    rows = _split(path, text, delimiter)
    _check_names(path, rows[0], required, optional, unused)
    names, rows = rows[0], rows[1:]
    if not rows:
        raise BadTrace("E-TRACE-EMPTY", str(path), "only a header line; at least one row of numbers is needed")
    if not text.endswith(("\n", "\r")) and repair and len(rows) > 1:
        rows.pop()
    elif not text.endswith(("\n", "\r")):
        raise BadTrace(
            "E-TRACE-VALUE",
            f"{path}:line {len(rows) + 1}",
            "the last line does not end, so its last number may be cut; copy the file again or delete that line",
        )
    for i, row in enumerate(rows):
        if len(row) != len(names):
            raise BadTrace(
                "E-TRACE-COLUMNS", f"{path}:line {i + 2}", f"{len(row)} fields; the header names {len(names)} columns"
            )
    read = [k for k, name in enumerate(names) if name not in unused]
    names, rows = [names[k] for k in read], [[row[k] for k in read] for row in rows]
    if repair:
        rows = [[field if _is_finite(field) else "" for field in row] for row in rows]
    gaps = [name in may_be_empty for name in names]
    empty = np.array([[gap and not field for gap, field in zip(gaps, row, strict=True)] for row in rows])
    filled = [["0" if e else field for e, field in zip(*pair, strict=True)] for pair in zip(empty, rows, strict=True)]
    try:
        table = np.array(filled, dtype=np.float64)
    except ValueError:
        table = np.array(
            [[_number(path, i, n, v) for n, v in zip(names, row, strict=True)] for i, row in enumerate(filled)]
        )
    if not np.isfinite(table).all():
        i, j = np.argwhere(~np.isfinite(table))[0]
        raise _bad_value(path, int(i), names[j], rows[i][j])
    table[empty] = np.nan
    time = table[:, names.index(time_column)]
    late = np.flatnonzero(np.diff(time) <= 0)
    if late.size and not repair:
        i = int(late[0]) + 1
        raise BadTrace(
            "E-TRACE-TIME",
            f"{path}:line {i + 2}",
            f"{time_column} {time[i]:g} after {time[i - 1]:g}; time has to increase",
        )
    return Log(str(path), sha256, {name: table[:, j] for j, name in enumerate(names)})


def unit_quaternions(log: Log, names: list[str]) -> Array:
    """Four columns as unit quaternions w x y z, (n, 4). Raises BadTrace E-TRACE-VALUE if one is no rotation."""
    rotation = log.stack(names)
    length = np.linalg.norm(rotation, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1) > UNIT_TOLERANCE)
    if wrong.size:
        i = int(wrong[0])
        raise BadTrace(
            "E-TRACE-VALUE",
            f"{log.where}:line {i + 2}",
            f"{', '.join(names)} has length {length[i]:.6g}; a rotation has 1",
        )
    return rotation / length[:, None]


def nearest(name: str, known: list[str]) -> str:
    """ " (nearest: NAME)" for a misspelt name, or nothing."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f" (nearest: {close[0]})" if close else ""


def _text(path: Path) -> tuple[str, str]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadTrace("E-TRACE-MISSING", str(path), f"{error.strerror}; a log file is needed") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadTrace("E-TRACE-FORMAT", str(path), "not text; a comma-separated log is needed") from None
    return text, hashlib.sha256(content).hexdigest()


def _split(path: Path, text: str, delimiter: str = ",") -> list[list[str]]:
    """Fields of every line; blank lines at the end are dropped."""
    try:
        rows = list(csv.reader(io.StringIO(text), delimiter=delimiter))
    except csv.Error as error:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"not a comma-separated log ({error})") from None
    while rows and not any(field.strip() for field in rows[-1]):
        rows.pop()
    if not rows:
        raise BadTrace("E-TRACE-EMPTY", str(path), "an empty file; a header line and rows of numbers are needed")
    return [[field.strip() for field in row] for row in rows]


def _check_names(
    path: Path, names: list[str], required: list[str], optional: Sequence[str], unused: Collection[str]
) -> None:
    where = f"{path}:line 1"
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise BadTrace("E-TRACE-COLUMNS", where, f"column {doubled[0]!r} stands there twice")
    missing = [name for name in required if name not in names]
    known = [*required, *optional]
    unknown = [name for name in names if name not in known]
    if missing:
        found = f"; unknown here: {', '.join(unknown[:5])}" if unknown else ""
        raise BadTrace("E-TRACE-COLUMNS", where, f"column {', '.join(missing[:5])} is missing{found}")
    for name in unknown:
        if name not in unused:
            raise BadTrace("E-TRACE-COLUMNS", where, f"unknown column {name!r}{nearest(name, known)}")


def _number(path: Path, i: int, name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise _bad_value(path, i, name, value) from None


def _is_finite(field: str) -> bool:
    try:
        return bool(np.isfinite(float(field)))
    except ValueError:
        return False


def _bad_value(path: Path, i: int, name: str, value: str) -> BadTrace:
    return BadTrace("E-TRACE-VALUE", f"{path}:line {i + 2}, column {name}", f"{value!r}; a finite number is needed")
