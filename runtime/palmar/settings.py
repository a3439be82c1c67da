"""`key=value` texts of the command line as values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from palmar import _runtime
from palmar.errors import PalmarError
from palmar.files import nearest


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Settings from `key=value` texts, each of the type of its default. Raises PalmarError for a wrong key or value."""
    defaults = _runtime.default_settings()
    settings: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise PalmarError("E-USAGE", "--set", f"{pair!r}; key=value is needed")
        if key not in defaults:
            allowed = nearest(key, list(defaults)) or f"; allowed: {', '.join(defaults)}"
            raise PalmarError("E-USAGE", "--set", f"no setting {key!r}{allowed}")
        kind = type(defaults[key])
        try:
            settings[key] = kind(text)
        except ValueError:
            needed = "a whole number" if kind is int else "a number"
            raise PalmarError("E-USAGE", f"--set {key}", f"{text!r}; {needed} is needed") from None
    return settings


def parse_options(pairs: Sequence[str]) -> dict[str, Any]:
    """Options from `key=value` texts: a truth value, a number, else the text itself. `-` in a key stands for `_`."""
    options: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise PalmarError("E-USAGE", "--option", f"{pair!r}; key=value is needed")
        options[key.replace("-", "_")] = _value_of(text)
    return options


def _value_of(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
