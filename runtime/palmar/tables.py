"""Tables as CSV, JSON or Parquet: named columns of equal length, and strings about them by name."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadTrace, PalmarError
from palmar.model import write_whole

FORMS = ("csv", "json", "parquet")
TABLE_SCHEMA = "palmar.table/1"
ABOUT_KEY = b"palmar"


@dataclass(frozen=True)
class Table:
    """Columns by name, each (n,) of one type, and what is said about them. A CSV keeps the columns alone."""

    columns: dict[str, NDArray[Any]]
    about: dict[str, str]


def write_table(path: Path, table: Table) -> None:
    """Write a table in the form of the path's ending, every number in full; the file appears whole or not at all.

    Raises PalmarError E-PACKAGE if a package for the form is not installed.
    """
    write_whole(path, WRITE[path.suffix.removeprefix(".")](table))


def read_table(path: Path) -> Table:
    """Read a JSON or Parquet table of `write_table`. Raises BadTrace E-TRACE-FORMAT, PalmarError E-PACKAGE."""
    return _from_parquet(path) if path.suffix == ".parquet" else _from_json(path)


def holds_table(path: Path) -> bool:
    """Whether a JSON file begins as `write_table` begins one."""
    try:
        with path.open("rb") as stream:
            return stream.read(64).startswith(f'{{"schema": "{TABLE_SCHEMA}"'.encode())
    except OSError:
        return False


def _to_csv(table: Table) -> bytes:
    # csv writes a float as repr does: the shortest text that reads back as the same number.
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(zip(*(_numbers(values) for values in table.columns.values()), strict=True))
    return text.getvalue().encode()


def _to_json(table: Table) -> bytes:
    columns = {name: _numbers(values) for name, values in table.columns.items()}
    return json.dumps({"schema": TABLE_SCHEMA, "about": table.about, "columns": columns}, allow_nan=False).encode()


def _to_parquet(table: Table) -> bytes:
    arrow, parquet = _arrow()
    found = arrow.table({name: arrow.array(values) for name, values in table.columns.items()})
    about = json.dumps({"schema": TABLE_SCHEMA, "about": table.about}, sort_keys=True)
    sink = io.BytesIO()
    parquet.write_table(found.replace_schema_metadata({ABOUT_KEY: about.encode()}), sink)
    return sink.getvalue()


def _from_json(path: Path) -> Table:
    try:
        said = json.loads(path.read_bytes())
        _require_schema(said, path)
        columns = {name: np.array(values) for name, values in said["columns"].items()}
        return Table(columns, {str(key): str(value) for key, value in said["about"].items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"not a table that Palmar wrote ({error})") from None


def _from_parquet(path: Path) -> Table:
    arrow, parquet = _arrow()
    try:
        found = parquet.read_table(path)
        said = json.loads((found.schema.metadata or {})[ABOUT_KEY])
        _require_schema(said, path)
        columns = {name: found.column(name).to_numpy() for name in found.column_names}
        return Table(columns, {str(key): str(value) for key, value in said["about"].items()})
    except (OSError, ValueError, KeyError, TypeError, arrow.ArrowException) as error:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"not a table that Palmar wrote ({error})") from None


def _require_schema(said: dict[str, Any], path: Path) -> None:
    if said["schema"] != TABLE_SCHEMA:
        raise BadTrace("E-TRACE-SCHEMA", str(path), f"schema {said['schema']}; this version reads {TABLE_SCHEMA}")


def _arrow() -> tuple[ModuleType, ModuleType]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        needed = "Parquet needs the package pyarrow: pip install 'palmar[parquet]'"
        raise PalmarError("E-PACKAGE", "pyarrow", f"is not installed; {needed}") from None
    return pyarrow, pyarrow.parquet


def _numbers(values: NDArray[Any]) -> list[Any]:
    """As Python numbers; a truth is 0 or 1."""
    return (values.astype(np.uint8) if values.dtype == bool else values).tolist()


WRITE = {"csv": _to_csv, "json": _to_json, "parquet": _to_parquet}
