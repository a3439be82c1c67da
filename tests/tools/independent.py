"""Distances by other code than the builder's: triangles one by one, in numpy, and SciPy's k-d tree."""

import numpy as np
from scipy.spatial import cKDTree

PAIRS = 2_000_000  # at once


def distance_to_triangles(points, vertices, faces):
    """Distance (n,) from points (n, 3) to the nearest triangle."""
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    # No farther than the nearest corner; a triangle that is nearer has its middle within that and its own radius.
    best = cKDTree(vertices[np.unique(faces)]).query(points)[0]
    group = np.ceil(np.log2(np.maximum(radius, 1e-12))).astype(int)
    for g in np.unique(group):
        own = np.flatnonzero(group == g)
        tree = cKDTree(middle[own])
        reach = (best + 2.0**g) * (1 + 1e-9)
        counts = tree.query_ball_point(points, reach, return_length=True)
        for first, last in _chunks(counts):
            near = tree.query_ball_point(points[first:last], reach[first:last])
            owner = np.repeat(np.arange(first, last), counts[first:last])
            face = own[np.concatenate(near).astype(int)] if len(owner) else owner
            np.minimum.at(best, owner, _to_triangle(points[owner], corners[face]))
    return best


def distance_to_spheres(points, spheres):
    """The least |point - centre| - radius (n,)."""
    best = np.full(len(points), np.inf)
    for first in range(0, len(spheres), 64):
        for k in range(first, min(first + 64, len(spheres))):
            np.minimum(best, np.linalg.norm(points - spheres[k, :3], axis=1) - spheres[k, 3], out=best)
    return best


def random_surface(vertices, faces, count, seed):
    """Points (n, 3) on the triangles: random by area, and every vertex and points along every edge as far as count."""
    rng = np.random.default_rng(seed)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum())
    share = rng.dirichlet([1, 1, 1], count)
    return np.einsum("nk,nki->ni", share, corners[face])


def edge_points(vertices, faces, count, seed):
    """Points (n, 3) along the edges, random by length, and the vertices."""
    rng = np.random.default_rng(seed)
    ends = vertices[np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    edge = rng.choice(len(ends), count, p=length / length.sum())
    along = rng.random((count, 1))
    return np.concatenate([vertices[np.unique(faces)], ends[edge, 0] * (1 - along) + ends[edge, 1] * along])


def solid_angle_winding(points, vertices, faces):
    """Winding number (n,) by the sum of solid angles (Van Oosterom and Strackee 1983), all triangles for all points."""
    found = np.zeros(len(points))
    step = max(1, PAIRS // max(len(faces), 1))
    for first in range(0, len(points), step):
        a, b, c = (vertices[faces[:, k]][None] - points[first : first + step, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        top = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        dots = (np.einsum("nfi,nfi->nf", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)))
        found[first : first + step] = np.arctan2(top, la * lb * lc + sum(dots)).sum(axis=1) / (2 * np.pi)
    return found


def _chunks(counts):
    ends = np.cumsum(counts)
    first = 0
    while first < len(counts):
        start = ends[first] - counts[first]
        last = max(first + 1, int(np.searchsorted(ends, start + PAIRS, side="right")))
        yield first, last
        first = last


def _to_triangle(p, corners):
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best = np.minimum(np.minimum(_to_segment(p, a, b), _to_segment(p, b, c)), _to_segment(p, c, a))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    over = length > 0
    for u, v in ((a, b), (b, c), (c, a)):
        over &= np.einsum("ni,ni->n", np.cross(v - u, p - u), normal) >= 0
    height = np.abs(np.einsum("ni,ni->n", p - a, normal)) / np.maximum(length, 1e-300)
    return np.where(over, np.minimum(height, best), best)


def _to_segment(p, a, b):
    along = b - a
    share = np.einsum("ni,ni->n", p - a, along) / np.maximum(np.einsum("ni,ni->n", along, along), 1e-300)
    return np.linalg.norm(p - a - np.clip(share, 0, 1)[:, None] * along, axis=1)
