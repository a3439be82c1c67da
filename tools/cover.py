"""How well a union of spheres stands for a solid: gap, protrusion and felt normals, on samples of its own."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.tools.solid import Solid, make_solid, sample_surface, signed_distance

Array = NDArray[np.float64]

PROBE_M = 0.002  # what reaches a notch counts as skin
FINGERTIP_M = 0.007
MM = 1e3
# Chord from the middle of a patch to its corners, times the cells a side: an equiangular cell is at most pi / 2 / cells
# wide and skewed by at most 30 degrees, sqrt(2) (pi / 4) sqrt(1.335).
_PATCH_EXTENT = 1.3


def level_errors(
    levels: list[Array], vertices_m: Array, faces: NDArray[np.integer], seed: int = 0
) -> list[dict[str, Any]]:
    """Error of each level of spheres (n, 4) in metres against the closed mesh, in the form of the pack's manifest.

    gap: from points of the mesh surface out to the union, positive part. protrusion: from the union's skin out to the
    mesh, positive part, over the skin that a 2 mm ball from outside can touch. normal_error: between the normal that a
    7 mm ball rolled over the union meets and the one that it would meet on the mesh at the same place. All by area;
    max is the largest of the samples: 60,000 for the gap and 30,000 for protrusion on the leaves, a tenth on
    the levels above. Raises BadMesh.
    """
    solid = make_solid(vertices_m, faces)
    rows = []
    for k, spheres in enumerate(levels):
        count = 60_000 if k == len(levels) - 1 else 6_000
        points, _ = sample_surface(solid, count, seed + 101)
        gap = np.maximum(union_gap(spheres, points), 0)
        outward, weight = protrusion(solid, spheres, count // 2, seed + 202)
        angle, angle_weight = felt_normal_error(solid, spheres, count // 8, seed + 303)
        rows.append(
            {
                "spheres": len(spheres),
                "protrusion_mm": _summary(outward * MM, weight),
                "gap_mm": _summary(gap * MM, np.ones(len(gap))),
                "normal_error_deg": {
                    "median": weighted_quantile(angle, angle_weight, 0.5),
                    "p95": weighted_quantile(angle, angle_weight, 0.95),
                },
            }
        )
    return rows


def union_gap(spheres: Array, points: Array) -> Array:
    """Distance (n,) from points (n, 3) to the union of spheres (m, 4), exact where positive; 0 or below is inside."""
    gap = np.full(len(points), np.inf)
    left = np.arange(len(points))
    # Few large spheres hide most points: taken first, they leave little to search.
    order = np.argsort(-spheres[:, 3], kind="stable")
    start, chunk = 0, 8
    while start < len(order) and len(left):
        part = spheres[order[start : start + chunk]]
        near, distance = _pairs(cKDTree(points[left]), part, 0.0)
        np.minimum.at(gap, left[near], distance)
        left = left[gap[left] > 0]
        start, chunk = start + chunk, chunk * 8

    reach = 0.01 * float(np.ptp(points, axis=0).max() or 1.0)
    while len(left):
        near, distance = _pairs(cKDTree(points[left]), spheres, reach)
        np.minimum.at(gap, left[near], distance)
        # A sphere that was not seen is farther than the reach.
        left = left[gap[left] > reach]
        reach *= 4
    return gap


def protrusion(solid: Solid, spheres: Array, count: int, seed: int) -> tuple[Array, Array]:
    """How far samples of the union's reachable skin stick out of the solid (n,), 0 where they do not; areas (n,)."""
    spacing = np.sqrt(solid.areas.sum() / count)
    owner, direction, solid_angle = exposed_skin(spheres, PROBE_M, spacing, seed)
    centre, radius = spheres[owner, :3], spheres[owner, 3]
    out, _, _ = signed_distance(solid, centre + radius[:, None] * direction)
    reached = out >= 0
    # The probe is outside the union already; inside the mesh it sits in a hole between the spheres.
    inner = np.flatnonzero(~reached)
    if len(inner):
        probe = centre[inner] + (radius[inner, None] + PROBE_M) * direction[inner]
        reached[inner] = signed_distance(solid, probe)[0] > 0
    return np.maximum(out, 0)[reached], (solid_angle * radius**2)[reached]


