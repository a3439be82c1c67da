"""The `cover` verb: how well spheres stand for a mesh, of a pack and of other tools, side by side, in one folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import PalmarError
from palmar.files import nearest, require_file, whole_folder
from palmar.model import AssetPack, SphereTree, load_pack
from palmar.tools.cover import measure_cover
from palmar.tools.cover_map import write_map
from palmar.tools.cover_page import build_page
from palmar.tools.cover_picture import colour, colour_limit, draw_cover
from palmar.tools.cover_place import MM, surface_errors, worst_places
from palmar.tools.cover_tree import check_tree
from palmar.tools.dual_bound import MOST_BALLS, least_spheres
from palmar.tools.mesh_files import CHECKS
from palmar.tools.pack import SHAPE, Source, check_place, read_solid, tell_closing
from palmar.tools.solid import Solid, make_solid, smooth_normals
from palmar.tools.spheres_csv import read_spheres_csv
from palmar.unwrap import unwrap

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

OF_A_COVER = {"index.html", "cover.json", "pictures", "maps"}
_TEXELS = 250_000  # of the surface, about
# Below this nothing is worth a place in a list.
_LEAST_OF_SIZE = 1e-6
_FADE = 4.0


@dataclass(frozen=True)
class Cover:
    """Spheres (n, 4) that stand for the mesh, under a name; `about`: where they are from."""

    name: str
    spheres: Array
    about: dict[str, Any]
    tree: SphereTree | None = None


@dataclass(frozen=True)
class Subject:
    """The closed mesh that covers are measured against, what is known of it, and the covers that came with it."""

    where: str
    vertices_m: Array
    faces: NDArray[np.int32]
    about: dict[str, Any]
    covers: list[Cover] = field(default_factory=list)


def write_cover(
    path: str,
    out: str | Path,
    *,
    object_name: str = "",
    levels: Sequence[int] = (),
    spheres_csv: Sequence[str | Path] = (),
    csv_units: str = "m",
    units: str | None = None,
    size_mm: float | None = None,
    close: bool = False,
    bound: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the leaves (or levels) of a pack's object, and spheres of CSV files, against its true mesh.

    path: a pack; or a mesh or `shape:NAME`, for which at least one CSV is needed. csv_units, units, size_mm and close
    as in `build`. bound: also the least number of spheres that any choice needs for each cover's error. Writes
    index.html, cover.json, pictures/NAME.png and maps/NAME.exr into the folder, which appears whole or not at all, and
    returns the content of cover.json and "page". Raises BadPack, BadMesh or PalmarError.
    """
    tell = progress or (lambda text, fraction: None)
    tell("reading", 0.0)
    with whole_folder(Path(out), OF_A_COVER, "cover report") as folder:
        if _is_mesh(path):
            subject = _of_mesh(Source("", path, units, size_mm, close), seed)
        else:
            given = {"--units": units, "--size-mm": size_mm, "--close": close or None}
            asked = [flag for flag, value in given.items() if value is not None]
            if asked:
                raise PalmarError("E-USAGE", asked[0], f"{path} is taken for a pack; this is of a mesh file alone")
            subject = _of_pack(path, object_name, levels)
        covers = _named_apart([*subject.covers, *_read_csvs(spheres_csv, csv_units, subject)])
        if not covers:
            raise PalmarError("E-USAGE", "--spheres-csv", f"{path} holds a mesh alone; spheres to measure are needed")
        crowded = [cover.name for cover in covers if bound and len(cover.spheres) > MOST_BALLS]
        if crowded:
            raise PalmarError(
                "E-CONF", "--bound", f"{crowded[0]} has more than {MOST_BALLS:,} spheres; up to that it is found"
            )
        answer = _measure_all(subject, covers, folder, bound, seed, tell)
        (folder / "cover.json").write_text(json.dumps(answer, indent=1, sort_keys=True) + "\n")
        (folder / "index.html").write_text(build_page(answer, folder), encoding="utf-8")
    return {**answer, "page": str(Path(out) / "index.html")}


