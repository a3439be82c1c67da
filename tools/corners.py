"""Balls for what a cover to the 99th percentile leaves out: corners, sharp edges, spikes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palmar.tools.medial import inside_balls, medial_balls, merged_indices
from palmar.tools.set_cover import cover_greedily, find_incidence
from palmar.tools.solid import Solid
from palmar.tools.target import Target

Array = NDArray[np.float64]

_SHARP_DEG = 30.0
_MOST_POINTS = 60_000


def cover_corners(target: Target, balls: Array, limit: float, excess: float, seed: int, most: int) -> Array:
    """At most `most` further balls (k, 4), so that no surface point, edge or corner is left with g above the limit.

    balls (n, 4): centres and inside distances that are there already; g and excess as in `target`. Spikes that no ball
    within the limit can reach stay as they are.
    """
    solid = target.solid
    points, face, zone = target.sample(_MOST_POINTS, seed)
    edges, inwards = _sharp_edges(solid, limit / 2)
    edge_zone = target.regions.zone_of(edges)
    held = target.held(balls, excess)
    bare = target.gaps(held, points, zone, excess) > limit
    bare_edge = target.gaps(held, edges, edge_zone, excess) > limit if len(edges) else np.zeros(0, dtype=bool)
    places = np.concatenate([points[bare], edges[bare_edge]])
    if not len(places) or most <= 0:
        return np.empty((0, 4))
    # Down the bisector of an edge or corner the reach of a ball grows with its size: a few sizes around the limit do.
    away = np.concatenate([-solid.normals[face[bare]], inwards[bare_edge]])
    along = np.concatenate([places + step * limit * away for step in (0.5, 1, 2, 3, 4, 6)])
    tried = [inside_balls(solid, along)]
    if bare.any():
        tried.append(medial_balls(solid, points[bare], face[bare], 0.1 * limit))
    candidates = np.concatenate(tried)
    candidates = candidates[merged_indices(candidates, limit)]
    if not len(candidates):
        return np.empty((0, 4))
    pairs = find_incidence(target.held(candidates, excess), places, limit)
    stricter = target.stricter(np.concatenate([zone[bare], edge_zone[bare_edge]]))[pairs.sample]
    pairs = replace(pairs, gap=pairs.gap + ((pairs.gap - excess) * stricter).astype(np.float32)).within(limit)
    return candidates[cover_greedily(pairs, [], 0, most)]


def _sharp_edges(solid: Solid, spacing: float) -> tuple[Array, Array]:
    """Points (n, 3) along the sharp convex edges, ends among them, and inward directions (n, 3): the bisectors."""
    pairs = np.sort(solid.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(solid.faces)), 3)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    pairs, face = pairs[order], face[order]
    twin = np.flatnonzero((pairs[:-1] == pairs[1:]).all(axis=1))
    first, second = solid.normals[face[twin]], solid.normals[face[twin + 1]]
    sharp = np.einsum("ij,ij->i", first, second) < np.cos(np.radians(_SHARP_DEG))
    # Convex: the other face's far corner lies behind this face.
    start = solid.vertices[pairs[twin, 0]]
    middle = solid.vertices[solid.faces[face[twin + 1]]].mean(axis=1)
    sharp &= np.einsum("ij,ij->i", middle - start, first) < 0
    twin, bisector = twin[sharp], -(first + second)[sharp]
    if not len(twin):
        return np.empty((0, 3)), np.empty((0, 3))
    ends = pairs[twin]
    a, b = solid.vertices[ends[:, 0]], solid.vertices[ends[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    spacing = max(spacing, float(length.sum()) / _MOST_POINTS)
    counts = np.ceil(length / spacing).astype(np.int64)
    edge = np.repeat(np.arange(len(twin)), counts)
    at = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[edge]
    along = a[edge] + at[:, None] * (b - a)[edge]
    # At a corner the bisector of its edges' bisectors.
    corner = np.zeros_like(solid.vertices)
    np.add.at(corner, ends.ravel(), np.repeat(bisector, 2, axis=0))
    used = np.unique(ends)
    inwards = np.concatenate([bisector[edge], corner[used]])
    return (
        np.concatenate([along, solid.vertices[used]]),
        inwards / np.maximum(np.linalg.norm(inwards, axis=1), 1e-300)[:, None],
    )
