"""TOML files from users: read, and held against the keys that are known."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from palmar.errors import BadPack


def read_toml(path: str | Path) -> tuple[dict[str, Any], bytes]:
    """The content of a TOML file and its bytes. Raises BadPack with the line of what is not TOML."""
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise BadPack("E-CONF-MISSING", str(path), f"{error.strerror}; a TOML file is needed") from None
    try:
        return tomllib.loads(content.decode()), content
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadPack("E-CONF", str(path), f"not TOML: {error}") from None


def check_keys(where: str, table: Any, known: Iterable[str], needed: Iterable[str] = ()) -> dict[str, Any]:
    """The table itself. Raises BadPack for a key that is not known, or that is missing.

    where: file and the table's place in it, such as `hand.toml:finger[1]`.
    """
    if not isinstance(table, dict):
        raise BadPack("E-CONF", where, f"{_short(table)}; a table is needed")
    allowed = sorted(known)
    for key in table:
        if key not in allowed:
            known_are = f"known are {', '.join(allowed)}"
            raise BadPack("E-CONF", _place(where, key), f"unknown key{nearest(key, allowed)}; {known_are}")
    for key in needed:
        if key not in table:
            raise BadPack("E-CONF", _place(where, key), "is missing")
    return table


def get_number(where: str, table: dict[str, Any], key: str, low: float, high: float) -> float:
    """A number above low and at most high. Raises BadPack."""
    value = table[key]
    if not is_number(value) or not low < value <= high:
        raise BadPack(
            "E-CONF", _place(where, key), f"{_short(value)}; a number above {low:g} and up to {high:g} is needed"
        )
    return float(value)


def get_text(where: str, table: dict[str, Any], key: str, allowed: Iterable[str] = ()) -> str:
    """A string that is not empty, one of `allowed` if that is not empty. Raises BadPack."""
    value, allowed = table[key], list(allowed)
    if not isinstance(value, str) or not value or (allowed and value not in allowed):
        wanted = "one of " + ", ".join(allowed) if allowed else "a text"
        raise BadPack("E-CONF", _place(where, key), f"{_short(value)}; {wanted} is needed")
    return value


def nearest(word: str, known: list[str]) -> str:
    """`; nearest: ...`, or nothing if nothing is near."""
    near = difflib.get_close_matches(word, known, n=1)
    return f"; nearest: {near[0]}" if near else ""


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _place(where: str, key: str) -> str:
    return f"{where}.{key}" if where.endswith("]") or ":" in where else f"{where}:{key}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
