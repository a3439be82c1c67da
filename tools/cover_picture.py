"""A picture of the surface, coloured by how far spheres stick out of it or stay behind it, from six sides."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palmar.raster import find_hits, ranks
from palmar.tools.cover_place import MM, surface_errors
from palmar.tools.solid import Solid, smooth_normals

Array = NDArray[np.float64]

COLOURS = "RdBu_r"  # red sticks out, blue is missing
_SIDE = 480  # pixels of a view
_VIEWS = {
    "from -y": (0.5, -1.0, 0.45),
    "from +x": (1.0, 0.5, 0.45),
    "from +z": (0.0, -1e-4, 1.0),
    "from +y": (-0.5, 1.0, 0.45),
    "from -x": (-1.0, -0.5, 0.45),
    "from -z": (0.0, -1e-4, -1.0),
}
_STEPS = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)
_STYLE: Any = {"font.family": "DejaVu Sans", "font.size": 9}
_METADATA = {"Software": "palmar"}


def colour(signed_mm: Array, limit_mm: float) -> Array:
    """Red, green and blue (n, 3), 0 to 1, of errors in mm: white at 0, full colour from the limit on."""
    return np.asarray(colormaps[COLOURS](0.5 + 0.5 * np.clip(signed_mm / limit_mm, -1, 1)))[:, :3]


def colour_limit(*errors_mm: float) -> float:
    """A round number of mm, about the largest of the errors: the end of a colour scale."""
    largest = max(*errors_mm, 1e-3)
    power = 10.0 ** np.floor(np.log10(largest))
    return float(power * next(step for step in _STEPS if step * power >= 0.97 * largest))


def draw_cover(
    path: str | Path, solid: Solid, spheres: Array, title: str, limit_mm: float, places: list[dict[str, Any]]
) -> None:
    """Write a PNG of the solid from six sides, coloured by the error of spheres (n, 4) from -limit to limit.

    places: worst places, numbered from 1, each shown where its worst point is in sight. Equal input, equal bytes.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(11, 7.6), dpi=150)
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 3).ravel()
        figure.subplots_adjust(0.01, 0.03, 0.9, 0.9, wspace=0.03, hspace=0.1)
        figure.suptitle(title, x=0.015, y=0.975, ha="left", fontsize=11)
        for axis, (name, towards) in zip(axes, _VIEWS.items(), strict=True):
            _draw_view(axis, solid, spheres, _turned(np.array(towards)), limit_mm, places)
            axis.set_title(name, fontsize=9, color="0.35", pad=2)
        bar = figure.colorbar(
            _scale(limit_mm), cax=figure.add_axes((0.915, 0.16, 0.018, 0.66)), extend="both", extendfrac=0.03
        )
        bar.set_label("missing (gap)      mm      sticks out (protrusion)")
        bar.set_ticks(
            [*np.linspace(-limit_mm, limit_mm, 5)], labels=[f"{abs(x):g}" for x in np.linspace(-1, 1, 5) * limit_mm]
        )
        figure.savefig(path, metadata=_METADATA)


def _scale(limit_mm: float) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(-limit_mm, limit_mm), COLOURS)


def _turned(towards: Array) -> Array:
    """Rows: right, up and towards the eye, as unit vectors; z is up."""
    towards = towards / np.linalg.norm(towards)
    right = np.cross((0.0, 0.0, 1.0), towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _draw_view(
    axis: Any, solid: Solid, spheres: Array, turn: Array, limit_mm: float, places: list[dict[str, Any]]
) -> None:
    corners = solid.vertices[solid.faces]
    middle = (solid.vertices.max(axis=0) + solid.vertices.min(axis=0)) / 2
    # One scale for all views: the ball around the object fits.
    pixel = 2.04 * float(np.linalg.norm(solid.vertices - middle, axis=1).max()) / _SIDE

    def seen(points: Array) -> Array:
        at = (points - middle) @ turn.T
        return np.concatenate([at[..., :2] / pixel + _SIDE / 2, at[..., 2:]], axis=-1)

    placed = seen(corners)
    hits = find_hits(placed[:, :, :2])
    depth = hits.of(placed[:, :, 2:])[:, 0]
    first = ranks(hits, depth) == 0
    hits, depth = hits.taken(first), depth[first]
    points = hits.of(corners)
    normals = smooth_normals(solid, points, hits.face)
    signed = surface_errors(solid, spheres, points, normals, felt=False).signed_m * MM
    light = turn.T @ (np.array([-0.35, 0.5, 0.8]) / np.linalg.norm([-0.35, 0.5, 0.8]))
    shade = 0.62 + 0.38 * np.clip(normals @ light, 0, 1)
    image = np.ones((_SIDE, _SIDE, 4))
    image[..., 3] = 0
    image[hits.row, hits.column, :3] = colour(signed, limit_mm) * shade[:, None]
    image[hits.row, hits.column, 3] = 1
    nearest = np.full((_SIDE, _SIDE), -np.inf)
    nearest[hits.row, hits.column] = depth

    axis.imshow(image, origin="lower", interpolation="antialiased")
    axis.set_axis_off()
    for number, place in enumerate(places, 1):
        x, y, z = seen(np.array(place["at_mm"]) / MM)
        column, row = int(np.clip(x, 0, _SIDE - 1)), int(np.clip(y, 0, _SIDE - 1))
        around = nearest[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        if z > around.min() - 4 * pixel and z > np.median(around) - 4 * pixel:
            axis.annotate(
                str(number),
                (x, y),
                xytext=(9, 9),
                textcoords="offset points",
                fontsize=7.5,
                ha="center",
                va="center",
                bbox={"boxstyle": "circle,pad=0.18", "fc": "white", "ec": "0.2", "lw": 0.7},
                arrowprops={"arrowstyle": "-", "lw": 0.7, "color": "0.2", "shrinkA": 0, "shrinkB": 0},
            )
    length = 0.01 / pixel
    axis.plot([8, 8 + length], [8, 8], color="0.2", lw=2, solid_capstyle="butt")
    axis.text(8 + length / 2, 13, "10 mm", ha="center", va="bottom", fontsize=7, color="0.2")
    axis.set_xlim(0, _SIDE)
    axis.set_ylim(0, _SIDE)
