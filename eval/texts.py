"""The templates of pages: read, and filled in."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

TEMPLATES = Path(__file__).parent / "template"


def read(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def fill(template: str, **values: Any) -> str:
    return Template(read(template)).substitute(values)
