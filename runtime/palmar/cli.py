"""The command line. It knows every stage; each verb imports its stage only when it runs.

Exit codes: 0 fine; 1 a limit of a scene does not hold; 2 bad input, with one line on stderr; 3 recovered with loss;
70 a bug of Palmar; 130 Ctrl-C.
"""

import os
import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from palmar.errors import PalmarError

FAILED = 1
LOSS = 3
BUG = 70
STOPPED = 130

app = typer.Typer(
    help="Contact between a virtual hand and objects: build, replay, judge. Everything works on files.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
OutFile = Annotated[Path, typer.Option("--out", "-o", help="File to write.")]
OutFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder to write to; made if it is not there.")]
Object = Annotated[str, typer.Option("--object", help="Name of the object; needed if the pack has several.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")]


def main() -> None:
    """Run a command line and exit with its code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run a command line and return its exit code."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        code = app(arguments, prog_name="palmar", standalone_mode=False)
        sys.stdout.flush()
        return code or 0
    except PalmarError as error:
        return complain(str(error), error.exit_code)
    except typer.TyperException as error:
        return complain(usage_line(error), 2)
    except BrokenPipeError:
        # The reader of our output (a pager, head) has had enough; nothing more may go there, not even at Python's end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return complain(f"E-FILE {error.filename or 'file'}: {error.strerror or error}", 2)
    except KeyboardInterrupt:
        return STOPPED
    except BaseException as error:  # the outermost door: what arrives here is our own mistake
        if debug or isinstance(error, SystemExit):
            raise
        what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return complain(
            f"E-BUG palmar: {what}; this is a bug of Palmar, not of your files: run again with --debug and report it",
            BUG,
        )


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
        values[key] = text
        if text in ("true", "false"):
            values[key] = text == "true"
        elif re.fullmatch(r"[+-]?\d+", text):
            values[key] = int(text)
        elif re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", text, re.IGNORECASE):
            values[key] = float(text)
    return values


def print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"palmar {version('palmar')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print it.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback if Palmar itself fails; may stand anywhere.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(out: OutFolder = Path("demo"), seed: Seed = 0, json: Json = False) -> None:
    """The whole way on built-in objects and a scripted grasp: pack, trace, run, report."""
    from palmar.demo import make_demo
    from palmar.files import require_folder
    from palmar.terminal import print_json, progress_bar

    require_folder(out)
    with progress_bar(not json) as progress:
        answer = make_demo(out, seed=seed, progress=progress, say=(lambda line: None) if json else print)
    if json:
        print_json(answer)


@app.command()
def build(
    meshes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="MESH... | ASSETS.toml | shape:NAME...", help="Meshes, one list of them, or built-in shapes."
        ),
    ] = None,
    *,
    out: OutFile,
    units: Annotated[str | None, typer.Option(help="Unit of the meshes: m, cm, mm or in.")] = None,
    size_mm: Annotated[float | None, typer.Option(help="Length of the longest side instead of a unit.")] = None,
    close: Annotated[
        bool, typer.Option("--close", help="Close an open or self-overlapping mesh instead of refusing it.")
    ] = False,
    error_mm: Annotated[float | None, typer.Option(help="Largest error of the sphere model.")] = None,
    spheres: Annotated[int | None, typer.Option(help="Number of leaf spheres instead of an error.")] = None,
    mode: Annotated[
        str, typer.Option(help="balanced: least error both ways; inside: nothing sticks out; outside: covers the mesh.")
    ] = "balanced",
    hand: Annotated[Path | None, typer.Option(help="Hand as TOML; the default hand if left out.")] = None,
    spheres_csv: Annotated[
        Path | None, typer.Option(help="Leaf spheres x, y, z, radius as they are, of the one mesh given.")
    ] = None,
    csv_units: Annotated[str, typer.Option(help="Unit of the spheres in the CSV.")] = "m",
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Meshes -> pack, with the error of each level."""
    from palmar.show import print_build
    from palmar.terminal import print_json, progress_bar
    from palmar.tools.pack import build as build_pack

    with progress_bar(not json) as progress:
        answer = build_pack(
            meshes or [],
            out,
            units=units,
            size_mm=size_mm,
            close=close,
            error_mm=error_mm,
            spheres=spheres,
            mode=mode,
            hand_path=hand,
            spheres_csv=spheres_csv,
            csv_units=csv_units,
            seed=seed,
            progress=progress,
        )
    print_json(answer) if json else print_build(answer)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="Log of another device.")],
    *,
    out: OutFile,
    form: Annotated[
        str | None, typer.Option("--format", help="Name of the format; found from the file if left out.")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", help="key=value for the format's reader; may be repeated.")
    ] = None,
    json: Json = False,
) -> None:
    """Foreign log -> trace."""
    from palmar.files import require_file, require_place
    from palmar.terminal import print_fields, print_json
    from palmar.traces.device import import_file

    require_place(out)
    answer = import_file(require_file(file), out, format=form, **parse_pairs("--option", option or []))
    print_json(answer) if json else print_fields(answer)