def felt_normal_error(solid: Solid, spheres: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Angle (n,) in degrees between the normals that a fingertip meets on the union and on the mesh; areas (n,)."""
    spacing = np.sqrt(solid.areas.sum() / count)
    owner, direction, solid_angle = exposed_skin(spheres, FINGERTIP_M, spacing, seed)
    reach = spheres[owner, 3] + FINGERTIP_M
    ball = spheres[owner, :3] + reach[:, None] * direction
    out, closest, _ = signed_distance(solid, ball)
    felt = out > 0
    normal = (ball - closest)[felt] / out[felt, None]
    cosine = np.clip(np.einsum("ij,ij->i", normal, direction[felt]), -1, 1)
    return np.degrees(np.arccos(cosine)), (solid_angle * reach**2)[felt]


def exposed_skin(spheres: Array, offset: float, spacing: float, seed: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Samples of the union's skin that a ball of radius `offset` touches from outside the union.

    Every sphere is cut into patches of about spacing^2; a patch inside another sphere (both grown by offset) is
    dropped whole, the others are split. Returns sphere (n,), outward direction (n, 3) and solid angle (n,).
    """
    rng = np.random.default_rng(seed)
    grown = spheres[:, 3] + offset
    neighbours = _nearest_spheres(spheres, 24)
    start = 4  # 6 x 4 x 4 patches of about 20 degrees
    coarse = np.indices((6, start, start)).reshape(3, -1).T
    coarse_centre, _ = _patch_direction(coarse, start, np.array([0.5, 0.5]))
    owners, directions, angles = [], [], []
    for first in range(0, len(spheres), 4096):
        block = np.arange(first, min(first + 4096, len(spheres)))
        owner = np.repeat(block, len(coarse))
        patch = np.tile(coarse, (len(block), 1))
        centre = np.tile(coarse_centre, (len(block), 1))
        seen = ~_hidden_by(spheres, grown, owner, centre, _PATCH_EXTENT / start, neighbours)
        owner, patch, cells = owner[seen], patch[seen], start
        while len(owner):
            fine = grown[owner] ** 2 * (4 * np.pi / 6 / cells**2) <= 2 * spacing**2
            sampled, angle = _patch_direction(patch[fine], cells, rng.random((int(fine.sum()), 2)))
            bare = ~_inside_any(spheres, grown, owner[fine], sampled)
            owners.append(owner[fine][bare])
            directions.append(sampled[bare])
            angles.append(angle[bare])

            owner = np.repeat(owner[~fine], 4)
            patch = np.repeat(patch[~fine], 4, axis=0) * np.array([1, 2, 2])
            patch[:, 1:] += np.tile([[0, 0], [0, 1], [1, 0], [1, 1]], (len(owner) // 4, 1))
            cells *= 2
            centre, _ = _patch_direction(patch, cells, np.array([0.5, 0.5]))
            bare = ~_hidden_by(spheres, grown, owner, centre, _PATCH_EXTENT / cells, neighbours)
            owner, patch = owner[bare], patch[bare]
    return np.concatenate(owners), np.concatenate(directions), np.concatenate(angles)


def weighted_quantile(values: Array, weights: Array, share: float) -> float:
    """Smallest value that `share` of the weight does not exceed; 0 of nothing."""
    if not len(values):
        return 0.0
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order[min(np.searchsorted(total, share * total[-1]), len(values) - 1)]])


def _summary(values: Array, weights: Array) -> dict[str, float]:
    if not len(values):
        return {"max": 0.0, "p99": 0.0, "mean": 0.0}
    return {
        "max": float(values.max()),
        "p99": weighted_quantile(values, weights, 0.99),
        "mean": float(np.average(values, weights=weights)),
    }


def _pairs(tree: cKDTree, spheres: Array, reach: float) -> tuple[NDArray[np.int64], Array]:
    """Every (point, distance to the sphere's skin) with the distance at most reach."""
    found = tree.query_ball_point(spheres[:, :3], spheres[:, 3] + reach)
    counts = np.array([len(part) for part in found])
    if not counts.sum():
        return np.empty(0, np.int64), np.empty(0)
    point = np.fromiter(chain.from_iterable(found), dtype=np.int64, count=int(counts.sum()))
    sphere = np.repeat(np.arange(len(spheres)), counts)
    return point, np.linalg.norm(tree.data[point] - spheres[sphere, :3], axis=1) - spheres[sphere, 3]


def _nearest_spheres(spheres: Array, count: int) -> NDArray[np.int64]:
    """Indices (n, k) of the spheres whose centres are nearest, itself among them."""
    count = min(count, len(spheres))
    return cKDTree(spheres[:, :3]).query(spheres[:, :3], k=count)[1].reshape(len(spheres), count)


def _patch_direction(patch: NDArray[np.int64], cells: int, at: Array) -> tuple[Array, Array]:
    """Unit directions (n, 3) at `at` in [0, 1]^2 of patches (side of a cube, row, column), and solid angles (n,)."""
    s = np.tan(np.pi / 4 * (2 * (patch[:, 1:] + at) / cells - 1))
    u, v = s[:, 0], s[:, 1]
    length = np.sqrt(1 + u * u + v * v)
    local = np.column_stack([np.ones(len(patch)), u, v]) / length[:, None]
    axis, sign = patch[:, 0] % 3, 1 - 2 * (patch[:, 0] // 3)
    direction = np.empty_like(local)
    rows = np.arange(len(patch))
    direction[rows, axis] = local[:, 0] * sign
    direction[rows, (axis + 1) % 3] = local[:, 1]
    direction[rows, (axis + 2) % 3] = local[:, 2]
    # Area of the patch on the sphere: the equiangular map's Jacobian at the sample.
    return direction, (1 + u * u) * (1 + v * v) / length**3 * (np.pi / 2 / cells) ** 2


def _hidden_by(
    spheres: Array,
    grown: Array,
    owner: NDArray[np.int64],
    centre: Array,
    extent: float,
    neighbours: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Whether each patch (centre direction, chord) of its owner lies inside one of the owner's neighbours."""
    hidden = np.zeros(len(owner), dtype=bool)
    rest, who = np.arange(len(owner)), owner
    point = spheres[owner, :3] + grown[owner, None] * centre
    for k in range(neighbours.shape[1]):
        other = neighbours[who, k]
        offset = point - spheres[other, :3]
        room = np.maximum(grown[other] - grown[who] * extent, 0)
        found = (np.einsum("ij,ij->i", offset, offset) < room**2) & (other != who)
        hidden[rest[found]] = True
        if found.any():
            rest, who, point = rest[~found], who[~found], point[~found]
    return hidden


def _inside_any(spheres: Array, grown: Array, owner: NDArray[np.int64], direction: Array) -> NDArray[np.bool_]:
    """Whether the point of each owner's grown skin in this direction lies inside some other grown sphere."""
    inside = np.zeros(len(owner), dtype=bool)
    point = spheres[owner, :3] + grown[owner, None] * direction
    # Equal spheres, or a point in the seam of two: rounding must not hide it behind both.
    reach = np.maximum(grown - 1e-9 * grown.max(), 0)
    left = np.arange(len(owner))
    # A deep point lies in hundreds of spheres: a few spheres from everywhere find it before all are asked.
    for first, step in ((0, 64), (1, 8), (0, 1)):
        asked = np.arange(first, len(spheres), step)
        if not len(asked) or not len(left):
            continue
        found = cKDTree(point[left]).query_ball_point(spheres[asked, :3], reach[asked])
        for other, part in zip(asked, found, strict=True):
            if part:
                near = left[part]
                inside[near[owner[near] != other]] = True
        left = left[~inside[left]]
    return inside
