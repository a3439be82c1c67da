"""Objects of scenes: spheres laid out by a rule, with the solid that they stand for as the true mesh beside them.

A row of KINDS is one kind of object: what its table may say, with defaults, and the function that lays it out. Every
kind is made about its own origin, z up, and then turned and moved. A number `pitch_m` is the distance of neighbouring
centres; lengths are cut down to a whole number of them, so that the pitch asked for is the pitch there is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.model import SphereTree
from palmar.tools.cover import union_gap
from palmar.tools.hierarchy import bounds_over
from palmar.tools.pack import SHAPE, Source, build_object
from palmar.tools.solid import make_solid, sample_surface, signed_distance
from palmar.tools.toml_file import check_keys, is_number

Array = NDArray[np.float64]
Numbers = dict[str, float]

MM = 1e3  # the solids are made in millimetres: plane sections keep so many decimals only
ROUND = 96  # edges of a full circle; a multiple of 4, so that flat sides are where they should be
MOST_SPHERES = 200_000
SAMPLES = 20_000  # of the mesh, for the gap of the spheres


@dataclass(frozen=True)
class Layout:
    """Spheres (n, 4), metres, and the solid that they stand for, millimetres."""

    spheres: Array
    solid: Manifold


def lattice_object(table: dict[str, Any], where: str = "object") -> SphereTree:
    """The object of a table: `kind`, the numbers of that kind, and `position_m` and `turn_rad` (a rotation vector).

    Its levels are built over the spheres as laid out. Raises BadPack or PalmarError E-CONF `where:key`.
    """
    check_keys(where, table, [*table], ["kind"])
    kind = table["kind"]
    if kind not in KINDS:
        raise PalmarError("E-CONF", f"{where}:kind", f"found {kind!r}; allowed is one of {', '.join(KINDS)}")
    layout_of, defaults = KINDS[kind]
    check_keys(where, table, ["kind", "position_m", "turn_rad", *defaults])
    numbers = dict(defaults)
    for key in defaults.keys() & table.keys():
        if not is_number(table[key]) or table[key] < 0:
            raise PalmarError("E-CONF", f"{where}:{key}", f"found {table[key]!r}; a number from 0 is needed")
        numbers[key] = float(table[key])
    for key in {"radius_m", "pitch_m"} & numbers.keys():
        if not numbers[key] > 0:
            raise PalmarError("E-CONF", f"{where}:{key}", f"found {numbers[key]:g}; a number above 0 is needed")
    layout = layout_of(numbers)
    if len(layout.spheres) > MOST_SPHERES:
        raise PalmarError(
            "E-CONF", f"{where}:pitch_m", f"{len(layout.spheres)} spheres; up to {MOST_SPHERES} are allowed"
        )
    mesh = layout.solid.to_mesh64()
    corners = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] / MM
    leaves, vertices = _place(layout.spheres, corners, table, where)
    faces = np.asarray(mesh.tri_verts, dtype=np.int32)
    said = json.dumps(table, sort_keys=True)
    about = {
        "source": kind,
        "sha256": hashlib.sha256(said.encode()).hexdigest(),
        "units": "m",
        "metres_per_unit": 1.0,
        "closed": None,
        "method": "laid out by a rule",
        "parameters": numbers,
        "levels": [leaf_errors(leaves, vertices, faces)],
    }
    return SphereTree([leaves], [bounds_over(leaves)], vertices, faces, about)


def scene_object(table: dict[str, Any], where: str = "object") -> SphereTree:
    """The object of a scene's table: a kind of this file, or `shape:NAME` with so many `spheres`, built, then placed.

    Raises BadPack, BadMesh or PalmarError.
    """
    kind = str(table.get("kind", ""))
    if not kind.startswith(SHAPE):
        return lattice_object(table, where)
    check_keys(where, table, ["kind", "spheres", "position_m", "turn_rad"], ["spheres"])
    tree, _ = build_object(Source("object", kind, spheres=table["spheres"]), 0, lambda text, fraction: None)
    leaves, vertices = _place(tree.leaves, tree.vertices_m, table, where)
    about = {**tree.about, "levels": tree.about["levels"][-1:]}
    return SphereTree([leaves], [bounds_over(leaves)], vertices, tree.faces, about)


def leaf_errors(leaves: Array, vertices: Array, faces: NDArray[np.int32]) -> dict[str, Any]:
    """How far the mesh is beyond the spheres, of samples by area, and each sphere beyond the mesh, millimetres."""
    solid = make_solid(vertices, faces)
    gap = np.maximum(union_gap(leaves, sample_surface(solid, SAMPLES, 0)[0]), 0) * MM
    out = np.maximum(signed_distance(solid, leaves[:, :3])[0] + leaves[:, 3], 0) * MM
    figures = {
        name: {"max": float(x.max()), "p99": float(np.percentile(x, 99)), "mean": float(x.mean())}
        for name, x in (("gap_mm", gap), ("protrusion_mm", out))
    }
    return {"spheres": len(leaves), **figures}


def _place(spheres: Array, vertices: Array, table: dict[str, Any], where: str) -> tuple[Array, Array]:
    """Spheres (n, 4) and vertices (v, 3) turned and then moved as the table says."""
    turn, position = Rotation.from_rotvec(_vector(table, "turn_rad", where)), _vector(table, "position_m", where)
    return np.column_stack([turn.apply(spheres[:, :3]) + position, spheres[:, 3]]), turn.apply(vertices) + position


def _vector(table: dict[str, Any], key: str, where: str) -> Array:
    value = table.get(key, [0.0, 0.0, 0.0])
    if not isinstance(value, list) or len(value) != 3 or not all(map(is_number, value)):
        raise PalmarError("E-CONF", f"{where}:{key}", f"found {value!r}; three numbers are needed")
    return np.array(value, dtype=np.float64)


# ---- sheets: rows of spheres over a line in the plane of x and z, carried along y


def _sheets(lines: list[tuple[Array, Array]], n: Numbers, convex: bool = False) -> Layout:
    """Sheets of one row of spheres, as thick as a sphere. lines: both ends (x, z) of each; the first end stays.

    The solid is the union of the sheets, or the hull of all; it ends in y at the last centres.
    """
    radius, pitch = n["radius_m"], n["pitch_m"]
    rows, parts = [], []
    for start, end in lines:
        steps = _steps(float(np.linalg.norm(end - start)), pitch)
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-300)
        row = start + pitch * np.arange(steps + 1)[:, None] * along
        rows.append(row)
        discs = [_disc(radius).translate(tuple(MM * at)) for at in (row[0], row[-1])]
        parts.append(CrossSection.batch_hull(discs))
    section = CrossSection.batch_hull(parts) if convex else CrossSection.batch_boolean(parts, OpType.Add)
    middles = np.unique(np.concatenate(rows).round(9), axis=0)  # an end that two sheets share holds one sphere
    steps = _steps(n["length_m"], pitch)
    y = pitch * (np.arange(steps + 1) - steps / 2)
    x_z = np.repeat(middles, len(y), axis=0)
    spheres = np.column_stack([x_z[:, 0], np.tile(y, len(middles)), x_z[:, 1], np.full(len(x_z), radius)])
    length = MM * max(y[-1] - y[0], 0.1 * radius)
    solid = section.extrude(length).translate((0, 0, -length / 2)).rotate((90, 0, 0))
    return Layout(spheres, solid)


def _plate(n: Numbers) -> Layout:
    half = 0.5 * n["pitch_m"] * _steps(n["width_m"], n["pitch_m"])
    return _sheets([_line(-half, -n["radius_m"], half, -n["radius_m"])], n)


def _ridge(n: Numbers) -> Layout:
    return _sheets([_line(0, -n["radius_m"], 0, -n["height_m"])], n)


def _slot(n: Numbers) -> Layout:
    """Two upright sheets, `gap_m` apart, with shoulders outwards at their tops where asked for."""
    radius, lines = n["radius_m"], []
    x = 0.5 * n["gap_m"] + radius
    for side in (-1, 1):
        lines.append(_line(side * x, -radius, side * x, -n["height_m"]))
        if n["shoulder_m"]:
            lines.append(_line(side * x, -radius, side * (x + n["shoulder_m"]), -radius))
    return _sheets(lines, n)


def _notch(n: Numbers) -> Layout:
    """Two sheets that meet at the bottom of a V, whose inner faces meet at the origin."""
    half = 0.5 * n["angle_rad"]
    bottom = -n["radius_m"] / np.sin(half)
    reach = n["slant_m"] * np.array([np.sin(half), np.cos(half)])
    return _sheets([_line(0, bottom, side * reach[0], bottom + reach[1]) for side in (-1, 1)], n)


def _wedge(n: Numbers) -> Layout:
    """A solid edge along y, round with the radius of a sphere, top at z = 0; its third face is the base."""
    half, top = 0.5 * n["angle_rad"], -n["radius_m"]
    slant = n["pitch_m"] * _steps(n["slant_m"], n["pitch_m"])
    x, z = slant * np.sin(half), top - slant * np.cos(half)
    return _sheets([_line(0, top, -x, z), _line(0, top, x, z), _line(-x, z, x, z)], n, convex=True)


# ---- bodies


def _ball(n: Numbers) -> Layout:
    """One sphere, or that many small ones evenly on the skin of one that is smaller by one of their radii."""
    radius, count = n["radius_m"], round(n["spheres"])
    solid = Manifold.sphere(MM * radius, 4 * ROUND)
    if count <= 1:
        return Layout(np.array([[0.0, 0.0, 0.0, radius]]), solid)
    small = n["skin_radius_m"]
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    skin = (radius - small) * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
    core = np.array([[0.0, 0.0, 0.0, radius - small]])
    return Layout(np.vstack([core, np.column_stack([skin, np.full(count, small)])]), solid)


def _box(n: Numbers) -> Layout:
    """A cube about the origin with rounded edges, spheres on its six faces."""
    radius, pitch = n["radius_m"], n["pitch_m"]
    steps = _steps(n["size_m"] - 2 * radius, pitch)
    grid = np.stack(np.meshgrid(*[np.arange(steps + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[((grid == 0) | (grid == steps)).any(axis=1)]
    centres = pitch * (grid - steps / 2)
    corners = centres[((grid == 0) | (grid == steps)).all(axis=1)]
    ball = Manifold.sphere(MM * radius, ROUND)
    solid = Manifold.batch_hull([ball.translate(tuple(MM * corner)) for corner in corners])
    return Layout(np.column_stack([centres, np.full(len(centres), radius)]), solid)


def _rod(n: Numbers) -> Layout:
    """A bar along y with round ends."""
    steps = _steps(n["length_m"], n["pitch_m"])
    y = n["pitch_m"] * (np.arange(steps + 1) - steps / 2)
    spheres = np.column_stack([0 * y, y, 0 * y, np.full(len(y), n["radius_m"])])
    return Layout(spheres, _cone(spheres[0], spheres[-1]))


def _ring(n: Numbers) -> Layout:
    """A torus about the y axis; its circle is cut into a whole number of pitches, at most those asked for."""
    count = max(3, int(np.ceil(2 * np.pi * n["ring_radius_m"] / n["pitch_m"])))
    turn = 2 * np.pi * np.arange(count) / count
    circle = n["ring_radius_m"] * np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)])
    tube = _disc(n["radius_m"]).translate((MM * n["ring_radius_m"], 0))
    return Layout(np.column_stack([circle, np.full(count, n["radius_m"])]), tube.revolve(2 * ROUND).rotate((90, 0, 0)))


def _cup(n: Numbers) -> Layout:
    """A shell of one sphere open at the top; middle of the floor's shell at the origin. Rings as evenly as they fit."""
    radius, pitch = n["radius_m"], n["pitch_m"]
    across, up = _steps(n["cup_radius_m"], pitch), _steps(n["height_m"], pitch)
    wide, high = pitch * across, pitch * up
    rings = [(pitch * k, 0.0) for k in range(across + 1)] + [(wide, pitch * k) for k in range(1, up + 1)]
    centres = []
    for at, z in rings:
        turn = 2 * np.pi * np.arange(max(1, int(np.ceil(2 * np.pi * at / pitch))))
        turn = turn / len(turn)
        centres.append(np.column_stack([at * np.cos(turn), at * np.sin(turn), np.full(len(turn), z)]))
    skin = np.concatenate(centres)
    discs = [_disc(radius).translate((MM * x, MM * y)) for x, y in ((0, 0), (wide, 0), (wide, high))]
    section = CrossSection.batch_hull(discs[:2]) + CrossSection.batch_hull(discs[1:])
    return Layout(np.column_stack([skin, np.full(len(skin), radius)]), section.revolve(2 * ROUND))


