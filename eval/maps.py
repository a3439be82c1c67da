"""Maps of a run as OpenEXR, with PNG previews: how deep and how long the hand touched, over the object and itself.

The object is seen from its six sides; the hand's collision shape is unwrapped at the zero pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palmar.eval.figures import METADATA, STYLE
from palmar.eval.gap import Mesh, capsule_point_gap
from palmar.eval.judge import Poses, graphic_poses, haptic_poses, palm_spheres, phalanx_capsules, shape_in_object
from palmar.eval.panels import Judged
from palmar.eval.picture import hand_parts
from palmar.eval.touch import HAND_STEPS, OBJECT_STEPS, TOUCH_M, spread_steps, touch_hand, touch_object
from palmar.exr import shown, write_exr, write_parts
from palmar.model import HandModel
from palmar.raster import find_hits, ranks
from palmar.unwrap import SIDES, unwrap

Array = NDArray[np.float64]

VIEW_PIXELS = 128  # along the object's longest side
HAND_TEXELS = 20_000
COLOURS = "inferno"
TITLES = {
    "penetration_mm": "graphic hand, deepest, mm",
    "haptic_penetration_mm": "haptic hand, deepest, mm",
    "contact_s": "contact, s",
}
ZERO_POSE = Poses(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 5, 3)), np.zeros((1, 5)))


@dataclass(frozen=True)
class View:
    """What is seen of a mesh along an axis: pixels (n,), points and unit normals (n, 3), depth (n,) from the front."""

    name: str
    shape: tuple[int, int]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    points: Array
    normals: Array
    depth_m: Array

    def image(self, values: Array) -> Array:
        found = np.zeros(self.shape)
        found[self.row, self.column] = values
        return found


def six_views(vertices_m: Array, faces: NDArray[np.integer], pixels: int) -> list[View]:
    """From each side along an axis, z or else y up; all of one scale, so many pixels along the longest side."""
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    pitch = float((high - low).max()) / pixels
    found = []
    for axis, sign in SIDES:
        up = 2 if axis != 2 else 1
        across = 3 - axis - up
        # Right of who looks from there, so that nothing is mirrored.
        right = sign * (1 if (axis, across) in ((0, 1), (2, 0)) else -1)
        flat = np.stack(
            [
                right * vertices_m[:, across] - min(right * low[across], right * high[across]),
                vertices_m[:, up] - low[up],
            ],
            axis=1,
        )
        corners = (flat / pitch + 1)[faces]
        hits = find_hits(corners)
        points = hits.of(vertices_m[faces])
        nearest = ranks(hits, sign * points[:, axis]) == 0
        hits, points = hits.taken(nearest), points[nearest]
        triangles = vertices_m[faces[hits.face]]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        # In the middle of a square: the parts of a file have one size.
        rows, columns = (
            hits.row + (pixels - int(hits.row.max())) // 2,
            hits.column + (pixels - int(hits.column.max())) // 2,
        )
        front = high[axis] if sign > 0 else -low[axis]
        name = f"from {'+' if sign > 0 else '-'}{'xyz'[axis]}"
        found.append(
            View(name, (pixels + 2,) * 2, pixels + 1 - rows, columns, points, normals, front - sign * points[:, axis])
        )
    return found


def write_maps(judged: Judged, folder: Path) -> list[str]:
    """NAME-object.exr and NAME-hand.exr with a PNG of each; the names of the PNGs."""
    folder.mkdir(exist_ok=True)
    return [_object_map(judged, folder), _hand_map(judged, folder)]


def _object_map(judged: Judged, folder: Path) -> str:
    run, tree, hand = judged.run, judged.pack.objects[judged.object_name], judged.pack.hand
    views = six_views(tree.vertices_m, tree.faces.astype(np.int64), VIEW_PIXELS)
    points = np.concatenate([view.points for view in views])
    steps, seconds, stride = spread_steps(run, OBJECT_STEPS, judged.series.get("penetration_mesh"))
    depth, contact = touch_object(shape_in_object(hand, graphic_poses(run)[steps], run, steps), points, seconds)
    haptic, _ = touch_object(shape_in_object(hand, haptic_poses(run)[steps], run, steps), points, seconds)
    values = {"penetration_mm": 1e3 * depth, "haptic_penetration_mm": 1e3 * haptic, "contact_s": contact}
    colours = _colours(values["haptic_penetration_mm"])
    parts = {}
    ends = np.cumsum([0, *(len(view.points) for view in views)])
    for view, start, end in zip(views, ends, ends[1:], strict=False):
        channels = {name: view.image(value[start:end]) for name, value in values.items()}
        channels |= {"depth_mm": view.image(1e3 * view.depth_m)}
        channels |= {f"normal.{axis}": view.image(view.normals[:, k]) for k, axis in enumerate("xyz")}
        channels |= {name: view.image(value) for name, value in shown(colours[start:end]).items()}
        parts[view.name] = channels
    write_parts(folder / f"{judged.name}-object.exr", parts, _header(judged, "the object, from six sides", stride))
    images = {TITLES[name]: [(part["A"], part[name]) for part in parts.values()] for name in values}
    return _preview(folder / f"{judged.name}-object.png", images, list(parts))


def _hand_map(judged: Judged, folder: Path) -> str:
    run, tree, hand = judged.run, judged.pack.objects[judged.object_name], judged.pack.hand
    points, faces, link = _rest_surface(hand)
    surface = unwrap(points, faces, HAND_TEXELS)
    skin = surface.points, link[surface.face]
    steps, seconds, stride = spread_steps(run, HAND_STEPS, judged.series.get("penetration_mesh"))
    frames = run.object_rotation_wxyz[steps], run.object_position_m[steps]
    mesh = Mesh(tree.vertices_m, tree.faces)
    depth, contact = touch_hand(hand, graphic_poses(run)[steps], frames, mesh, skin, seconds)
    values = {"penetration_mm": 1e3 * depth, "contact_s": contact, "link": skin[1].astype(np.float64)}
    values |= {f"position_mm.{axis}": 1e3 * surface.points[:, k] for k, axis in enumerate("xyz")}
    values |= shown(_colours(contact))
    header = _header(judged, "the hand's collision shape at the zero pose, unwrapped by its six sides", stride)
    header |= {"texel_mm": 1e3 * surface.pitch_m}
    write_exr(folder / f"{judged.name}-hand.exr", surface.shape, surface.row, surface.column, values, header)

    def image(of: Array) -> Array:
        found = np.zeros(surface.shape)
        found[surface.row, surface.column] = of
        return found

    images = {title: [(image(values["A"]), image(values[name]))] for name, title in TITLES.items() if name in values}
    return _preview(folder / f"{judged.name}-hand.png", images, [""])


def _rest_surface(hand: HandModel) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Points, faces and the link of each face of the collision shape at the zero pose, without what is buried in it."""
    points, faces, _, owner = hand_parts(hand, ZERO_POSE)
    c1, r1, c2, r2 = phalanx_capsules(hand, ZERO_POSE)
    balls = palm_spheres(hand, ZERO_POSE)[0]
    ends = np.concatenate([c1[0], balls[:, :3]]), np.concatenate([c2[0], balls[:, :3]])
    radii = np.concatenate([r1, balls[:, 3]]), np.concatenate([r2, balls[:, 3]])
    middle = points[faces].mean(axis=1)
    buried = np.zeros(len(faces), dtype=bool)
    for k in range(len(ends[0])):
        gap = capsule_point_gap(ends[0][k], radii[0][k], ends[1][k], radii[1][k], middle)
        buried |= (gap < 0) & (owner != k)
    faces, owner = faces[~buried], owner[~buried]
    return points, faces, np.where(owner < 15, owner + 1, 0)


