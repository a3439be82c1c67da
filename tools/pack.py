"""The `build` verb: meshes -> solids -> SphereTrees, with a hand, in one pack."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh, BadPack, PalmarError
from palmar.files import sha256_of
from palmar.model import AssetPack, HandModel, SphereTree, save_pack
from palmar.pack_check import MAX_NAME, is_object_name
from palmar.profile import fit_to_profile
from palmar.tools.close import close_mesh, require_closed
from palmar.tools.cover import level_errors
from palmar.tools.default_hands import find_hand, is_default
from palmar.tools.mesh import Mesh, read_mesh
from palmar.tools.painted import PAINTED, read_painted
from palmar.tools.profile_file import read_profile
from palmar.tools.region import LEAST_SHARE, NO_REGIONS, TOUCHED_SHARE, Regions, read_regions
from palmar.tools.shapes import SHAPES
from palmar.tools.sphere_tree import MODES, build_levels, levels_over
from palmar.tools.spheres_csv import read_spheres_csv
from palmar.tools.toml_file import check_keys, get_number, get_text, nearest, read_toml

Progress = Callable[[str, float], None]

DEFAULT_ERROR_MM = 0.5
SHAPE = "shape:"
OBJECT_KEYS = (
    *("name", "mesh", "units", "size_mm", "close", "error_mm", "spheres", "mode", "spheres_csv", "csv_units"),
    *("region", "touched", "touched_share"),
)
# What the content of a pack depends on.
PACKAGES = ("palmar", "numpy", "scipy", "trimesh", "manifold3d", "libigl", "pygltflib")


@dataclass(frozen=True)
class Source:
    """One object to be built."""

    name: str
    mesh: str  # path, or `shape:NAME`
    units: str | None = None
    size_mm: float | None = None
    close: bool = False
    error_mm: float | None = None  # neither this nor spheres: DEFAULT_ERROR_MM
    spheres: int | None = None
    spheres_csv: str | None = None  # leaves as they are
    csv_units: str = "m"
    mode: str = "balanced"  # see `build_levels`
    region: tuple[str, ...] = ()  # CSV files, or PAINTED
    touched: tuple[str, ...] = ()  # runs
    touched_share: float = TOUCHED_SHARE


def build(
    meshes: Sequence[str | Path],
    out: str | Path,
    *,
    units: str | None = None,
    size_mm: float | None = None,
    close: bool = False,
    error_mm: float | None = None,
    spheres: int | None = None,
    mode: str = "balanced",
    region: Sequence[str | Path] = (),
    touched: Sequence[str | Path] = (),
    touched_share: float = TOUCHED_SHARE,
    hand_path: str | Path | None = None,
    profile_path: str | Path | None = None,
    spheres_csv: str | Path | None = None,
    csv_units: str = "m",
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Build a pack of meshes, of built-in shapes (`shape:NAME`), or of the objects that one TOML file lists.

    With a TOML file the other arguments stand for what it leaves open. hand_path: a hand TOML or the name of a built-in
    hand; profile_path: whom it is made to fit. Returns what `build_pack` does.
    Raises BadMesh, BadPack or PalmarError; nothing is written then.
    """
    csv = None if spheres_csv is None else str(spheres_csv)
    closer = (tuple(map(str, region)), tuple(map(str, touched)), touched_share)
    given = Source("", "", units, size_mm, close, error_mm, spheres, csv, csv_units, mode, *closer)
    if not meshes:
        raise PalmarError("E-CONF", "MESH", f"nothing to build; a mesh, a TOML list or {SHAPE}NAME is needed")
    if len(meshes) == 1 and str(meshes[0]).endswith(".toml"):
        sources, listed_hand = read_assets(meshes[0], given)
        hand_path = hand_path or listed_hand
    else:
        if csv and len(meshes) > 1:
            raise PalmarError("E-CONF", "--spheres-csv", f"{len(meshes)} meshes; spheres are of one mesh")
        sources = [replace(given, name=_name_of(str(mesh)), mesh=str(mesh)) for mesh in meshes]
    hand = find_hand(hand_path)
    if profile_path is not None:
        hand = fit_to_profile(hand, read_profile(profile_path))
    return build_pack(sources, out, hand=hand, seed=seed, progress=progress)


