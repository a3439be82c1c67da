"""Verbs that make a pack, and the whole way at once."""

from pathlib import Path
from typing import Annotated

import typer

from palmar.cli_app import HandName, Json, Object, OutFile, OutFolder, Seed, UserProfile, app


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
    region: Annotated[
        list[Path] | None,
        typer.Option(
            help="CSV of balls (x_mm, y_mm, z_mm, radius_mm, share) in which the error is to be that share; "
            "or `painted`: where the mesh's vertices are painted."
        ),
    ] = None,
    touched: Annotated[
        list[Path] | None, typer.Option(help="Run whose contacts, 5 mm around, are to have a share of the error.")
    ] = None,
    touched_share: Annotated[float, typer.Option(help="The share of --touched.")] = 0.5,
    hand: HandName = None,
    profile: UserProfile = None,
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
            region=region or [],
            touched=touched or [],
            touched_share=touched_share,
            hand_path=hand,
            profile_path=profile,
            spheres_csv=spheres_csv,
            csv_units=csv_units,
            seed=seed,
            progress=progress,
        )
    print_json(answer) if json else print_build(answer)


@app.command("fit-hand")
def fit_hand(
    hand: Annotated[
        Path,
        typer.Argument(
            metavar="HAND.glb", help="Rigged hand: GLB or glTF with a skin; any mesh with --joints, a scan with --to."
        ),
    ],
    *,
    out: OutFile,
    units: Annotated[str, typer.Option(help="Unit of the file: m, cm, mm or in; glTF says m.")] = "m",
    names: Annotated[Path | None, typer.Option(help="TOML that tells the names of the rig's joints.")] = None,
    joints: Annotated[
        Path | None,
        typer.Option(help="CSV or JSON with places of joints, for a mesh without a skin (OBJ, PLY, STL, ...)."),
    ] = None,
    to: Annotated[
        Path | None, typer.Option(help="Pack of a fitted hand that is warped onto a scan; with --landmarks.")
    ] = None,
    landmarks: Annotated[Path | None, typer.Option(help="CSV or JSON: wrist and fingertips of the scan.")] = None,
    spheres: Annotated[int, typer.Option(min=1, help="Spheres of the palm, at most.")] = 250,
    report: Annotated[Path | None, typer.Option(help="Folder for figures, picture and map of the error.")] = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Hand mesh -> hand model with its own mesh, and how well the two agree."""
    from palmar.files import require_file, require_place
    from palmar.show import print_fit
    from palmar.terminal import print_json, progress_bar
    from palmar.tools.hand_fit import fit_hand as fit

    require_file(hand)
    require_place(out)
    with progress_bar(not json) as progress:
        answer = fit(
            hand,
            out,
            units=units,
            name_map=names,
            joints_path=joints,
            scan_to=to,
            landmarks=landmarks,
            spheres=spheres,
            report=report,
            seed=seed,
            progress=progress,
        )
    print_json(answer) if json else print_fit(answer)


@app.command()
def cover(
    file: Annotated[
        str, typer.Argument(metavar="PACK | MESH | shape:NAME", help="A pack's spheres, or a mesh that CSVs stand for.")
    ],
    *,
    out: OutFolder,
    spheres_csv: Annotated[
        list[Path] | None,
        typer.Option("--spheres-csv", help="Spheres x, y, z, radius of another tool, beside them. May be repeated."),
    ] = None,
    csv_units: Annotated[str, typer.Option(help="Unit of the spheres in the CSVs.")] = "m",
    name: Object = "",
    level: Annotated[
        list[int] | None, typer.Option("--level", help="Level instead of the leaves; may be repeated.")
    ] = None,
    bound: Annotated[
        bool, typer.Option("--bound", help="Also how few spheres any choice needs at the same error; takes minutes.")
    ] = False,
    units: Annotated[str | None, typer.Option(help="Unit of the mesh: m, cm, mm or in.")] = None,
    size_mm: Annotated[float | None, typer.Option(help="Length of the mesh's longest side instead of a unit.")] = None,
    close: Annotated[bool, typer.Option("--close", help="Close an open or self-overlapping mesh.")] = False,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """How well spheres stand for their mesh -> a page, pictures and maps coloured by error, cover.json."""
    from palmar.show import print_cover
    from palmar.terminal import print_json, progress_bar
    from palmar.tools.cover_report import write_cover

    with progress_bar(not json) as progress:
        answer = write_cover(
            file,
            out,
            object_name=name,
            levels=level or [],
            spheres_csv=spheres_csv or [],
            csv_units=csv_units,
            units=units,
            size_mm=size_mm,
            close=close,
            bound=bound,
            seed=seed,
            progress=progress,
        )
    print_json(answer) if json else print_cover(answer)
