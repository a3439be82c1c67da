"""Exact gaps of one tapered capsule or ball: to spheres in closed form, to a closed mesh by branch and bound.

A tapered capsule is the union of the balls B(c(s), r(s)), c and r linear in s from (c1, r1) to (c2, r2). Metres.
"""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def axial_gap(along: Array, across: Array, length: Array, r1: Array, r2: Array) -> tuple[Array, Array]:
    """Signed gap of points to a tapered capsule, from their place along and across its axis, and where s the least is.

    All broadcast together. f(s) = |point - c(s)| - r(s) is convex in s, so its least value is at the stationary point
    cut to the axis: (along - s) / across = tan(phi) with sin(phi) = (r1 - r2) / length.
    """
    slope = np.divide(
        r1 - r2, length, out=np.zeros(np.broadcast_shapes(np.shape(r1), np.shape(length))), where=length > 0
    )
    # One ball inside the other: the hull is the larger ball, and f falls towards its end.
    steep = np.abs(slope) >= 1
    tangent = slope / np.sqrt(np.where(steep, 1, 1 - slope * slope))
    s = np.where(steep, np.where(slope > 0, 0.0, length), np.clip(along - across * tangent, 0, length))
    return np.hypot(along - s, across) - (r1 - s * slope), s


def capsule_point_gap(c1: Array, r1: Array, c2: Array, r2: Array, points: Array) -> Array:
    """Signed gap of points (..., 3) to tapered capsules, ends (..., 3), radii (...), broadcast together. Metres."""
    axis = c2 - c1
    length = np.linalg.norm(axis, axis=-1)
    axis = np.divide(axis, length[..., None], out=np.zeros_like(axis), where=length[..., None] > 0)
    offset = points - c1
    along = np.einsum("...i,...i->...", offset, axis)
    across = np.linalg.norm(offset - along[..., None] * axis, axis=-1)
    return axial_gap(along, across, length, r1, r2)[0]


class Mesh:
    """A closed mesh ready for queries. vertices: (v, 3) metres; faces: (f, 3), outward winding."""

    def __init__(self, vertices: Array, faces: NDArray[np.integer]) -> None:
        self._vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._tree = igl.AABB()
        self._tree.init(self._vertices, self._faces)
        self._winding = igl.FastWindingNumberBVH()
        self._winding.init(self._vertices, self._faces, 2)

    def closest(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,), negative inside, and closest point (n, 3) of points (n, 3)."""
        if len(points) == 0:
            return np.zeros(0), np.zeros((0, 3))
        points = np.ascontiguousarray(points)
        squared, _, nearest = self._tree.squared_distance(self._vertices, self._faces, points)
        inside = self._winding.winding_number(points, 2.0) > 0.5
        return np.where(inside, -1.0, 1.0) * np.sqrt(squared), nearest


def signed_distance(vertices: Array, faces: NDArray[np.integer], points: Array) -> Array:
    """Signed distance of points (n, 3) to a closed mesh, metres; negative inside (winding number above 1/2)."""
    return Mesh(vertices, faces).closest(points)[0]


def capsule_mesh_gap(
    mesh: Mesh, c1: Array, r1: Array, c2: Array, r2: Array, band_m: float, tolerance_m: float, enough_m: float = -np.inf
) -> tuple[Array, Array]:
    """Least of signed distance(c(s)) - r(s) along k tapered capsules; ends (k, 3), radii (k,).

    Returns (least value found, proven lower bound), each (k,). Where the value is below band_m the two are at most
    tolerance_m apart; elsewhere the bound is at least band_m and the value only what was seen on the way. The search
    along a capsule also ends when a value below enough_m is seen.
    """
    (d1, y1), (d2, y2) = mesh.closest(c1), mesh.closest(c2)
    found = np.minimum(d1 - r1, d2 - r2)
    bound = found.copy()
    piece = np.arange(len(c1))
    while len(piece):
        low, cut = _piece_bound(c1, r1, d1, y1, c2, r2, d2, y2)
        refine = (low < np.minimum(found[piece] - tolerance_m, band_m)) & (found[piece] >= enough_m)
        np.minimum.at(bound, piece[~refine], low[~refine])
        piece, cut = piece[refine], cut[refine]
        c1, r1, d1, y1, c2, r2, d2, y2 = (part[refine] for part in (c1, r1, d1, y1, c2, r2, d2, y2))
        middle = c1 + cut[:, None] * (c2 - c1)
        radius = r1 + cut * (r2 - r1)
        distance, nearest = mesh.closest(middle)
        np.minimum.at(found, piece, distance - radius)
        piece = np.concatenate([piece, piece])
        c1, c2 = np.concatenate([c1, middle]), np.concatenate([middle, c2])
        r1, r2 = np.concatenate([r1, radius]), np.concatenate([radius, r2])
        d1, d2 = np.concatenate([d1, distance]), np.concatenate([distance, d2])
        y1, y2 = np.concatenate([y1, nearest]), np.concatenate([nearest, y2])
    return found, np.minimum(bound, found)


def _piece_bound(
    c1: Array, r1: Array, d1: Array, y1: Array, c2: Array, r2: Array, d2: Array, y2: Array
) -> tuple[Array, Array]:
    """Lower bound of signed distance - radius over pieces of axes, and where in [0, 1] to cut each.

    d1, d2: signed distances of the ends; y1, y2: their closest points.
    """
    length = np.linalg.norm(c2 - c1, axis=1)
    # Distance is 1-Lipschitz along the axis.
    low = 0.5 * (d1 + d2 - length) - np.maximum(r1, r2)
    cut = np.full(len(low), 0.5)

    # The balls about the two ends that hold no surface cover the piece: it is all outside or all inside.
    one_side = (np.abs(d1) + np.abs(d2) > length) & (d1 * d2 > 0)
    # Outside: distance^2(x) - |x|^2 is a least of affine functions of x, so concave; on the piece distance is at least
    # that to one point which is d1 from one end and d2 from the other.
    k = one_side & (d1 > 0) & (length > 0)
    along = (d1[k] ** 2 - d2[k] ** 2 + length[k] ** 2) / (2 * length[k])
    across = np.sqrt(np.maximum(d1[k] ** 2 - along**2, 0))
    low[k], s = axial_gap(along, across, length[k], r1[k], r2[k])
    cut[k] = np.clip(s / length[k], 0.2, 0.8)
    # Inside: depth is at most the distance to either closest point, and that plus r(s) is convex, so largest at an end.
    k = one_side & (d1 < 0)
    to_y1 = np.maximum(r1[k] - d1[k], r2[k] + np.linalg.norm(c2[k] - y1[k], axis=1))
    to_y2 = np.maximum(r2[k] - d2[k], r1[k] + np.linalg.norm(c1[k] - y2[k], axis=1))
    low[k] = -np.minimum(to_y1, to_y2)
    return low, cut
