"""Verbs that replay and report."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from palmar.cli_app import FAILED, LOSS, Json, Object, OutFolder, Seed, app, complain, parse_pairs
from palmar.errors import PalmarError


@app.command()
def replay(
    pack: Annotated[Path, typer.Argument(help="Pack with the hand and the object.")],
    trace: Annotated[Path, typer.Argument(help="Trace of the haptic hand.")],
    *,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Run to write.")] = None,
    verify: Annotated[
        Path | None, typer.Option(help="Run to compare with, step by step; solver, settings and object are its own.")
    ] = None,
    name: Object = "",
    solver: Annotated[str, typer.Option(help="Name of the solver.")] = "progressive",
    resample: Annotated[str, typer.Option(help="Samples onto the steps: pchip, linear or hold.")] = "pchip",
    level: Annotated[int | None, typer.Option(help="Level of the object's SphereTree; the leaves if left out.")] = None,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="key=value of any setting; may be repeated.")
    ] = None,
    accept_loss: Annotated[bool, typer.Option("--accept-loss", help="Replay what is left of a damaged trace.")] = False,
    json: Json = False,
) -> int:
    """Pack + trace -> run. A damaged trace is refused unless its loss is accepted; the exit code is 3 either way.

    With --verify nothing is written: the exit code is 1 if any step of that run differs from what comes out now.
    """
    from palmar.files import lost_line, require_file, require_place
    from palmar.lean import beyond_line, lean_settings
    from palmar.model import load_pack
    from palmar.records import read_trace
    from palmar.replay import hand_warning, object_of, replay_file, require_side
    from palmar.show import print_replay
    from palmar.terminal import print_json, progress_bar

    if verify is not None:
        if out or name or setting or level is not None or (solver, resample) != ("progressive", "pchip"):
            raise PalmarError("E-USAGE", "--verify", "solver, settings and object are those of the run; give no others")
        return _verify(require_file(verify), require_file(pack), require_file(trace), json)
    if out is None:
        raise PalmarError("E-USAGE", "palmar replay", "no --out (-o); the name of the run is needed, or --verify RUN")
    named = [f"solver={solver}", f"resample={resample}", *([f"level={level}"] if level is not None else [])]
    own = parse_pairs("--set", named) | parse_pairs("--set", setting or [])
    require_file(pack)
    require_place(out)
    samples = read_trace(require_file(trace))
    damage = lost_line(trace, samples.lost)
    if damage and not accept_loss:
        return complain(f"{damage}; nothing was written: pass --accept-loss to replay what is left", LOSS)
    require_side(samples, trace, pack)
    warning = hand_warning(samples, pack)
    if warning:
        print(f"warning: {warning}", file=sys.stderr)
    with progress_bar(not json) as progress:
        name = name or object_of(samples, pack)
        settings = lean_settings(load_pack(pack), name, own)
        answer = replay_file(pack, trace, out, object_name=name, settings=settings, progress=progress)
    beyond = beyond_line(out, load_pack(pack), name)
    if beyond:
        print(f"warning: {beyond}", file=sys.stderr)
    print_json(answer) if json else print_replay(answer)
    return complain(damage, LOSS) if damage else 0


def _verify(run: Path, pack: Path, trace: Path, json: bool) -> int:
    from palmar.files import lost_line
    from palmar.terminal import print_json
    from palmar.verify import differing_line, verify_run

    answer = verify_run(run, pack, trace)
    differing, damage = differing_line(answer), lost_line(run, answer["lost"])
    if json:
        print_json(answer)
    elif not differing:
        print(f"{run}: all {answer['steps']} steps are the same, bit for bit")
    if differing:
        return complain(differing, FAILED)
    return complain(damage, LOSS) if damage else 0


@app.command()
def report(
    runs: Annotated[
        list[Path] | None, typer.Argument(help="Runs to judge; with --paper packs and traces, built-in ones if none.")
    ] = None,
    *,
    out: OutFolder,
    pack: Annotated[
        list[Path] | None,
        typer.Option("--pack", help="Pack that a run was made with; also looked for beside the run. May be repeated."),
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option("--reference", help="Run of the same trace to compare the cost with. May be repeated."),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's experiments again: its figures and table, of these objects.")
    ] = False,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Timed replays of each, with --paper.")] = 3,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Runs -> a page, figures, tables and metrics.json."""
    if paper:
        if pack or reference:
            raise PalmarError("E-USAGE", "--paper", "goes without --pack and --reference; packs are arguments")
        return _paper(runs or [], out, repeats, seed, json)
    if not runs:
        raise PalmarError("E-USAGE", "palmar report", "no RUN; name runs, or pass --paper")
    from palmar.eval.report import write_report
    from palmar.files import find_packs, require_file, require_folder
    from palmar.reference import same_start
    from palmar.terminal import print_json, progress_bar

    pairs = find_packs(runs, pack or [])
    require_folder(out)
    with progress_bar(not json) as progress:
        answer = write_report(
            pairs,
            out,
            progress=lambda done, total, what: progress(what, done / total),
            same_start=same_start,
            references=[require_file(path) for path in reference or []],
        )
    if json:
        print_json(answer)
    else:
        for told in answer["runs"]:
            print(f"{told['run']}: {told['verdict']}", *_recomputed(told["recomputed"]), sep="\n")
        print(f"report: {answer['page']}")


def _recomputed(found: dict[str, Any] | None) -> list[str]:
    if not found or not found["contacts"]:
        return []
    same = "equal" if found["same"] else "NOT equal"
    said = f"gaps {same} to {found['gap_mm']:.2g} mm (allowed {found['tolerance_mm']:g})"
    return [f"recomputed: {found['contacts']:,} contacts of {found['steps']:,} random steps, {said}"]


def _paper(files: list[Path], out: Path, repeats: int, seed: int, json: bool) -> None:
    from palmar.paper import make_paper
    from palmar.terminal import print_json, print_table, progress_bar

    with progress_bar(not json) as progress:
        answer = make_paper(files, out, repeats=repeats, seed=seed, progress=progress)
    if json:
        print_json(answer)
        return
    if answer["table"]:
        print_table(list(answer["table"][0]), [list(row.values()) for row in answer["table"]])
    print(
        *answer["figures"].values(),
        *([answer["note"]] if answer["note"] else []),
        f"report: {answer['page']}",
        sep="\n",
    )