def _ears(n: Numbers) -> Layout:
    """A ball and two round tapering ears upwards from it, side by side along x; the ball's top is the origin."""
    body = np.array([[0.0, 0.0, -n["body_radius_m"], n["body_radius_m"]]])
    steps = _steps(n["height_m"], n["pitch_m"])
    part = np.arange(steps + 1) / max(steps, 1)
    z = n["pitch_m"] * np.arange(steps + 1)
    size = n["base_radius_m"] + part * (n["radius_m"] - n["base_radius_m"])
    rows, solid = [body], Manifold.sphere(MM * n["body_radius_m"], 2 * ROUND).translate((0, 0, MM * body[0, 2]))
    for side in (-1, 1):
        ear = np.column_stack([np.full(len(z), 0.5 * side * n["apart_m"]), 0 * z, z, size])
        rows.append(ear)
        solid = solid + _cone(ear[0], ear[-1])
    return Layout(np.concatenate(rows), solid)


def _steps(length: float, pitch: float) -> int:
    """Whole pitches in a length; a length of 3.0 pitches holds 3, whatever its last bit."""
    return max(0, int(np.floor(length / pitch + 1e-6)))


def _line(x0: float, z0: float, x1: float, z1: float) -> tuple[Array, Array]:
    return np.array([x0, z0], dtype=np.float64), np.array([x1, z1], dtype=np.float64)


