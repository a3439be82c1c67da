"""Verbs that say whether something is as it was, or as it should be."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palmar.cli_app import FAILED, Json, app, parse_pairs
from palmar.errors import PalmarError


@app.command()
def check(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENE...", help="Names of scenes, TOML files, or traces with --golden; all if none."),
    ] = None,
    *,
    solver: Annotated[
        list[str] | None, typer.Option("--solver", help="Name of a solver; may be repeated. progressive if left out.")
    ] = None,
    suite: Annotated[str, typer.Option("--suite", help="Scenes to take if none is named: stability.")] = "stability",
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="key=value of any setting, over the scene's; may be repeated.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The first case of each scene, two starts of it.")] = False,
    starts: Annotated[int | None, typer.Option(min=1, help="Of each case, at most; all if left out.")] = None,
    jobs: Annotated[int, typer.Option(min=0, help="Cores to use; 0 for all.")] = 0,
    golden: Annotated[
        Path | None, typer.Option("--golden", help="CSV of expected numbers to compare with, instead of limits.")
    ] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Write the new numbers, and those of new SCENEs, into --golden.")
    ] = False,
    reason: Annotated[
        str | None, typer.Option("--reason", help="Why the numbers change; --update asks for it.")
    ] = None,
    pack: Annotated[Path | None, typer.Option("--pack", help="Pack of traces that are new to --golden.")] = None,
    junit: Annotated[Path | None, typer.Option("--junit", help="JUnit XML to write.")] = None,
    markdown: Annotated[Path | None, typer.Option("--markdown", help="Summary in Markdown to write.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the matrix, check.json and each cell's worst run.")
    ] = None,
    runs: Annotated[bool, typer.Option("--runs", help="Keep pack, trace and run of each cell's worst too.")] = False,
    json: Json = False,
) -> int:
    """Hard cases -> whether every limit holds, or golden numbers -> whether they are as before; else exit code 1."""
    from palmar.ci_files import of_golden, of_suite, write_junit, write_markdown
    from palmar.files import require_place
    from palmar.terminal import print_json, progress_bar

    for path in (junit, markdown):
        if path is not None:
            require_place(path)
    if runs and out is None:
        raise PalmarError("E-USAGE", "--runs", "goes with --out, the folder to keep them in")
    if golden is None and (update or reason is not None or pack is not None):
        raise PalmarError("E-USAGE", "--golden", "--update, --reason and --pack are about a file of golden numbers")
    say = (lambda line: None) if json else lambda line: print(line, flush=True)
    with progress_bar(not json) as progress:
        if golden is None:
            asked = _asked(setting or [], quick, starts, out, runs)
            answer = _suite(scenes or [], asked, solver or [], suite, jobs, progress, say)
        else:
            if quick or starts is not None or setting or runs or out is not None:
                raise PalmarError("E-USAGE", "--golden", "goes without --quick, --starts, --set, --out and --runs")
            answer = _golden(golden, scenes or [], pack, solver or [], _reason(reason, update), progress, say)
    verdicts = of_suite(answer) if golden is None else of_golden(answer)
    if junit is not None:
        write_junit(junit, verdicts)
    if markdown is not None:
        write_markdown(markdown, verdicts)
    if json:
        print_json(answer)
    elif "page" in answer:
        print(f"matrix: {answer['page']}")
    return 0 if answer["passed"] else FAILED


def _asked(settings: list[str], quick: bool, starts: int | None, out: Path | None, runs: bool) -> Any:
    from palmar.check_case import Asked
    from palmar.files import require_folder

    folder = None if out is None else require_folder(out)
    return Asked(parse_pairs("--set", settings), quick=quick, starts=starts, out=folder, runs=runs)


def _suite(
    scenes: list[str], asked: Any, solvers: list[str], suite: str, jobs: int, progress: Any, say: Any
) -> dict[str, Any]:
    from palmar.check import check_scenes
    from palmar.workers import cores

    if suite != "stability":
        raise PalmarError("E-USAGE", "--suite", f"{suite!r}; stability is the one there is")
    chosen = solvers or ["progressive"]
    return check_scenes(scenes, asked, solvers=chosen, jobs=jobs or cores(), progress=progress, say=say)


def _golden(
    path: Path, scenes: list[str], pack: Path | None, solvers: list[str], reason: str | None, progress: Any, say: Any
) -> dict[str, Any]:
    from palmar.files import require_place
    from palmar.golden import check_golden

    place = require_place(path)
    return check_golden(place, scenes, pack=pack, solvers=solvers, reason=reason, progress=progress, say=say)


def _reason(reason: str | None, update: bool) -> str | None:
    """The reason of an update, asked for where somebody can answer. Raises PalmarError E-USAGE if there is none."""
    import sys

    if not update:
        if reason is not None:
            raise PalmarError("E-USAGE", "--reason", "goes with --update")
        return None
    if reason is None and sys.stdin.isatty():
        reason = typer.prompt("Why do the numbers change?", err=True)
    if not reason or not reason.strip():
        raise PalmarError("E-USAGE", "--update", "says why in --reason TEXT; it is kept beside each new number")
    return " ".join(reason.split())


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A.run.mcap")],
    b: Annotated[Path, typer.Argument(metavar="B.run.mcap")],
    *,
    pack: Annotated[
        list[Path] | None, typer.Option("--pack", help="Pack of a run; also looked for beside it. May be repeated.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for a page of both.")] = None,
    json: Json = False,
) -> int:
    """Run against run: first differing step, largest differences, metrics; the exit code is 1 unless they are equal."""
    from palmar.compare import compare_files, print_comparison
    from palmar.terminal import print_json

    answer = compare_files(a, b, pack or [], out)
    print_json(answer) if json else print_comparison(answer)
    return 0 if answer["equal"] else FAILED
