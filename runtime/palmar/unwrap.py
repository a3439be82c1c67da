"""A surface as an image: unwrapped by its six sides.

Each triangle is seen along the axis that it faces most, and what lies behind other triangles of that side goes to a
further layer. So every point is there once, at most 1.73 times as dense as elsewhere, for any mesh and in linear time,
and the image still looks like the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palmar.raster import Hits, find_hits, ranks

Array = NDArray[np.float64]

_MARGIN = 2
# Axis that is looked along, and from which side; right and up are the next two, mirrored seen from behind.
SIDES = [(axis, sign) for axis in range(3) for sign in (1, -1)]


@dataclass(frozen=True)
class Unwrapped:
    """Texels of a surface: place in an image of `shape` (rows, columns), point (n, 3), area (n,).

    face (n,) and share (n, 3): the triangle that each lies on, and the barycentric coordinates there.
    """

    shape: tuple[int, int]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    face: NDArray[np.int64]
    share: Array
    points: Array
    areas: Array
    pitch_m: float


def unwrap(vertices_m: Array, faces: NDArray[np.integer], texels: int) -> Unwrapped:
    """About so many texels over a whole surface, (v, 3) and (f, 3), its six sides and their layers set in rows."""
    corners = vertices_m[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(double, 1e-300)[:, None]
    # Triangles thinner than rounding have no direction of their own.
    normals[double < 1e-14 * double.max(initial=0.0)] = 0
    faced = np.argmax(np.abs(normals), axis=1)
    towards = np.take_along_axis(normals, faced[:, None], 1)[:, 0]
    pitch = float(np.sqrt((0.5 * double * np.abs(towards)).sum() / texels))
    tiles: list[tuple[Hits, Array]] = []
    for axis, sign in SIDES:
        own = np.flatnonzero((faced == axis) & (towards * sign > 0))
        across, up = (axis + 1) % 3, (axis + 2) % 3
        flat = np.stack([sign * corners[own][:, :, across], corners[own][:, :, up]], axis=2) / pitch
        hits = find_hits(flat)
        points = hits.of(corners[own])
        layer = ranks(hits, sign * points[:, axis])
        hits = Hits(hits.column, hits.row, own[hits.face], hits.share)
        for k in range(int(layer.max(initial=-1)) + 1):
            tiles.append((hits.taken(layer == k), points[layer == k]))
    boxes = [(int(np.ptp(hits.column)) + 1, int(np.ptp(hits.row)) + 1) for hits, _ in tiles]
    places, shape = _set_in_rows(boxes)
    rows, columns = [], []
    for (hits, _), (left, top), (_, height) in zip(tiles, places, boxes, strict=True):
        columns.append(left + hits.column - hits.column.min())
        rows.append(top + height - 1 - (hits.row - hits.row.min()))  # up is up
    points = np.concatenate([points for _, points in tiles])
    face, share = (np.concatenate(parts) for parts in zip(*((hits.face, hits.share) for hits, _ in tiles), strict=True))
    areas = pitch**2 / np.abs(towards[face])
    return Unwrapped(shape, np.concatenate(rows), np.concatenate(columns), face, share, points, areas, pitch)


def _set_in_rows(boxes: list[tuple[int, int]]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Left and top of each box (width, height) in an image about square, and its shape (rows, columns)."""
    area = sum((w + 2 * _MARGIN) * (h + 2 * _MARGIN) for w, h in boxes)
    width = max(int(np.sqrt(1.2 * area)), max(w for w, _ in boxes) + 2 * _MARGIN)
    places: list[tuple[int, int]] = [(0, 0)] * len(boxes)
    left, top, deep, widest = _MARGIN, _MARGIN, 0, 0
    for k in sorted(range(len(boxes)), key=lambda k: (-boxes[k][1], k)):
        if left > _MARGIN and left + boxes[k][0] + _MARGIN > width:
            left, top, deep = _MARGIN, top + deep + 2 * _MARGIN, 0
        places[k] = (left, top)
        left += boxes[k][0] + 2 * _MARGIN
        deep, widest = max(deep, boxes[k][1]), max(widest, left)
    return places, (top + deep + _MARGIN, widest)
