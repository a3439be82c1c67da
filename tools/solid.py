"""A closed mesh as a solid: area-uniform samples of its surface and the exact signed distance to it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from numpy.typing import NDArray

from palmar._runtime import TriangleTree
from palmar.errors import BadMesh

Array = NDArray[np.float64]

_CREASE_DEG = 25.0  # facets that meet at less stand for a smooth surface
_BLOCK = 100_000  # points or corners at a time, for memory
# R2 sequence (Roberts 2018), the plane's counterpart of the golden ratio: even inside one big triangle.
_R2 = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True)
class Solid:
    """Vertices (v, 3), faces (f, 3) outward, unit normals (f, 3), areas (f,), search tree; simple: no parts overlap."""

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array
    areas: Array
    tree: igl.AABB
    simple: bool

    @property
    def size(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def triangles(self) -> TriangleTree:
        """Search tree for many points deep inside, from one neighbour to the next."""
        return TriangleTree(self.vertices, self.faces)

    @cached_property
    def along(self) -> tuple[NDArray[np.int64], Array]:
        """The faces in order along a space-filling curve, and the sum of areas up to each."""
        return _along(self.vertices[self.faces].mean(axis=1), self.areas)

    @cached_property
    def corner_normals(self) -> Array:
        """Normals (f, 3, 3) at the corners of the faces, shared where the surface is smooth."""
        return _corner_normals(self)


def make_solid(vertices: Array, faces: NDArray[np.integer]) -> Solid:
    """Prepare a closed outward mesh. Raises BadMesh if it has no area or its inside lies outside."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles: NDArray[np.int64] = np.ascontiguousarray(faces, dtype=np.int64)
    if not len(triangles) or not np.isfinite(vertices).all():
        raise BadMesh(
            "E-MESH-EMPTY", "mesh", "no triangles, or coordinates that are not finite; a closed mesh is needed"
        )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    if not length.any():
        raise BadMesh("E-MESH-EMPTY", "mesh", "all triangles have area 0; a closed mesh is needed")
    volume = np.einsum("ij,ij->", a, cross) / 6
    if volume <= 0:
        raise BadMesh("E-MESH-INSIDE-OUT", "mesh", f"volume {volume:g}; triangles must wind outwards, volume above 0")
    normals = cross / np.maximum(length, 1e-300)[:, None]
    # Triangles thinner than rounding have no direction of their own, and none of their points decides a sign.
    normals[length < 1e-14 * length.max()] = 0
    tree = igl.AABB()
    tree.init(vertices, triangles)
    solid = Solid(vertices, triangles, normals, length / 2, tree, False)

    # Where all of the surface separates in from out, the face nearest to a point tells its side.
    points, face = sample_surface(solid, 1500, 1)
    step = 1e-6 * solid.size * normals[face]
    outside = igl.fast_winding_number(vertices, triangles, points + step)
    inside = igl.fast_winding_number(vertices, triangles, points - step)
    simple = (
        np.mean((outside < 0.5) & (inside > 0.5)) > 0.998
    )  # the rest: the approximation of the winding number at thin slits
    return Solid(vertices, triangles, normals, length / 2, tree, bool(simple))


def sample_surface(solid: Solid, count: int, seed: int) -> tuple[Array, NDArray[np.int64]]:
    """Area-uniform, evenly spread points on the surface: (count, 3), and the face (count,) of each."""
    slot, face, start = _sample(*solid.along, count, seed)
    return _inside_triangles((solid.vertices[solid.faces[face, k]] for k in range(3)), slot, start), face


def sample_triangles(corners: Array, areas: Array, count: int, seed: int) -> tuple[Array, NDArray[np.int64]]:
    """The same for triangles by their corners (t, 3, 3) and areas (t,)."""
    slot, face, start = _sample(*_along(corners.mean(axis=1), areas), count, seed)
    return _inside_triangles((corners[face, k] for k in range(3)), slot, start), face


def _along(middles: Array, areas: Array) -> tuple[NDArray[np.int64], Array]:
    """Triangles in order along a space-filling curve, and the sum of areas up to each."""
    order = morton_order(middles)
    return order, np.cumsum(areas[order])