@app.command()
def script(
    scene: Annotated[str, typer.Argument(help="Name of a scene, such as grasp, or a TOML file.")],
    pack: Annotated[Path, typer.Argument(help="Pack with the hand and the object.")],
    *,
    out: OutFile,
    name: Object = "",
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Scene script -> trace, made to fit an object of a pack."""
    from palmar.files import require_file, require_place
    from palmar.terminal import print_fields, print_json
    from palmar.traces.scripted import script as write_script

    require_place(out)
    answer = write_script(scene, require_file(pack), out, object=name or None, seed=seed)
    print_json(answer) if json else print_fields(answer)


@app.command()
def replay(
    pack: Annotated[Path, typer.Argument(help="Pack with the hand and the object.")],
    trace: Annotated[Path, typer.Argument(help="Trace of the haptic hand.")],
    *,
    out: OutFile,
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
    """Pack + trace -> run. A damaged trace is refused unless its loss is accepted; the exit code is 3 either way."""
    from palmar.files import lost_line, require_file, require_place
    from palmar.records import read_trace
    from palmar.replay import object_of, replay_file
    from palmar.show import print_replay
    from palmar.terminal import print_json, progress_bar

    named = [f"solver={solver}", f"resample={resample}", *([f"level={level}"] if level is not None else [])]
    settings = parse_pairs("--set", [*named, *(setting or [])])
    require_file(pack)
    require_place(out)
    samples = read_trace(require_file(trace))
    damage = lost_line(trace, samples.lost)
    if damage and not accept_loss:
        return complain(f"{damage}; nothing was written: pass --accept-loss to replay what is left", LOSS)
    with progress_bar(not json) as progress:
        name = name or object_of(samples, pack)
        answer = replay_file(pack, trace, out, object_name=name, settings=settings, progress=progress)
    print_json(answer) if json else print_replay(answer)
    return complain(damage, LOSS) if damage else 0


@app.command()
def report(
    runs: Annotated[list[Path], typer.Argument(help="Runs to judge.")],
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
    json: Json = False,
) -> None:
    """Runs -> a page, figures, tables and metrics.json."""
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
        print(*(f"{run['run']}: {run['verdict']}" for run in answer["runs"]), f"report: {answer['page']}", sep="\n")


@app.command()
def check(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="SCENE...", help="Names of scenes or TOML files; the suite if none.")
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
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for check.json and each scene's worst run.")
    ] = None,
    json: Json = False,
) -> int:
    """Hard cases -> whether every limit holds; the exit code is 1 where one does not."""
    from palmar.check import check_scenes
    from palmar.files import require_folder
    from palmar.terminal import print_json, progress_bar

    if suite != "stability":
        raise PalmarError("E-USAGE", "--suite", f"{suite!r}; stability is the one there is")
    if out is not None:
        require_folder(out)
    settings = parse_pairs("--set", setting or [])
    with progress_bar(not json) as progress:
        answer = check_scenes(
            scenes or [],
            solvers=solver or ["progressive"],
            settings=settings,
            quick=quick,
            out=out,
            progress=progress,
            say=(lambda line: None) if json else lambda line: print(line, flush=True),
        )
    if json:
        print_json(answer)
    return 0 if answer["passed"] else FAILED


@app.command()
def show(file: Annotated[Path, typer.Argument(help="Pack, trace or run.")], json: Json = False) -> int:
    """What is in a pack, a trace or a run."""
    from palmar.files import load_any, lost_line
    from palmar.show import describe, print_description
    from palmar.terminal import print_json

    content = load_any(file)
    description = describe(content)
    print_json(description) if json else print_description(description)
    damage = lost_line(file, getattr(content, "lost", {}))
    return complain(damage, LOSS) if damage else 0


@app.command()
def export(
    file: Annotated[Path, typer.Argument(help="Pack, trace or run.")],
    *,
    out: OutFolder,
    name: Annotated[str, typer.Option("--object", help="One object of a pack; all if left out.")] = "",
    level: Annotated[int | None, typer.Option(min=0, help="Level of the spheres; the leaves if left out.")] = None,
    json: Json = False,
) -> int:
    """Spheres of a pack, poses of a run or samples of a trace as CSV, every number in full."""
    from palmar.export import export_file
    from palmar.files import load_any, lost_line, require_folder
    from palmar.terminal import print_json

    content = load_any(file)
    written = [str(path) for path in export_file(content, file, require_folder(out), name, level)]
    print_json({"written": written}) if json else print(*written, sep="\n")
    damage = lost_line(file, getattr(content, "lost", {}))
    return complain(damage, LOSS) if damage else 0