def _measure_all(
    subject: Subject, covers: list[Cover], folder: Path, bound: bool, seed: int, tell: Progress
) -> dict[str, Any]:
    solid = make_solid(subject.vertices_m, subject.faces)
    surface = unwrap(solid.vertices, solid.faces, _TEXELS)
    normals = smooth_normals(solid, surface.points, surface.face)
    steps = 3 * len(covers)
    rows: list[dict[str, Any]] = []
    for number, cover in enumerate(covers):
        tell(f"{cover.name}: measuring", number / steps)
        figures = measure_cover(solid, cover.spheres, seed)
        if cover.tree:
            figures["tree"] = check_tree(cover.tree)
        if bound:
            tell(f"{cover.name}: the least number of spheres", (number + 0.5) / steps)
            figures["dual_bound"] = _bound(solid, figures["balanced_p99_mm"], cover.spheres, seed)
        rows.append({"name": cover.name, **cover.about, **figures})
    # One scale of colours, so that pictures can be held side by side; not so wide that the first one fades.
    largest = [max(row["gap_mm"]["p99"], row["protrusion_mm"]["p99"]) for row in rows]
    limit = colour_limit(min(max(largest), _FADE * largest[0]))
    for kind in ("pictures", "maps"):
        (folder / kind).mkdir()
    for number, (cover, row) in enumerate(zip(covers, rows, strict=True)):
        tell(f"{cover.name}: map", (len(covers) + 2 * number) / steps)
        errors = surface_errors(solid, cover.spheres, surface.points, normals)
        pitch = float(np.sqrt(solid.areas.sum() / len(cover.spheres)))
        row["worst_places"] = [
            place
            for kind, error in (("gap", errors.gap_m), ("protrusion", errors.protrusion_m))
            for place in worst_places(
                solid, surface.points, error, surface.areas, _LEAST_OF_SIZE * solid.size, kind, 0.5 * pitch
            )
        ]
        row["picture"], row["map"] = f"pictures/{cover.name}.png", f"maps/{cover.name}.exr"
        row["map_channels"] = write_map(folder / row["map"], surface, errors, colour(errors.signed_m * MM, limit))
        tell(f"{cover.name}: picture", (len(covers) + 2 * number + 1) / steps)
        gap, out = row["gap_mm"]["p99"], row["protrusion_mm"]["p99"]
        title = f"{cover.name}: {row['spheres']:,} spheres, p99 of protrusion {out:.3g} mm, of gap {gap:.3g} mm"
        draw_cover(folder / row["picture"], solid, cover.spheres, title, limit, row["worst_places"])
    size = np.ptp(subject.vertices_m, axis=0) * MM
    mesh = {**subject.about, "triangles": len(subject.faces), "size_mm": [round(float(side), 3) for side in size]}
    mesh |= {"area_cm2": float(solid.areas.sum() * 1e4), "texel_mm": surface.pitch_m * MM}
    return {"schema": "palmar.cover/1", "mesh": mesh, "covers": rows, "colour_limit_mm": limit, "seed": seed}


def _bound(solid: Solid, error_mm: float, spheres: Array, seed: int) -> dict[str, float]:
    least = least_spheres(solid.vertices, solid.faces, error_mm / MM, spheres, seed)
    return {"error_mm": error_mm, "least_spheres": least, "ratio": len(spheres) / least}


def _is_mesh(path: str) -> bool:
    return path.startswith(SHAPE) or Path(path.lower().removesuffix(".gz")).suffix.lstrip(".") in CHECKS


def _of_mesh(source: Source, seed: int) -> Subject:
    mesh, closing, _ = read_solid(source, seed, lambda text, fraction: None)
    about: dict[str, Any] = {"source": mesh.source, "sha256": mesh.sha256, "units": mesh.units}
    if closing:
        about |= {"closed": tell_closing(closing), "closing": closing}
    return Subject(source.mesh, mesh.vertices_m, mesh.faces, about)


def _of_pack(path: str, name: str, levels: Sequence[int]) -> Subject:
    pack = load_pack(require_file(Path(path)))
    name = name or _only_object(path, pack)
    if name not in pack.objects:
        found = f"not in the pack{nearest(name, list(pack.objects))}; it has {', '.join(pack.objects)}"
        raise PalmarError("E-OBJECT", name, found)
    tree = pack.objects[name]
    for level in levels:
        if not 0 <= level < len(tree.levels):
            raise PalmarError("E-LEVEL", name, f"level {level}; it has levels 0 to {len(tree.levels) - 1}")
    covers = [Cover(name, tree.leaves, _told(path, tree), tree)]
    if levels:
        covers = [
            Cover(f"{name} level {level}", tree.levels[level], _told(path, tree) | {"level": level}, tree)
            for level in dict.fromkeys(levels)
        ]
    about = {key: tree.about[key] for key in ("source", "sha256", "units", "closed") if tree.about.get(key)}
    closing = tree.about.get("parameters", {}).get("closing")
    if closing:
        about["closing"] = closing
    return Subject(path, tree.vertices_m, tree.faces, {"object": name, **about}, covers)


def _told(path: str, tree: SphereTree) -> dict[str, Any]:
    parameters = tree.about.get("parameters", {})
    known = ("mode", "error_mm", "protrusion_bound_mm")
    return {"from": Path(path).name, **{key: parameters[key] for key in known if key in parameters}}


def _only_object(path: str, pack: AssetPack) -> str:
    if len(pack.objects) != 1:
        raise PalmarError(
            "E-OBJECT", path, f"{len(pack.objects)} objects: {', '.join(pack.objects)}; --object names one"
        )
    return next(iter(pack.objects))


def _read_csvs(paths: Sequence[str | Path], units: str, subject: Subject) -> list[Cover]:
    covers = []
    for path in paths:
        spheres, sha256 = read_spheres_csv(path, units)
        check_place(str(path), spheres, subject.vertices_m)
        name = Path(path).name.removesuffix(".csv").removesuffix(".spheres")
        covers.append(Cover(name or "spheres", spheres, {"from": Path(path).name, "sha256": sha256}))
    return covers


def _named_apart(covers: list[Cover]) -> list[Cover]:
    """The covers with names that differ, and that a file may have."""
    seen: set[str] = set()
    found = []
    for cover in covers:
        name = "".join(c if c.isalnum() or c in " -_." else "_" for c in cover.name)
        number = 1
        while (name if number == 1 else f"{name}-{number}") in seen:
            number += 1
        name = name if number == 1 else f"{name}-{number}"
        seen.add(name)
        found.append(Cover(name, cover.spheres, cover.about, cover.tree))
    return found