def _sample(
    order: NDArray[np.int64], ends: Array, count: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Place in the order, triangle, and where in the triangle its points begin, of each sample."""
    rng = np.random.default_rng(seed)
    # Systematic sampling along the order: each triangle gets its share of points to within one.
    at = (np.arange(count) + rng.random()) * (ends[-1] / count)
    slot = np.minimum(np.searchsorted(ends, at, side="right"), len(order) - 1)
    return slot, order[slot], rng.random((len(order), 2))[slot]


def _inside_triangles(corners: Iterable[Array], slot: NDArray[np.int64], start: Array) -> Array:
    """One even sequence of points in each triangle: (n, 3)."""
    first = np.searchsorted(slot, slot, side="left")
    uv = (start + (np.arange(len(slot)) - first)[:, None] * _R2) % 1.0
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    a, b, c = corners
    return a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a)


def closest_points(solid: Solid, points: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Exact distance (n,) from points (n, 3) to the surface, the closest point (n, 3) and its face (n,)."""
    squared, face, closest = solid.tree.squared_distance(solid.vertices, solid.faces, np.ascontiguousarray(points))
    return np.sqrt(squared), closest, face


def signed_distance(solid: Solid, points: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Exact distance (n,) to the surface, positive outside, with closest point (n, 3) and its face (n,).

    Sign: winding number above 0.5 is inside. Where the closest point lies straight below the face and the mesh does not
    overlap itself, the face's side says the same, 10 to 100 times faster.
    """
    distance, closest, face = closest_points(solid, points)
    along = np.einsum("ij,ij->i", points - closest, solid.normals[face])
    outside = along > 0
    # 0.999: beside an edge or a corner the direction leaves the normal of the one face that was returned.
    unsure = np.flatnonzero((np.abs(along) < 0.999 * distance) | (not solid.simple))
    if len(unsure):
        outside[unsure] = igl.fast_winding_number(solid.vertices, solid.faces, points[unsure]) < 0.5
    return np.where(outside, distance, -distance), closest, face


def is_inside(solid: Solid, points: Array) -> NDArray[np.bool_]:
    """Whether the winding number of each point (n, 3) is above 0.5."""
    return igl.fast_winding_number(solid.vertices, solid.faces, np.ascontiguousarray(points)) > 0.5


def smooth_normals(solid: Solid, points: Array, face: NDArray[np.int64]) -> Array:
    """Unit outward normals (n, 3) at points on faces, blended between facets that meet at less than the crease angle.

    A facet of a round body points a little off its axis; a ball 40 mm deep feels that as millimetres.
    """
    found = np.empty((len(points), 3))
    for first in range(0, len(points), _BLOCK):
        some = slice(first, first + _BLOCK)
        a, b, c = (solid.vertices[solid.faces[face[some], k]] for k in range(3))
        at = points[some]
        share = np.stack([_double_area(at, b, c), _double_area(at, c, a), _double_area(at, a, b)], axis=1)
        share /= np.maximum(share.sum(axis=1), 1e-300)[:, None]
        blend = np.einsum("nk,nki->ni", share, solid.corner_normals[face[some]])
        length = np.linalg.norm(blend, axis=1)[:, None]
        found[some] = np.where(length > 0.1, blend / np.maximum(length, 1e-300), solid.normals[face[some]])
    return found


def _corner_normals(solid: Solid) -> Array:
    """Normal (f, 3, 3) at each corner of a face: the mean by area of the faces around it within the crease angle."""
    corner_vertex = solid.faces.ravel()
    order = np.argsort(corner_vertex, kind="stable")
    valence = np.bincount(corner_vertex, minlength=len(solid.vertices))
    start = np.cumsum(valence) - valence
    total = np.repeat(solid.normals * (1e-9 * solid.areas.max()), 3, axis=0)
    # A fan of hundreds of faces is a cap, flat or sharp: its facets' own normals serve.
    corners = np.flatnonzero(valence[corner_vertex] <= 64)
    for first in range(0, len(corners), _BLOCK):
        corner = corners[first : first + _BLOCK]
        counts = valence[corner_vertex[corner]]
        ends = np.cumsum(counts)
        own = np.repeat(np.arange(len(corner)), counts)
        at = np.repeat(start[corner_vertex[corner]] - (ends - counts), counts) + np.arange(ends[-1])
        other = order[at] // 3
        alike = np.einsum("ij,ij->i", solid.normals[corner[own] // 3], solid.normals[other])
        like = alike > np.cos(np.radians(_CREASE_DEG))
        own, other = own[like], other[like]
        for axis in range(3):
            weight = solid.normals[other, axis] * solid.areas[other]
            total[corner, axis] += np.bincount(own, weight, minlength=len(corner))
    length = np.linalg.norm(total, axis=1)
    return (total / np.maximum(length, 1e-300)[:, None]).reshape(-1, 3, 3)


def _double_area(a: Array, b: Array, c: Array) -> Array:
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def morton_order(points: Array) -> NDArray[np.int64]:
    """Order of points (n, 3) along a Z curve of 2^10 cells a side."""
    low = points.min(axis=0)
    cell = ((points - low) / max(np.ptp(points, axis=0).max(), 1e-300) * 1023).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
