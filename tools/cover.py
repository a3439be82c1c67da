"""How well a union of spheres stands for a solid: gap, protrusion and felt normals, on samples of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar._runtime import union_nearest, union_skin
from palmar.tools.solid import Solid, make_solid, sample_surface, signed_distance

Array = NDArray[np.float64]

PROBE_M = 0.002  # what reaches a notch counts as skin
FINGERTIP_M = 0.007
MM = 1e3
_POINTS = 60_000
_SHARES = {"p50": 0.5, "p95": 0.95}


def measure_cover(solid: Solid, spheres: Array, seed: int = 0) -> dict[str, Any]:
    """How well spheres (n, 4) stand for a solid, each figure by area on samples that no choice of spheres has seen.

    gap_mm and protrusion_mm as in `level_errors`, with p50 and p95; balanced_p99_mm: the mean of their p99.
    normal_deg: what a 2 mm ball rolled over the union feels against what it would feel of the mesh at the same place.
    felt: the same for a fingertip of 7 mm, with offset_mm: how far from its right place it rests, either way,
    held_off_mm and let_in_mm: the p99 of each way, and inside_share: of its places those with its middle in the solid,
    where spheres leave a hole; they are left out. volume: of union and mesh in cm3, and the ratio.
    """
    points, _ = sample_surface(solid, _POINTS, seed + 101)
    gap = np.maximum(union_gap(spheres, points), 0) * MM
    outward, weight = protrusion(solid, spheres, _POINTS // 2, seed + 202)
    _, angle, angle_weight = felt_errors(solid, spheres, PROBE_M, _POINTS // 4, seed + 404)
    return {
        "spheres": len(spheres),
        "gap_mm": _spread(gap, np.ones(len(gap))),
        "protrusion_mm": _spread(outward * MM, weight),
        "balanced_p99_mm": (
            weighted_quantile(gap, np.ones(len(gap)), 0.99) + weighted_quantile(outward * MM, weight, 0.99)
        )
        / 2,
        "normal_deg": _spread(angle, angle_weight),
        "felt": _felt(solid, spheres, seed + 303),
        "volume": _volumes(solid, spheres, seed + 505),
    }


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
        _, angle, area = felt_errors(solid, spheres, FINGERTIP_M, count // 8, seed + 303)
        felt = ~np.isnan(angle)
        rows.append(
            {
                "spheres": len(spheres),
                "protrusion_mm": _summary(outward * MM, weight),
                "gap_mm": _summary(gap * MM, np.ones(len(gap))),
                "normal_error_deg": {
                    "median": weighted_quantile(angle[felt], area[felt], 0.5),
                    "p95": weighted_quantile(angle[felt], area[felt], 0.95),
                },
            }
        )
    return rows


def union_gap(spheres: Array, points: Array) -> Array:
    """Distance (n,) from points (n, 3) to the union of spheres (m, 4), exact where positive; 0 or below is inside."""
    return union_nearest(np.ascontiguousarray(spheres), np.ascontiguousarray(points))[0]


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


def felt_errors(solid: Solid, spheres: Array, radius_m: float, count: int, seed: int) -> tuple[Array, Array, Array]:
    """A ball rolled over the union against one rolled over the mesh: offset (n,) in metres, angle (n,), area (n,).

    offset: how much farther from the mesh than its radius the ball's middle is; negative inside the solid, too. Angle
    in degrees between the normals that it meets on both; NaN with its middle inside the solid.
    """
    spacing = np.sqrt(solid.areas.sum() / count)
    owner, direction, solid_angle = exposed_skin(spheres, radius_m, spacing, seed)
    reach = spheres[owner, 3] + radius_m
    ball = spheres[owner, :3] + reach[:, None] * direction
    out, closest, _ = signed_distance(solid, ball)
    normal = (ball - closest) / np.maximum(np.abs(out), 1e-300)[:, None]
    angle = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", normal, direction), -1, 1)))
    return out - radius_m, np.where(out > 0, angle, np.nan), solid_angle * reach**2


def exposed_skin(spheres: Array, offset: float, spacing: float, seed: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Samples of the union's skin that a ball of radius `offset` touches from outside the union.

    About one for each spacing^2. Returns sphere (n,), outward direction (n, 3) and solid angle (n,).
    """
    return union_skin(np.ascontiguousarray(spheres), offset, spacing, seed)


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


def _spread(values: Array, weights: Array) -> dict[str, float]:
    known = ~np.isnan(values)
    values, weights = values[known], weights[known]
    shares = {name: weighted_quantile(values, weights, share) for name, share in _SHARES.items()}
    return {**shares, **_summary(values, weights)}


def _felt(solid: Solid, spheres: Array, seed: int) -> dict[str, Any]:
    offset, angle, area = felt_errors(solid, spheres, FINGERTIP_M, _POINTS // 2, seed)
    inside = np.isnan(angle)
    offset, angle, kept = offset[~inside] * MM, angle[~inside], area[~inside]
    return {
        "offset_mm": _spread(np.abs(offset), kept),
        "held_off_mm": weighted_quantile(np.maximum(offset, 0), kept, 0.99),
        "let_in_mm": weighted_quantile(np.maximum(-offset, 0), kept, 0.99),
        "normal_deg": _spread(angle, kept),
        "inside_share": float(area[inside].sum() / area.sum()) if len(area) else 0.0,
    }


def _volumes(solid: Solid, spheres: Array, seed: int) -> dict[str, float]:
    """By the divergence theorem over the skin, which sampling gives to some thousandths."""
    a, b, c = (solid.vertices[solid.faces[:, k]] - solid.vertices.mean(axis=0) for k in range(3))
    mesh = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
    spacing = np.sqrt(solid.areas.sum() / _POINTS)
    owner, direction, solid_angle = exposed_skin(spheres, 0.0, spacing, seed)
    radius = spheres[owner, 3]
    at = spheres[owner, :3] - solid.vertices.mean(axis=0) + radius[:, None] * direction
    union = float((np.einsum("ij,ij->i", at, direction) * solid_angle * radius**2).sum() / 3)
    return {"union_cm3": union * 1e6, "mesh_cm3": mesh * 1e6, "ratio": union / mesh}
