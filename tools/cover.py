"""How well a union of spheres stands for a solid: gap, protrusion and felt normals, on samples of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar._runtime import union_gaps, union_skin
from palmar.tools.solid import Solid, make_solid, sample_surface, signed_distance

Array = NDArray[np.float64]

PROBE_M = 0.002  # what reaches a notch counts as skin
FINGERTIP_M = 0.007
MM = 1e3


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
    return union_gaps(np.ascontiguousarray(spheres), np.ascontiguousarray(points))


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
