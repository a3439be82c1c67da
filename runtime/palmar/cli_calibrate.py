"""The verb that makes a user profile."""

from pathlib import Path
from typing import Annotated

import typer

from palmar.cli_app import HandName, Json, OutFile, app, parse_pairs


@app.command()
def calibrate(
    file: Annotated[
        Path | None,
        typer.Argument(help="Recording of an open hand, a fist and a pinch (log or trace), or a profile to add to."),
    ] = None,
    *,
    out: OutFile,
    name: Annotated[str, typer.Option(help="Of the user; the name of the output file if left out.")] = "",
    side: Annotated[str, typer.Option(help="right or left, if nothing is recorded.")] = "right",
    hand: HandName = None,
    hand_length_mm: Annotated[float | None, typer.Option(help="Wrist crease to middle fingertip.")] = None,
    hand_breadth_mm: Annotated[float | None, typer.Option(help="Across the knuckles, without the thumb.")] = None,
    length_mm: Annotated[
        list[str] | None,
        typer.Option(help="FINGER=A,B,C: from joint to joint and to the tip's ball. May be repeated."),
    ] = None,
    width_mm: Annotated[
        list[str] | None, typer.Option(help="FINGER=A,B,C,D: across the three joints and the tip. May be repeated.")
    ] = None,
    form: Annotated[
        str | None, typer.Option("--format", help="Name of the log's format; found from the file if left out.")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", help="key=value for the format's reader; may be repeated.")
    ] = None,
    json: Json = False,
) -> None:
    """Measurements or a short recording -> user profile, for `build --profile` and `import --profile`."""
    from palmar.calibrate import calibrate as make_profile
    from palmar.calibrate import print_calibration
    from palmar.files import require_file, require_place
    from palmar.terminal import print_json

    require_place(out)
    answer = make_profile(
        None if file is None else require_file(file),
        out,
        name=name or out.name.removesuffix(".toml"),
        side=side,
        hand_name=hand,
        hand_length_mm=hand_length_mm,
        hand_breadth_mm=hand_breadth_mm,
        lengths_mm=length_mm or [],
        widths_mm=width_mm or [],
        format=form,
        options=parse_pairs("--option", option or []),
    )
    print_json(answer) if json else print_calibration(answer)
