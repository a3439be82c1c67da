"""What the verbs of the command line share: the application, common options, how a complaint is printed."""

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from palmar.errors import PalmarError

FAILED = 1
LOSS = 3

app = typer.Typer(
    help="Contact between a virtual hand and objects: build, replay, judge. Everything works on files.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

HandName = Annotated[
    str | None,
    typer.Option(
        "--hand", help="Hand as TOML or of a pack; or default, default:female-5, -50, -95, default:male-5, -50, -95."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
OutFile = Annotated[Path, typer.Option("--out", "-o", help="File to write.")]
OutFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder to write to; made if it is not there.")]
Object = Annotated[str, typer.Option("--object", help="Name of the object; needed if the pack has several.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")]
UserProfile = Annotated[
    Path | None, typer.Option("--profile", help="User profile (`palmar calibrate`) that the hand is made to fit.")
]


def complain(line: str, code: int) -> int:
    """One line on stderr, whatever the message holds."""
    print(" ".join(line.split()), file=sys.stderr)
    return code


def usage_line(error: typer.TyperException) -> str:
    """A mistake in flags or arguments as one line that names the command and, where there is one, the nearest word."""
    context = getattr(error, "ctx", None)
    where = context.command_path if context else "palmar"
    message = error.format_message().rstrip(".")
    return f"E-USAGE {where}: {message[:1].lower()}{message[1:]} (see {where} --help)"


def parse_pairs(flag: str, pairs: list[str]) -> dict[str, bool | int | float | str]:
    """`key=value` texts as values: true or false, a number where it reads as one, else the text.

    Keys and values are checked later, by whoever knows them.
    """
    values: dict[str, bool | int | float | str] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise PalmarError("E-USAGE", flag, f"{pair!r}; key=value is needed")
        if key in values:
            raise PalmarError("E-USAGE", flag, f"{key} is given twice; once is allowed")
        values[key] = text
        if text in ("true", "false"):
            values[key] = text == "true"
        elif re.fullmatch(r"[+-]?\d+", text):
            values[key] = int(text)
        elif re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", text, re.IGNORECASE):
            values[key] = float(text)
    return values
