"""Triangles cut along a line on them, closed with caps, and spread with even points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def keep_above(values: Array, faces: NDArray[np.integer], level: float) -> tuple[Array, Faces]:
    """Cut the triangles where a value given at the vertices (v,) crosses the level, and keep what lies above.

    Returns how each new vertex mixes the old ones, a dense-friendly pair: mix (n, 3) of old vertex a, old vertex b and
    the share of b, and faces (f, 3) over the new vertices. Apply it with `mixed`.
    """
    # A value exactly at the level would make triangles without area.
    above = np.where(np.abs(values - level) < 1e-9, level + 1e-9, values) - level
    inside = above > 0
    rows: list[tuple[int, int, float]] = []
    number: dict[tuple[int, int], int] = {}

    def old(a: int) -> int:
        return point(a, a, 0.0)

    def point(a: int, b: int, share: float) -> int:
        key = (min(a, b), max(a, b))
        if key not in number:
            number[key] = len(rows)
            rows.append((a, b, share))
        return number[key]

    def crossing(a: int, b: int) -> int:
        return point(a, b, float(above[a] / (above[a] - above[b])))

    kept: list[tuple[int, int, int]] = []
    for face in faces:
        within = inside[face]
        count = int(within.sum())
        if count == 3:
            kept.append((old(face[0]), old(face[1]), old(face[2])))
        elif count:
            # Turn the corner that stands alone to the front.
            a, b, c = np.roll(face, -int(np.argmax(within if count == 1 else ~within)))
            if count == 1:
                kept.append((old(a), crossing(a, b), crossing(a, c)))
            else:
                ab, ac = crossing(a, b), crossing(a, c)
                kept += [(ab, old(b), old(c)), (ab, old(c), ac)]
    return np.array(rows, dtype=np.float64).reshape(-1, 3), np.array(kept, dtype=np.int64).reshape(-1, 3)


def mixed(mix: Array, values: Array) -> Array:
    """Values (n, ...) at the vertices of `keep_above` from those (v, ...) at the old ones."""
    share = mix[:, 2].reshape(-1, *(1,) * (values.ndim - 1))
    a, b = values[mix[:, 0].astype(int)], values[mix[:, 1].astype(int)]
    return (1 - share) * a + share * b


def boundary_loops(faces: NDArray[np.integer]) -> list[list[int]]:
    """The open edges as closed walks of vertices, each against the winding of its faces."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in edges}
    after: dict[int, list[int]] = {}
    for a, b in sorted(there):
        if (b, a) not in there:
            after.setdefault(b, []).append(a)
    loops = []
    while after:
        start = min(after)
        walk = [start]
        while walk[-1] in after:
            ways = after[walk[-1]]
            step = ways.pop()
            if not ways:
                del after[walk[-1]]
            if step == start:
                break
            walk.append(step)
        loops.append(walk)
    return loops


def cap(points: Array, faces: NDArray[np.integer]) -> tuple[Array, Faces]:
    """Close every open loop with a fan from its middle. The new vertices (n - v of them) stand at the end."""
    added: list[Array] = []
    fans: list[tuple[int, int, int]] = []
    for loop in boundary_loops(faces):
        ring = points[loop]
        length = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
        middle = np.average((ring + np.roll(ring, -1, axis=0)) / 2, axis=0, weights=length)
        centre = len(points) + len(added)
        added.append(middle)
        fans += [(a, b, centre) for a, b in zip(loop, np.roll(loop, -1).tolist(), strict=True)]
    if not added:
        return points, np.asarray(faces, dtype=np.int64)
    return np.vstack([points, added]), np.vstack([faces, np.array(fans, dtype=np.int64)])


def largest_part(faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Which faces (f,) belong to the connected part with the most of them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(faces.max()) + 1
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    return label == np.argmax(np.bincount(label))


def halved(values: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Every triangle cut in four, values (v, k) mixed alike."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    middle = len(values) + number.reshape(3, -1).T  # of edges ab, bc, ca
    values = np.vstack([values, values[unique].mean(axis=1)])
    a, b, c = faces.T
    ab, bc, ca = middle.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return values, np.concatenate([np.stack(part, axis=1) for part in parts])


def spread(points: Array, faces: NDArray[np.integer], spacing: float) -> tuple[NDArray[np.int64], Array, Array]:
    """Even points on every triangle, without chance: face (n,), barycentric coordinates (n, 3), area (n,) of each."""
    corner = points[faces]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    parts = np.maximum(1, np.ceil(np.sqrt(edge * np.sqrt(2 * area)) / spacing)).astype(int)
    face, where, share = [], [], []
    for n in np.unique(parts):
        of = np.flatnonzero(parts == n)
        grid = _centroids(int(n))
        face.append(np.repeat(of, len(grid)))
        where.append(np.tile(grid, (len(of), 1)))
        share.append(np.repeat(area[of] / len(grid), len(grid)))
    return np.concatenate(face), np.concatenate(where), np.concatenate(share)


def _centroids(n: int) -> Array:
    """Barycentric coordinates (n * n, 3) of the middles of the n * n equal parts of a triangle."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(n) for j in range(n - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(n - 1) for j in range(n - 1 - i)]
    uv = np.array(upright + turned) / n
    return np.column_stack([1 - uv.sum(axis=1), uv])
