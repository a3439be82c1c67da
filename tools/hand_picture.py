"""A picture of a hand mesh from three sides, at rest and bent, coloured by how far the hybrid hand is from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palmar.model import HandModel
from palmar.skin import HandMesh
from palmar.tools.hand_quality import MM, capsules_of, hybrid_gap
from palmar.tools.hand_shape import points_at, pose_hand, sweep_angles
from palmar.tools.solid import smooth_normals
from palmar.tools.surface import halved

Array = NDArray[np.float64]

COLOURS = "RdBu_r"  # red sticks out, blue is missing
LIMIT_MM = 2.0
BENT_DEG = 60.0
FACES = 20_000  # enough for a smooth picture
# Right, up and towards the eye in the palm frame of a right hand; a left hand is seen mirrored.
VIEWS = {
    "back": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "palm": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "thumb's side": ((0, 0, -1), (0, 1, 0), (-1, 0, 0)),
}


def draw_hand(path: str | Path, hand: HandModel, title: str) -> None:
    """Write a PNG of the hand's mesh. Equal input, equal bytes."""
    assert hand.mesh is not None
    mirror = 1.0 if hand.about.get("side") != "left" else -1.0
    fine = _finer(hand.mesh)
    skin = points_at(fine, np.arange(len(fine.faces)), np.full((len(fine.faces), 3), 1 / 3))  # middles of the faces
    poses = {"at rest": hand.mesh.flexion_rad, f"bent by {BENT_DEG:g} degrees": sweep_angles(hand, BENT_DEG)}
    with rc_context({"font.family": "DejaVu Sans", "font.size": 9}):
        figure = Figure(figsize=(9.6, 9.2), dpi=130)
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 3, gridspec_kw={"height_ratios": (1.3, 1)})
        figure.subplots_adjust(0.05, 0.02, 0.88, 0.9, wspace=0.02, hspace=0.08)
        figure.suptitle(title, x=0.02, y=0.975, ha="left", fontsize=11)
        for row, (pose, flexion) in enumerate(poses.items()):
            posed = pose_hand(skin, hand, flexion)
            error = -MM * hybrid_gap(posed, hand.palm_spheres_m, capsules_of(hand), posed.points_m)
            normals = smooth_normals(posed.solid, posed.points_m, skin.face)
            for axis, (view, turn) in zip(axes[row], VIEWS.items(), strict=True):
                right, up, eye = (np.array(v, dtype=float) * [mirror, 1, 1] for v in turn)
                corners = MM * posed.solid.vertices[fine.faces]
                colours = colours_of(error)
                colours[~skin.real] = 0.7
                light = 0.3 * right + 0.5 * up + 0.8 * eye
                shade = 0.62 + 0.38 * np.clip(normals @ (light / np.linalg.norm(light)), 0, 1)
                colours *= shade[:, None]
                shown = np.flatnonzero(posed.solid.normals[skin.face] @ eye > 0)
                shown = shown[np.argsort((posed.points_m[shown]) @ eye, kind="stable")]
                _draw(axis, np.stack([corners[shown] @ right, corners[shown] @ up], axis=2), colours[shown])
                if row == 0:
                    axis.set_title(view, fontsize=9, color="0.35")
            axes[row, 0].text(-0.02, 0.5, pose, rotation=90, va="center", ha="right", transform=axes[row, 0].transAxes)
        scale = ScalarMappable(Normalize(-LIMIT_MM, LIMIT_MM), COLOURS)
        bar = figure.colorbar(scale, cax=figure.add_axes((0.9, 0.2, 0.018, 0.55)), extend="both", extendfrac=0.03)
        bar.set_label("mesh sticks out (gap)      mm      model sticks out (protrusion)")
        ticks = np.linspace(-LIMIT_MM, LIMIT_MM, 5)
        bar.set_ticks(ticks.tolist(), labels=[f"{abs(tick):g}" for tick in ticks])
        figure.savefig(path, metadata={"Software": "palmar"})


def colours_of(error_mm: Array) -> Array:
    """Red, green, blue (n, 3), sRGB: white at 0, full colour from the limit on."""
    return np.asarray(colormaps[COLOURS](0.5 + 0.5 * np.clip(error_mm / LIMIT_MM, -1, 1)))[:, :3]


def _draw(axis: Any, triangles: Array, colours: Array) -> None:
    axis.add_collection(PolyCollection(list(triangles), facecolors=colours, edgecolors=colours, linewidths=0.25))
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    axis.set_xlim(low[0] - 4, high[0] + 4)
    axis.set_ylim(low[1] - 8, high[1] + 4)
    axis.set_aspect("equal", anchor="S")
    axis.set_axis_off()
    axis.plot([low[0], low[0] + 20], [low[1] - 6] * 2, color="0.3", lw=2, solid_capstyle="butt")
    axis.text(low[0] + 23, low[1] - 6, "20 mm", fontsize=7, va="center", color="0.3")


def _finer(mesh: HandMesh) -> HandMesh:
    values, faces = np.hstack([mesh.vertices_m, mesh.weights]), mesh.faces.astype(np.int64)
    while len(faces) < FACES:
        values, faces = halved(values, faces)
    return HandMesh(values[:, :3], faces.astype(np.int32), values[:, 3:], mesh.flexion_rad)