def _header(judged: Judged, what: str, stride: int) -> dict[str, Any]:
    header = judged.run.header
    return {
        "comments": f"Palmar: {judged.name} on {judged.object_name}: {what}; mm and s; A = 0: no surface",
        "touch_mm": 1e3 * TOUCH_M,
        "steps_apart": stride,
        **{name: str(header.get(name, "")) for name in ("pack_sha256", "trace_sha256", "solver", "settings")},
    }


def _colours(values: Array) -> Array:
    return np.asarray(colormaps[COLOURS](values / max(float(values.max(initial=0.0)), 1e-12)))[:, :3]


def _preview(path: Path, images: dict[str, list[tuple[Array, Array]]], names: list[str]) -> str:
    """Views of each quantity with one scale of colours: below each other, or side by side if there is one view."""
    beside = len(names) == 1
    blocks = len(images) if beside else 1
    first = next(iter(images.values()))
    widths, height = [mask.shape[1] for mask, _ in first], max(mask.shape[0] for mask, _ in first)
    inch = 7.0 / (blocks * sum(widths))
    rows = 1 if beside else len(images)
    with rc_context(STYLE):
        figure = Figure(figsize=(8.0, rows * (height * inch + 0.1) + 0.25))
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(
            rows, blocks * (len(names) + 1), width_ratios=[*widths, 0.02 * sum(widths)] * blocks,
            left=0.035, right=0.945, top=1 - 0.22 / figure.get_figheight(), bottom=0.01,
            wspace=0.14 if beside else 0.03, hspace=0.08,
        )  # fmt: skip
        for number, (title, parts) in enumerate(images.items()):
            row, block = (0, number) if beside else (number, 0)
            end = max(float(value[mask > 0].max(initial=0.0)) for mask, value in parts)
            for c, (mask, value) in enumerate(parts):
                axis = figure.add_subplot(grid[row, block * (len(names) + 1) + c])
                axis.imshow(np.where(mask > 0, 0.88, np.nan), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
                above = np.where(value > 0, value, np.nan)
                seen = axis.imshow(above, cmap=COLOURS, vmin=0, vmax=end or 1e-3, interpolation="nearest")
                axis.set_axis_off()
                if beside or row == 0:
                    axis.set_title(title if beside else names[c], fontsize=7, pad=2)
                if c == 0 and not beside:
                    at: Any = {"rotation": 90, "va": "center", "ha": "right", "transform": axis.transAxes}
                    axis.text(-0.03, 0.5, title, fontsize=7, **at)
            bar = figure.colorbar(seen, cax=figure.add_subplot(grid[row, block * (len(names) + 1) + len(names)]))
            bar.ax.tick_params(labelsize=6)
        figure.savefig(path, metadata=METADATA["png"], dpi=160)
    return path.name
