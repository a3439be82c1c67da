"""What the command line prints: tables on stdout, progress bars on stderr and only where a person looks at it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

Progress = Callable[[str, float], None]


@contextmanager
def progress_bar(wanted: bool = True) -> Iterator[Progress]:
    """A bar on stderr that goes away when the work ends; call it with (what is done now, fraction from 0 to 1).

    Silent when stderr is not a terminal or `wanted` is false.
    """
    if not (wanted and sys.stderr.isatty()):
        yield lambda text, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda text, fraction: bar.update(task, description=text, completed=fraction)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[Any]], title: str = "") -> None:
    """Aligned columns; numbers to the right."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for k, column in enumerate(columns):
        numeric = bool(rows) and all(isinstance(row[k], int | float) or row[k] == "" for row in rows)
        table.add_column(escape(column), justify="right" if numeric else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(escape(cell(value)) for value in row))
    # Into a pipe or a file the table is as wide as it needs to be: nothing is cut off.
    console = Console(width=None if sys.stdout.isatty() else 400, highlight=False)
    with console.capture() as text:
        console.print(table)
    print(*(line.rstrip() for line in text.get().splitlines()), sep="\n")


def print_fields(fields: dict[str, Any]) -> None:
    """One `name  value` a line, aligned; of a list or a dict one entry a line, and none of an empty one."""
    width = max((len(name) for name in fields), default=0)
    for name, value in fields.items():
        parts = [f"{key}: {cell(part)}" for key, part in value.items()] if isinstance(value, dict) else value
        for number, part in enumerate(parts if isinstance(parts, list) else [parts]):
            print(f"{'' if number else name:<{width}}  {cell(part)}")


def print_json(answer: dict[str, Any]) -> None:
    print(json.dumps(answer, sort_keys=True))


def cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
