"""The verb that compares solvers: speed against accuracy."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palmar.cli_app import Json, OutFolder, Seed, app, parse_pairs
from palmar.errors import PalmarError

SPHERES = [500, 3000, 30_000, 100_000]
QUALITIES = ["progressive:iterations=1"]


@app.command()
def chart(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[PACK...] [TRACE...]", help="Packs, and traces of their objects; built-in if none."),
    ] = None,
    *,
    out: OutFolder,
    solver: Annotated[list[str] | None, typer.Option("--solver", help="May be repeated; all if left out.")] = None,
    spheres: Annotated[
        list[int] | None,
        typer.Option("--spheres", min=1, help=f"Level to compare, by its count; {SPHERES} if left out."),
    ] = None,
    quality: Annotated[
        list[str] | None,
        typer.Option(
            "--quality", help=f"SOLVER:key=value,...: another dot for that solver; {QUALITIES} if left out, or none."
        ),
    ] = None,
    shape: Annotated[
        list[str] | None, typer.Option("--shape", help="Built-in object to make; may be repeated.")
    ] = None,
    grasps: Annotated[int, typer.Option("--grasps", min=0, help="Scripted grasps of objects without a trace.")] = 1,
    fingers: Annotated[bool, typer.Option(help="Measure the cost of one, two, five fingers and the hand.")] = True,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Timed replays of each cell.")] = 3,
    jobs: Annotated[int, typer.Option("--jobs", min=0, help="Cores to judge on; 0 for all. One times.")] = 0,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Speed against accuracy: solvers over levels on the same traces, as a page, figures and CSV. Can be resumed."""
    from palmar import _runtime
    from palmar.chart import Asked, make_chart
    from palmar.files import nearest
    from palmar.terminal import print_json, progress_bar
    from palmar.workers import cores

    known = _runtime.solver_names()
    for name in solver or []:
        if name not in known:
            found = f"no such solver{nearest(name, known)}; known are {', '.join(known)}"
            raise PalmarError("E-CONF", f"solver {name}", found)
    asked = Asked(
        solvers=tuple(dict.fromkeys(solver or known)),
        spheres=tuple(sorted(set(spheres or SPHERES))),
        qualities=_qualities(quality or QUALITIES, known),
        repeats=repeats,
        seed=seed,
        jobs=jobs or cores(),
    )
    with progress_bar(not json) as progress:
        answer = make_chart(
            files or [], out, asked, shapes=shape or [], grasps=grasps, fingers=fingers, progress=progress
        )
    if json:
        print_json(answer)
    else:
        print(answer["sentence"], *([answer["note"]] if answer["note"] else []), f"chart: {answer['page']}", sep="\n")


def _qualities(texts: list[str], known: list[str]) -> dict[str, list[dict[str, Any]]]:
    """SOLVER:key=value,... texts as settings of each solver; `none` for no quality beside the defaults."""
    found: dict[str, list[dict[str, Any]]] = {}
    for text in texts:
        solver, colon, pairs = text.partition(":")
        if text == "none":
            continue
        if not colon or solver not in known:
            allowed = f"SOLVER:key=value,... or none; solvers are {', '.join(known)}"
            raise PalmarError("E-USAGE", "--quality", f"{text!r}; {allowed}")
        found.setdefault(solver, []).append(parse_pairs("--quality", pairs.split(",")))
    return found