def build_pack(
    sources: Sequence[Source], out: str | Path, *, hand: HandModel, seed: int, progress: Progress | None = None
) -> dict[str, Any]:
    """Build every source, write the pack, and say what is in it, as JSON-able values.

    {"pack", "sha256", "bytes", "hand": {...}, "objects": {NAME: its part of the manifest}, "warnings": [...]}
    """
    out = Path(out)
    if out.is_dir() or not out.parent.is_dir():
        found = "is a folder" if out.is_dir() else f"the folder {out.parent} does not exist"
        raise PalmarError("E-FILE-PLACE", str(out), f"{found}; the name of a file in a folder is needed")
    for source in sources:
        _check_source(source)
        if out.exists() and any(
            Path(path).exists() and out.samefile(path)
            for path in (source.mesh, source.spheres_csv or "", *source.region, *source.touched)
        ):
            raise PalmarError("E-FILE-PLACE", str(out), "is read from; give the pack another name")
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise PalmarError(
                "E-CONF", name, f"{names.count(name)} objects have this name; name them apart in a TOML list"
            )
    say = progress or (lambda text, fraction: None)
    objects: dict[str, SphereTree] = {}
    warnings: list[str] = []
    for number, source in enumerate(sources):

        def report(text: str, fraction: float, number: int = number, name: str = source.name) -> None:
            say(f"{name}: {text}", (number + fraction) / len(sources))

        objects[source.name], warned = build_object(source, seed, report)
        warnings += warned
    say("writing", 1.0)
    tools = {package: version_of(package) for package in PACKAGES}
    sha256 = save_pack(out, AssetPack(hand, objects, {"tools": tools, "seed": seed}))
    return {
        "pack": str(out),
        "sha256": sha256,
        "bytes": out.stat().st_size,
        "hand": {**hand.about, "palm_spheres": len(hand.palm_spheres_m)},
        "objects": {name: tree.about for name, tree in objects.items()},
        "warnings": warnings,
    }


def build_object(source: Source, seed: int, progress: Progress) -> tuple[SphereTree, list[str]]:
    """The SphereTree of one source with its true mesh and its part of the manifest, and warnings."""
    mesh, closing, warnings = read_solid(source, seed, lambda text, part: progress(text, 0.3 * part))
    parameters: dict[str, Any]
    if source.spheres_csv is None:
        error_m = None if source.error_mm is None else source.error_mm / 1000
        if source.error_mm is None and source.spheres is None:
            error_m = DEFAULT_ERROR_MM / 1000
        levels, bounds, parameters = build_levels(
            mesh.vertices_m,
            mesh.faces,
            error_m=error_m,
            spheres=None if source.spheres is None else int(source.spheres),
            mode=source.mode,
            regions=_regions(source, mesh),
            seed=seed,
            progress=lambda text, part: progress(text, 0.3 + 0.5 * part),
        )
        method = str(parameters.pop("method", "built"))
        if source.spheres is not None and len(levels[-1]) < source.spheres:
            found = f"{len(levels[-1])} of {int(source.spheres)} spheres"
            warnings.append(f"{source.name}: {found}; more would only copy the facets of its mesh one by one")
        if source.region or source.touched:
            files = [Path(path) for path in (*source.region, *source.touched) if path != PAINTED]
            if PAINTED in source.region:
                parameters["painted"] = True
            parameters["region_files"] = [[path.name, sha256_of(path)] for path in files]
            parameters["touched_share"] = source.touched_share
    else:
        leaves, csv_sha256 = read_spheres_csv(source.spheres_csv, source.csv_units)
        check_place(source.spheres_csv, leaves, mesh.vertices_m)
        levels, bounds = levels_over(
            mesh.vertices_m, mesh.faces, leaves, seed, lambda text, part: progress(text, 0.3 + 0.5 * part)
        )
        method = "leaves as given"
        parameters = {"spheres_csv": Path(source.spheres_csv).name, "csv_sha256": csv_sha256}
    if closing:
        parameters = {**parameters, "closing": closing}
    progress("measuring the levels", 0.8)
    about = {
        "source": mesh.source,
        "sha256": mesh.sha256,
        "units": mesh.units,
        "metres_per_unit": mesh.metres_per_unit,
        "closed": tell_closing(closing) if closing else None,
        "method": method,
        "parameters": parameters,
        "levels": level_errors(levels, mesh.vertices_m, mesh.faces, seed),
    }
    return SphereTree(levels, bounds, mesh.vertices_m, mesh.faces, about), warnings


