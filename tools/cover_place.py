"""Errors of a union of spheres at points of the surface, and the places where they are worst."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from palmar._runtime import union_exits, union_nearest
from palmar.tools.solid import Solid, closest_points, signed_distance, smooth_normals

Array = NDArray[np.float64]

FINGERTIP_M = 0.007
MM = 1e3
WORST_SHARE = 0.02  # of the surface or the skin: what is put together to places
PLACES = 5
_TOUCHES = 0.98  # of its radius, and a fingertip rests at the point; less: something else keeps it away
_LOOKED_AT = 100  # points of a place, for its word
_WALL = -0.7  # cosine of the normals on both sides of a wall
_THIN = 0.1  # of the object's size
_NEAR = 4.0  # errors: how near an edge or a notch is to be the reason


@dataclass(frozen=True)
class SurfaceErrors:
    """One value (n,) for each point of the surface. A point has a gap or a protrusion, not both."""

    gap_m: Array  # from the point out to the union
    protrusion_m: Array  # how far the skin that the point's normal leaves the union at is from the surface
    normal_deg: Array  # between the surface's normal and the union's, there
    felt_offset_m: Array  # how much farther out a fingertip rests; negative: farther in. NaN: none reaches the place
    felt_normal_deg: Array  # between what a fingertip feels of both; NaN as above

    @property
    def signed_m(self) -> Array:
        """Protrusion above 0, gap below."""
        return self.protrusion_m - self.gap_m


def surface_errors(solid: Solid, spheres: Array, points: Array, normals: Array, felt: bool = True) -> SurfaceErrors:
    """Errors at points of the surface (n, 3) with unit outward normals (n, 3), of spheres (m, 4).

    felt: also what a fingertip feels; NaN everywhere if not.
    """
    spheres, points, normals = (np.ascontiguousarray(array) for array in (spheres, points, normals))
    distance, owner = union_nearest(spheres, points)
    covered = np.flatnonzero(distance <= 0)
    length, last = union_exits(spheres, points[covered], normals[covered])
    skin = points[covered] + length[:, None] * normals[covered]
    protrusion, seen_from, at = np.zeros(len(points)), owner.copy(), points.copy()
    protrusion[covered] = np.maximum(signed_distance(solid, skin)[0], 0)
    seen_from[covered], at[covered] = last, skin

    offset, turn = np.full(len(points), np.nan), np.full(len(points), np.nan)
    if felt:
        ball = points + FINGERTIP_M * normals
        rest, foot, _ = closest_points(solid, ball)
        touches = rest >= _TOUCHES * FINGERTIP_M
        ball, rest, foot = ball[touches], rest[touches], foot[touches]
        met, met_by = union_nearest(spheres, np.ascontiguousarray(ball))
        offset[touches] = rest - met
        turn[touches] = _angle_deg(ball - spheres[met_by, :3], (ball - foot) / rest[:, None])
    return SurfaceErrors(
        gap_m=np.maximum(distance, 0),
        protrusion_m=protrusion,
        normal_deg=_angle_deg(at - spheres[seen_from, :3], normals),
        felt_offset_m=offset,
        felt_normal_deg=turn,
    )


def worst_places(
    solid: Solid, points: Array, error_m: Array, weight: Array, least_m: float, kind: str, apart_m: float
) -> list[dict[str, Any]]:
    """Where the error is among the worst 2 % of the area, and above least_m, put together to places, the worst first.

    points (n, 3) of the surface, their errors (n,) and areas (n,). A place is a group of such points, each within
    apart_m of another, as far as that is 4 to 12 sample distances. Each: kind, at_mm (of the largest error), centre_mm,
    extent_mm, area_mm2, max_mm, mean_mm, what (see `_reason`) and thickness_mm, None where it is no wall.
    """
    limit = max(_weighted_limit(error_m, weight), least_m)
    bad = np.flatnonzero(error_m > limit)
    if not len(bad):
        return []
    spacing = float(np.sqrt(weight.sum() / len(points)))
    pairs = cKDTree(points[bad]).query_pairs(np.clip(apart_m, 4 * spacing, 12 * spacing), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(bad), len(bad)))
    count, label = connected_components(links, directed=False)
    largest = np.zeros(count)
    np.maximum.at(largest, label, error_m[bad])
    places = []
    for group in np.argsort(-largest, kind="stable")[:PLACES]:
        own = bad[label == group]
        worst = own[np.argmax(error_m[own])]
        share = weight[own] / weight[own].sum()
        what, thickness = _reason(solid, points[own], float(error_m[worst]))
        places.append(
            {
                "kind": kind,
                "at_mm": _rounded(points[worst]),
                "centre_mm": _rounded(share @ points[own]),
                "extent_mm": round(float(np.ptp(points[own], axis=0).max() + spacing) * MM, 2),
                "area_mm2": round(float(weight[own].sum()) * MM**2, 2),
                "max_mm": float(error_m[worst]) * MM,
                "mean_mm": float(share @ error_m[own]) * MM,
                "what": what,
                "thickness_mm": thickness,
            }
        )
    return places


def _reason(solid: Solid, points: Array, error_m: float) -> tuple[str, float | None]:
    """What most of the points (n, 3) of a place lie on, by the largest balls that touch there inside and outside.

    "concave notch": the outer ball is small, and smaller than the inner; "sharp edge": the inner ball is small, and
    what else it touches stands across; "thin wall": it touches the other side of less than a tenth of the object, and
    then the thickness of the wall is given; else "plain side": nothing but the number of spheres.
    """
    points = points[:: max(1, len(points) // _LOOKED_AT)]
    _, foot, face = closest_points(solid, points)
    normals = smooth_normals(solid, foot, face)
    inner, across = _touching_balls(solid, foot, -normals)
    outer, _ = _touching_balls(solid, foot, normals)
    near = _NEAR * max(error_m, 1e-3 * solid.size)
    wall = across < _WALL
    notch = (outer < near) & (outer < inner)
    edge = ~notch & ~wall & (inner < near)
    thin = ~notch & ~edge & wall & (2 * inner < _THIN * solid.size)
    names = ("concave notch", "sharp edge", "thin wall", "plain side")
    found = (notch, edge, thin, ~(notch | edge | thin))
    most = int(np.argmax([which.sum() for which in found]))
    thickness = round(float(np.median(2 * inner[thin])) * MM, 3) if names[most] == "thin wall" else None
    return names[most], thickness


def _touching_balls(solid: Solid, points: Array, directions: Array) -> tuple[Array, Array]:
    """Radius (n,) of the largest ball on one side of each surface point, and cosine of the normals where it touches.

    Shrinking balls (Ma, Bae, Choi 2012) from half the object's size; cosine 1 where none but the point was met.
    """
    _, _, own_face = closest_points(solid, points)
    radius = np.full(len(points), 0.5 * solid.size)
    cosine = np.ones(len(points))
    left = np.arange(len(points))
    for _ in range(40):
        centre = points[left] + radius[left, None] * directions[left]
        distance, touched, face = closest_points(solid, centre)
        away = points[left] - touched
        along = -np.einsum("ij,ij->i", away, directions[left])
        smaller = np.einsum("ij,ij->i", away, away) / np.maximum(2 * along, 1e-300)
        shrinks = (distance < radius[left] * (1 - 1e-3)) & (along > 0) & (smaller < radius[left])
        left, smaller, face = left[shrinks], smaller[shrinks], face[shrinks]
        if not len(left):
            break
        radius[left] = smaller
        cosine[left] = np.einsum("ij,ij->i", solid.normals[face], solid.normals[own_face[left]])
    return radius, cosine


def _weighted_limit(error: Array, weight: Array) -> float:
    order = np.argsort(error, kind="stable")
    total = np.cumsum(weight[order])
    return float(error[order[min(np.searchsorted(total, (1 - WORST_SHARE) * total[-1]), len(error) - 1)]])


def _angle_deg(directions: Array, normals: Array) -> Array:
    length = np.maximum(np.linalg.norm(directions, axis=1), 1e-300)
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", directions, normals) / length, -1, 1)))


def _rounded(point: Array) -> list[float]:
    return [round(float(x) * MM, 3) for x in point]
