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
_FLOOR = 2e-4  # of the size: to that, where both are nearly one
_MOST_PIECES, _AT_ONCE = 250_000, 10_000


def distance_between(
    vertices: Array, faces: NDArray[np.integer], other: Array, other_faces: NDArray[np.integer], seed: int, drop: Drop
) -> dict[str, Any]:
    """From one surface to another: max, p99, mean and at_most in mm, and where the largest is (at_mm).

    drop(points, normals) says which points of the first do not count: such as are inside the other. p99 and mean: of
    50,000 samples by area. max: from the largest sample on, triangles are cut in four as long as a piece of them may
    hold a distance 1 % larger. What a piece may hold: no more than the distance of its middle and the reach of its
    corners; nor, the distance to one triangle being convex, than its corners' largest distance to the triangle nearest
    to the middle. at_most: what is left open.
    """
    import igl
    import trimesh

    def away(points: Array) -> tuple[Array, NDArray[np.int64]]:
        squared, face, _ = tree.squared_distance(other, targets, np.ascontiguousarray(points))
        return np.sqrt(squared), face

    other, targets = np.ascontiguousarray(other), np.ascontiguousarray(other_faces, dtype=np.int64)
    tree = igl.AABB()
    tree.init(other, targets)
    skin = trimesh.Trimesh(vertices, faces, process=False)
    points, at = trimesh.sample.sample_surface(skin, SAMPLES, seed=seed)
    points = points[~drop(points, skin.face_normals[at])]
    if not len(points):
        return {"max": 0.0, "p99": 0.0, "mean": 0.0, "at_mm": None, "at_most": 0.0}
    distance, _ = away(points)
    best, where = float(distance.max()), points[np.argmax(distance)]
    floor = _FLOOR * float(np.ptp(vertices, axis=0).max())
    fresh, normals = vertices[faces], np.asarray(skin.face_normals)
    pieces, turned, bounds = np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0)
    looked_at = 0
    while len(fresh):
        middle = fresh.mean(axis=1)
        mine, face = away(middle)
        reach = np.linalg.norm(fresh - middle[:, None], axis=2).max(axis=1)
        single = np.max([_to_triangle(fresh[:, corner], other[targets[face]]) for corner in range(3)], axis=0)
        bound = np.minimum(mine + reach, single)
        # Only what would raise the maximum has to be looked at.
        higher = np.flatnonzero(mine > best + 0.5 * floor)
        dropped = drop(middle[higher], normals[higher])
        counted, hidden = higher[~dropped], higher[dropped]
        if len(counted):
            found = counted[np.argmax(mine[counted])]
            best, where = float(mine[found]), middle[found]
        # Skin counts again where it comes out of the other surface: a piece that does not reach there is left out.
        bound[hidden[mine[hidden] > reach[hidden]]] = 0
        pieces, turned = np.concatenate([pieces, fresh]), np.concatenate([turned, normals])
        bounds = np.concatenate([bounds, bound])
        looked_at += len(fresh)
        enough = max(best * (1 + TOLERANCE), best + floor)
        order = np.flatnonzero(bounds > enough)
        order = order[np.argsort(-bounds[order], kind="stable")]
        pieces, turned, bounds = pieces[order], turned[order], bounds[order]
        if looked_at > _MOST_PIECES:
            break
        # The most promising first: they raise the maximum, and the others need not be cut.
        a, b, c = np.moveaxis(pieces[:_AT_ONCE], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        cut = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        fresh, normals = np.concatenate([np.stack(part, axis=1) for part in cut]), np.tile(turned[:_AT_ONCE], (4, 1))
        pieces, turned, bounds = pieces[_AT_ONCE:], turned[_AT_ONCE:], bounds[_AT_ONCE:]
    at_most = max(best + floor, best * (1 + TOLERANCE), float(bounds.max(initial=0.0)))
    return {
        "max": 1e3 * best,
        "p99": float(1e3 * np.percentile(distance, 99)),
        "mean": float(1e3 * distance.mean()),
        "at_mm": [round(1e3 * float(x), 3) for x in where],
        "at_most": 1e3 * at_most,
    }


def _to_triangle(points: Array, corners: Array) -> Array:
    """Distance (n,) of each point (n, 3) to its own triangle (n, 3, 3)."""
    nearest = np.full(len(points), np.inf)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    above = length > 0
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        offset = points - start
        share = np.einsum("ij,ij->i", offset, along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
        nearest = np.minimum(nearest, np.linalg.norm(offset - np.clip(share, 0, 1)[:, None] * along, axis=1))
        above &= np.einsum("ij,ij->i", np.cross(along, offset), normal) >= 0
    height = np.abs(np.einsum("ij,ij->i", points - corners[:, 0], normal)) / np.maximum(length, 1e-300)
    return np.where(above, np.minimum(height, nearest), nearest)