def _regions(source: Source, mesh: Mesh) -> Regions:
    painted = NO_REGIONS
    if PAINTED in source.region:
        if source.mesh.startswith(SHAPE):
            found = f"{PAINTED}; {source.mesh} has no paint, a mesh file with painted vertices is needed"
            raise PalmarError("E-CONF", "--region", found)
        painted = read_painted(source.mesh, mesh.metres_per_unit)
    files = [path for path in source.region if path != PAINTED]
    return read_regions(files, source.touched, source.touched_share, painted)


def read_solid(source: Source, seed: int, progress: Progress) -> tuple[Mesh, dict[str, Any] | None, list[str]]:
    """The mesh of a source, closed where it asks for that, what closing did, and warnings. Raises BadMesh."""
    progress("reading", 0.0)
    mesh = _shape(source) if source.mesh.startswith(SHAPE) else _read(source)
    closing: dict[str, Any] | None = None
    if source.close:
        mesh, closing = close_mesh(source.mesh, mesh, seed=seed, progress=progress)
    # What closing gave is held against the same gate as what came closed.
    require_closed(source.mesh, mesh, seed)
    return mesh, closing, closing.pop("warnings") if closing else []


def read_assets(path: str | Path, given: Source) -> tuple[list[Source], Path | None]:
    """The objects that a TOML file lists and its hand, paths relative to it; `given` stands for what it leaves open."""
    where, folder = str(path), Path(path).parent
    table, _ = read_toml(path)
    check_keys(where, table, ("hand", "object"), ("object",))
    listed = table["object"]
    if not isinstance(listed, list) or not listed:
        raise BadPack("E-CONF", f"{where}:object", "no objects; [[object]] with a mesh is needed")
    sources = []
    for number, row in enumerate(listed):
        at = f"{where}:object[{number}]"
        check_keys(at, row, OBJECT_KEYS, ("mesh",))
        mesh = get_text(at, row, "mesh")
        changes: dict[str, Any] = {key: get_text(at, row, key) for key in ("units", "csv_units", "mode") if key in row}
        changes |= {key: get_number(at, row, key, 0.0, 1e6) for key in ("size_mm", "error_mm", "spheres") if key in row}
        changes |= {key: _get_paths(at, row, key, folder) for key in ("region", "touched") if key in row}
        if "touched_share" in row:
            changes["touched_share"] = get_number(at, row, "touched_share", LEAST_SHARE, 1.0)
        if "spheres_csv" in row:
            changes["spheres_csv"] = str(folder / get_text(at, row, "spheres_csv"))
        if "close" in row and not isinstance(row["close"], bool):
            raise BadPack("E-CONF", f"{at}.close", f"{row['close']!r}; true or false is needed")
        # What the row says of its size or its spheres replaces all that was given of them.
        if {"units", "size_mm"} & row.keys():
            changes = {"units": None, "size_mm": None, **changes}
        if {"error_mm", "spheres", "spheres_csv"} & row.keys():
            changes = {"error_mm": None, "spheres": None, "spheres_csv": None, **changes}
        changes["close"] = row.get("close", given.close)
        changes["name"] = get_text(at, row, "name") if "name" in row else _name_of(mesh)
        changes["mesh"] = mesh if mesh.startswith(SHAPE) else str(folder / mesh)
        sources.append(replace(given, **changes))
    if "hand" not in table:
        return sources, None
    hand = get_text(where, table, "hand")
    return sources, Path(hand) if is_default(hand) else folder / hand


def _get_paths(at: str, row: dict[str, Any], key: str, folder: Path) -> tuple[str, ...]:
    """One path or a list of them, relative to the folder."""
    listed = row[key] if isinstance(row[key], list) else [row[key]]
    if not all(isinstance(path, str) and path for path in listed):
        raise BadPack("E-CONF", f"{at}.{key}", f"{row[key]!r}; a path or a list of paths is needed")
    return tuple(path if path == PAINTED else str(folder / path) for path in listed)


