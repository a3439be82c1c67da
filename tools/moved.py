"""How far apart two surfaces are: the two-sided Hausdorff distance between a mesh and the solid made of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Drop = Callable[[Array, Array], NDArray[np.bool_]]

SAMPLES = 50_000
TOLERANCE = 0.01  # of the largest distance: to that it is found
_FLOOR = 1e-6  # of the size: below this nothing moved
_MOST_PIECES = 300_000


def distance_between(
    vertices: Array, faces: NDArray[np.integer], other: Array, other_faces: NDArray[np.integer], seed: int, drop: Drop
) -> dict[str, Any]:
    """From one surface to another: max, p99 and mean in mm, where the largest is (at_mm), and how large max may be.

    drop(points, normals) says which points of the first do not count. p99 and mean: 50,000 samples by area. max: from
    the largest sample on, triangles are cut in four as long as a piece of them may hold a distance 1 % larger: the
    distance of a piece's middle and the reach of its corners bound it. at_most_mm is what the pieces leave open.
    """
    import igl
    import trimesh

    def away(points: Array) -> Array:
        squared, _, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), other, targets)
        return np.sqrt(squared)

    targets = other_faces.astype(np.int64)
    skin = trimesh.Trimesh(vertices, faces, process=False)
    points, at = trimesh.sample.sample_surface(skin, SAMPLES, seed=seed)
    counted = ~drop(points, skin.face_normals[at])
    points = points[counted]
    if not len(points):
        return {"max": 0.0, "p99": 0.0, "mean": 0.0, "at_mm": None, "at_most": 0.0}
    distance = away(points)
    best, where = float(distance.max()), points[np.argmax(distance)]
    floor = _FLOOR * float(np.ptp(vertices, axis=0).max())
    pieces, normals = vertices[faces], np.asarray(skin.face_normals)
    at_most = best
    while True:
        middle = pieces.mean(axis=1)
        reach = np.linalg.norm(pieces - middle[:, None], axis=2).max(axis=1)
        mine = away(middle)
        counted = ~drop(middle, normals)
        if counted.any() and mine[counted].max() > best:
            best = float(mine[counted].max())
            where = middle[counted][np.argmax(mine[counted])]
        enough = max(best * (1 + TOLERANCE), best + floor)
        # A piece that does not count, with its corners: its inside does not either.
        open_ = mine + reach > enough
        hidden = np.flatnonzero(open_ & ~counted)
        for corner in range(3):
            inset = pieces[hidden, corner] + 1e-3 * (middle[hidden] - pieces[hidden, corner])
            hidden = hidden[drop(inset, normals[hidden])]
        open_[hidden] = False
        at_most = max(best, float((mine + reach)[open_].max(initial=0.0)))
        if not open_.any():
            at_most = enough
            break
        if 4 * open_.sum() > _MOST_PIECES:
            break
        a, b, c = np.moveaxis(pieces[open_], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        pieces = np.concatenate([np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        normals = np.tile(normals[open_], (4, 1))
    return {
        "max": 1e3 * best,
        "p99": float(1e3 * np.percentile(distance, 99)),
        "mean": float(1e3 * distance.mean()),
        "at_mm": [round(1e3 * float(x), 3) for x in where],
        "at_most": 1e3 * at_most,
    }