def _disc(radius: float) -> CrossSection:
    return CrossSection.circle(MM * radius, ROUND)


def _cone(a: Array, b: Array) -> Manifold:
    """The hull of two spheres (4,)."""
    return Manifold.batch_hull([Manifold.sphere(MM * s[3], ROUND).translate(tuple(MM * s[:3])) for s in (a, b)])


_SHEET = {"radius_m": 0.003, "pitch_m": 0.003, "length_m": 0.18}
KINDS: dict[str, tuple[Callable[[Numbers], Layout], Numbers]] = {
    "plate": (_plate, {**_SHEET, "width_m": 0.18}),
    "ridge": (_ridge, {**_SHEET, "height_m": 0.06}),
    "slot": (_slot, {**_SHEET, "gap_m": 0.012, "height_m": 0.07, "shoulder_m": 0.0}),
    "notch": (_notch, {**_SHEET, "angle_rad": np.pi / 2, "slant_m": 0.06}),
    "wedge": (_wedge, {**_SHEET, "angle_rad": np.pi / 2, "slant_m": 0.06}),
    "ball": (_ball, {"radius_m": 0.04, "spheres": 1, "skin_radius_m": 0.004}),
    "box": (_box, {"radius_m": 0.003, "pitch_m": 0.003, "size_m": 0.07}),
    "rod": (_rod, {"radius_m": 0.008, "pitch_m": 0.002, "length_m": 0.18}),
    "ring": (_ring, {"radius_m": 0.004, "pitch_m": 0.002, "ring_radius_m": 0.012}),
    "cup": (_cup, {"radius_m": 0.002, "pitch_m": 0.002, "cup_radius_m": 0.035, "height_m": 0.06}),
    "ears": (
        _ears,
        {
            "radius_m": 0.004,
            "pitch_m": 0.0015,
            "height_m": 0.05,
            "base_radius_m": 0.008,
            "apart_m": 0.03,
            "body_radius_m": 0.03,
        },
    ),
}
