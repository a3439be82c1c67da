"""The verb that finds the leanest model for some traces."""

from pathlib import Path
from typing import Annotated

import typer

from palmar.cli_app import FAILED, Json, Object, OutFolder, Seed, app, complain, parse_pairs
from palmar.errors import PalmarError


@app.command()
def tune(
    pack: Annotated[Path, typer.Argument(help="Pack with the hand and the object, as fine as it should be.")],
    traces: Annotated[list[Path], typer.Argument(metavar="TRACE...", help="What the model is needed for.")],
    *,
    out: OutFolder,
    holdout: Annotated[
        list[Path] | None, typer.Option("--holdout", help="Trace that it is tried on afterwards; may be repeated.")
    ] = None,
    limit: Annotated[
        list[str] | None, typer.Option("--limit", help="metric=value or metric.stat=value; may be repeated.")
    ] = None,
    margin: Annotated[
        float, typer.Option("--margin", min=0, max=0.9, help="Share of the room up to each limit that stays unused.")
    ] = 0.2,
    guard_mm: Annotated[
        float, typer.Option("--guard-mm", min=0.5, max=100, help="Fine so far around where hands came.")
    ] = 5.0,
    rest_mm: Annotated[
        float | None, typer.Option("--rest-mm", min=0.01, help="Error elsewhere; four fifths of the guard if left out.")
    ] = None,
    tries: Annotated[int, typer.Option("--tries", min=1, help="Models to judge, at most.")] = 20,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Timed replays of each model and trace.")] = 3,
    jobs: Annotated[int, typer.Option("--jobs", min=0, help="Cores to judge on; 0 for all. One times.")] = 0,
    name: Object = "",
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Pack + traces -> the leanest pack that keeps every limit on them, and a page. Can be resumed.

    The exit code is 1 if nothing leaner does.
    """
    from palmar.terminal import print_json, print_table, progress_bar
    from palmar.tune import Asked, tune
    from palmar.workers import cores

    if rest_mm is not None and rest_mm > guard_mm:
        found = f"{rest_mm:g}; up to the guard distance of {guard_mm:g} is allowed, or hands would meet the rest"
        raise PalmarError("E-CONF", "--rest-mm", found)
    asked = Asked(
        limits=_limits(limit or []),
        margin=margin,
        guard_mm=guard_mm,
        rest_mm=rest_mm,
        tries=tries,
        repeats=repeats,
        seed=seed,
        jobs=jobs or cores(),
    )
    with progress_bar(not json) as progress:
        answer = tune(pack, traces, out, asked, holdout=holdout or [], object_name=name, progress=progress)
    if json:
        print_json(answer)
    elif answer["pack"] is not None:
        columns = ["", "spheres", "bytes", "p50 us", "p99 us", "p99.9 us", "max us"]
        stats = ("cost_p50", "cost_p99", "p99.9", "max")
        print_table(
            columns,
            [
                (row["name"], row["spheres"], row["bytes"], *(round(row["times_us"][stat], 1) for stat in stats))
                for row in answer["stages"]
            ],
        )
        for said, names in (("tuned on", answer["traces"]), ("held out", answer["holdout"])):
            print(f"{said}: {', '.join(names) or 'none'}")
        print(answer["sentence"], *answer["promise"], *([answer["note"]] if answer["note"] else []), sep="\n")
        print(f"pack: {answer['pack']}", f"page: {answer['page']}", sep="\n")
    if answer["pack"] is None:
        return complain(f"E-TUNE-NONE {pack}: {answer['sentence']} page: {answer['page']}", FAILED)
    return 0


def _limits(texts: list[str]) -> dict[str, float]:
    """Texts metric=value as limits by "metric stat"."""
    from palmar.files import nearest
    from palmar.tune import limit_names

    names = limit_names()
    found: dict[str, float] = {}
    for key, value in parse_pairs("--limit", texts).items():
        if key not in names:
            allowed = ", ".join(name for name in names if "." not in name)
            raise PalmarError(
                "E-CONF", f"--limit {key}", f"no such limit{nearest(key, list(names))}; there are {allowed}"
            )
        if isinstance(value, bool | str) or not 0 <= value < 1e9:
            raise PalmarError("E-CONF", f"--limit {key}", f"{value!r}; a number from 0 is needed")
        found[names[key]] = float(value)
    return found
