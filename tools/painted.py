"""Regions that are painted on the vertices of a mesh file: a weight from 0 to 1, or red."""

from __future__ import annotations

import gzip
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.tools.mesh import READER_FAILURES
from palmar.tools.region import Regions

Array = NDArray[np.float64]

PAINTED = "painted"  # what stands for the mesh's own paint where a region file could be named
PAINTED_SHARE = 0.25  # of the error, at weight 1
_STEPS = 3  # weights between 0 and 1 that are told apart
_BALLS = 30  # a region's balls have this part of the mesh's longest side as radius
_NAMES = ("weight", "_weight", "quality")


def read_painted(path: str | Path, metres_per_unit: float) -> Regions:
    """Regions of the paint on a mesh file that `read_mesh` reads; metres_per_unit as there.

    The weight is the vertex property `weight` or `quality` of a PLY, the attribute `_WEIGHT` of a GLB, or else how red
    the vertex colours are: red less the larger of green and blue, so that white, grey and black are unpainted. It is
    interpolated over the triangles and rounded to thirds; a weight w allows PAINTED_SHARE^w of the error, and below a
    sixth all of it. Raises BadMesh.
    """
    corners, weight = _read_corners(str(path), Path(path))
    corners = corners * metres_per_unit
    radius = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / _BALLS
    middle, weight = _cut(corners, weight, radius / 2)
    step = np.rint(weight * _STEPS).astype(np.int64)
    middle, step = middle[step > 0], step[step > 0]
    if not len(step):
        raise BadMesh("E-REGION", str(path), f"no vertex is painted by {0.5 / _STEPS:.2g} or more; 0 to 1 is possible")
    # One ball for what lies in a cell with like weight: half a cell's diagonal and half the radius are within it.
    cell = np.floor(middle / (radius / 2)).astype(np.int64)
    rows, number, counts = np.unique(np.column_stack([cell, step]), axis=0, return_inverse=True, return_counts=True)
    centre = np.column_stack([np.bincount(number.reshape(-1), middle[:, axis]) / counts for axis in range(3)])
    share = PAINTED_SHARE ** (rows[:, 3] / _STEPS)
    return Regions(np.column_stack([centre, np.full(len(rows), radius)]), share)


def _cut(corners: Array, weight: Array, finest: float) -> tuple[Array, Array]:
    """Middle (p, 3) and weight there (p,) of pieces of painted triangles, none of which reaches farther than `finest`.

    corners (t, 3, 3) and weight (t, 3) of the triangles.
    """
    middles, weights = [np.empty((0, 3))], [np.empty(0)]
    while len(corners):
        painted = weight.max(axis=1) * _STEPS >= 0.5
        corners, weight = corners[painted], weight[painted]
        middle = corners.mean(axis=1)
        extent = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0)
        whole = extent <= finest
        middles.append(middle[whole])
        weights.append(weight[whole].mean(axis=1))
        both = np.concatenate([corners[~whole], weight[~whole][:, :, None]], axis=2)
        a, b, c = (both[:, k] for k in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        both = np.concatenate([np.stack(part, axis=1) for part in parts])
        corners, weight = both[:, :, :3], both[:, :, 3]
    return np.concatenate(middles), np.concatenate(weights)


def _read_corners(where: str, path: Path) -> tuple[Array, Array]:
    """Corners (t, 3, 3) in the file's units and their weights (t, 3)."""
    import trimesh

    try:
        content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        extension = path.with_suffix("").suffix if path.suffix == ".gz" else path.suffix
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=extension.lower().lstrip("."), process=False, resolver=None
        )
        parts = [scene.graph[node] for node in scene.graph.nodes_geometry]
    except (*READER_FAILURES, OSError) as error:
        raise BadMesh("E-REGION", where, f"its paint cannot be read ({error})") from None
    corners, weights = [], []
    for transform, name in parts:
        mesh = scene.geometry[name]
        points = trimesh.transform_points(mesh.vertices, transform)
        weight = _weights(where, mesh)
        if weight is None:
            continue
        corners.append(points[mesh.faces])
        weights.append(weight[mesh.faces])
    if not corners:
        needed = f"one of {', '.join(_NAMES)} or vertex colours are needed"
        raise BadMesh("E-REGION", where, f"its vertices have no paint; {needed}")
    return np.concatenate(corners), np.concatenate(weights)


def _weights(where: str, mesh: Any) -> Array | None:
    """Weight (v,) of each vertex of one part of a scene; None if nothing is painted there."""
    raw = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    given = {name.lower(): values for name, values in mesh.vertex_attributes.items()}
    if raw is not None:
        names = raw.dtype.names if isinstance(raw, np.ndarray) else raw.keys()
        given |= {name.lower(): raw[name] for name in names or ()}
    for name in _NAMES:
        if name not in given:
            continue
        weight = np.asarray(given[name], dtype=np.float64).reshape(-1)
        bad = np.flatnonzero(~((weight >= 0) & (weight <= 1)))
        if len(bad):
            at = f"{where}:vertex {bad[0]}, {name}"
            raise BadMesh("E-REGION", at, f"{weight[bad[0]]:g}; 0 to 1 is needed")
        if len(weight) == len(mesh.vertices):
            return weight
    colour = mesh.visual.vertex_colors if mesh.visual.kind == "vertex" else None
    if colour is None:
        colour = getattr(mesh.visual, "vertex_attributes", {}).get("color")
    if colour is None or len(colour) != len(mesh.vertices):
        return None
    colour = np.asarray(colour)
    scale = 1.0 if colour.dtype.kind == "f" else float(np.iinfo(colour.dtype).max)
    red, green, blue = (colour[:, k].astype(np.float64) / scale for k in range(3))
    return np.clip(red - np.maximum(green, blue), 0, 1)
