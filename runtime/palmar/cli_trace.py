"""Verbs about what a device said: a log, a script, a file looked into, a file handed on."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from palmar.cli_app import (
    LOSS,
    HandName,
    Json,
    Object,
    OutFile,
    OutFolder,
    Seed,
    UserProfile,
    app,
    complain,
    parse_pairs,
)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="Log of another device.")],
    *,
    out: OutFile,
    form: Annotated[
        str | None,
        typer.Option(
            "--format", help="Name of the format, or TOML map of a CSV's columns; found from the file if none."
        ),
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", help="key=value for the format's reader; may be repeated.")
    ] = None,
    hand: HandName = None,
    profile: UserProfile = None,
    grasp: Annotated[
        Path | None, typer.Option(help="Pack whose object is put where the recorded hand closes most.")
    ] = None,
    name: Object = "",
    json: Json = False,
) -> None:
    """Foreign log -> trace; of positions the angles are solved for, of the hand that --profile or --hand names."""
    from palmar.files import require_file, require_place
    from palmar.importing import import_log
    from palmar.show import print_residuals
    from palmar.terminal import print_fields, print_json

    require_place(out)
    answer = import_log(
        require_file(file),
        out,
        format=form,
        options=parse_pairs("--option", option or []),
        hand_name=hand,
        profile_path=profile,
        grasp=grasp and require_file(grasp),
        object_name=name,
    )
    if json:
        print_json(answer)
    else:
        for warning in answer.pop("warnings"):
            print(f"warning: {warning}", file=sys.stderr)
        if "residual_mm" in answer:
            print_residuals(answer.pop("residual_mm"))
        print_fields(answer)


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
def disturb(
    trace: Annotated[Path, typer.Argument(help="Any trace.")],
    faults: Annotated[Path, typer.Argument(help="TOML file with [[disturbance]] tables, as in a scene.")],
    *,
    out: OutFile,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Trace with faults of sensors, links and clocks put into it -> what a receiver of such samples makes of it."""
    from palmar.files import require_file, require_place
    from palmar.terminal import print_fields, print_json
    from palmar.traces.disturb import disturb_file

    require_place(out)
    answer = disturb_file(require_file(trace), require_file(faults), out, seed)
    print_json(answer) if json else print_fields(answer)


@app.command()
def recover(
    trace: Annotated[Path, typer.Argument(help="Truncated or damaged trace.")],
    *,
    out: OutFile,
    header_of: Annotated[
        Path | None, typer.Option(help="Sound trace of the same device and hand, if the damaged one lost its header.")
    ] = None,
    json: Json = False,
) -> int:
    """Damaged trace -> a sound one, opened again and checked. Exit code 3 if something was lost, 0 if nothing was."""
    from palmar.files import lost_line, require_file, require_place
    from palmar.recover import recover_file
    from palmar.terminal import print_fields, print_json

    require_place(out)
    answer = recover_file(require_file(trace), out, header_of and require_file(header_of))
    damage = lost_line(trace, answer["lost"])
    print_json(answer) if json else print_fields({name: answer[name] for name in answer if name != "lost"})
    return complain(damage, LOSS) if damage else 0


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
    form: Annotated[str, typer.Option("--format", help="csv, json or parquet.")] = "csv",
    json: Json = False,
) -> int:
    """Spheres of a pack, poses of a run or samples of a trace as a table, every number in full."""
    from palmar.export import export_file
    from palmar.files import load_any, lost_line, require_folder
    from palmar.terminal import print_json

    content = load_any(file)
    written = [str(path) for path in export_file(content, file, require_folder(out), name, level, form)]
    print_json({"written": written}) if json else print(*written, sep="\n")
    damage = lost_line(file, getattr(content, "lost", {}))
    return complain(damage, LOSS) if damage else 0