def _check_source(source: Source) -> None:
    wanted = {"--error-mm": source.error_mm, "--spheres": source.spheres, "--spheres-csv": source.spheres_csv}
    asked = [flag for flag, value in wanted.items() if value is not None]
    if len(asked) > 1:
        raise PalmarError(
            "E-CONF", asked[0], f"together with {asked[1]}; one of them settles the spheres of {source.name}"
        )
    if source.error_mm is not None and not 0 < source.error_mm <= 100:
        raise PalmarError("E-CONF", "--error-mm", f"{source.error_mm:g}; above 0 and up to 100 mm is allowed")
    if source.spheres is not None and not (source.spheres >= 1 and source.spheres == int(source.spheres)):
        raise PalmarError("E-CONF", "--spheres", f"{source.spheres:g}; a whole number from 1 is needed")
    if not LEAST_SHARE <= source.touched_share <= 1:
        found = f"{source.touched_share:g}; {LEAST_SHARE} to 1 is allowed"
        raise PalmarError("E-CONF", "--touched-share", found)
    if source.spheres_csv is not None and (source.region or source.touched):
        flag = "--region" if source.region else "--touched"
        raise PalmarError("E-CONF", flag, f"together with --spheres-csv; the spheres of {source.name} are given")
    if source.mode not in MODES:
        raise PalmarError("E-CONF", "--mode", f"{source.mode!r}; one of {', '.join(MODES)} is needed")
    name = source.name
    if not is_object_name(name):
        raise PalmarError(
            "E-CONF", f"name {name[:40]!r}", f"1 to {MAX_NAME} bytes that can be printed, no /, are needed"
        )


def check_place(spheres_csv: str, leaves: NDArray[np.float64], vertices_m: NDArray[np.float64]) -> None:
    """Raise BadPack if most spheres are far from the mesh: then their unit or their frame is another."""
    size = float(np.ptp(vertices_m, axis=0).max())
    low, high = vertices_m.min(axis=0) - 0.1 * size, vertices_m.max(axis=0) + 0.1 * size
    near = ((leaves[:, :3] >= low) & (leaves[:, :3] <= high)).all(axis=1) & (leaves[:, 3] <= size)
    span = float(np.ptp(leaves[:, :3], axis=0).max() + 2 * leaves[:, 3].max())
    if near.mean() < 0.5 or span < 0.1 * size:
        spans = f"its spheres span {1000 * span:.4g} mm, the mesh {1000 * size:.4g} mm"
        found = f"{spans}, {near.mean():.0%} are near it"
        needed = "the frame of the mesh and the right --csv-units are needed"
        raise BadPack("E-CSV-UNITS", spheres_csv, f"{found}; {needed}")


def _read(source: Source) -> Mesh:
    return read_mesh(source.mesh, units=source.units, size_mm=source.size_mm)


def _shape(source: Source) -> Mesh:
    name = source.mesh.removeprefix(SHAPE)
    if name not in SHAPES:
        known = ", ".join(SHAPES)
        raise BadMesh("E-MESH-SHAPE", source.mesh, f"no such shape{nearest(name, list(SHAPES))}; known are {known}")
    vertices, faces = SHAPES[name]()
    sha256 = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()
    mesh = Mesh(vertices, faces, source.mesh, sha256, "m", 1.0)
    if source.size_mm is None:
        return mesh
    scale = source.size_mm / 1000 / mesh.size_m
    return replace(mesh, vertices_m=vertices * scale, units="size", metres_per_unit=scale)


def _name_of(mesh: str) -> str:
    if mesh.startswith(SHAPE):
        return mesh.removeprefix(SHAPE)
    name = Path(mesh).name
    return Path(name.removesuffix(".gz")).stem


def tell_closing(closing: dict[str, Any]) -> str:
    """One line for the manifest; the figures stand in its parameters."""
    lost, new = (closing["moved_mm"][key]["max"] for key in ("mesh_to_solid", "solid_to_mesh"))
    done = closing["how"] + (f" on a grid of {closing['cell_mm']:.2g} mm" if "cell_mm" in closing else "")
    steps = "".join(f", {step}" for step in closing["repairs"])
    return f"{done}{steps}; mesh to solid {lost:.2f} mm, solid to mesh {new:.2f} mm at most"


def version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
