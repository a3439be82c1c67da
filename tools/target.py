"""What spheres are fitted to: a solid, and the zones of its surface where only a share of the error is allowed.

With a share w(y) of the excess e allowed at each surface point y, the ball at c may have the radius min over y of
|y - c| + w(y) e; without zones that is d(c) + e. It is written held(c) + e. A surface point s then lies
g(s, c) = |s - c| - held(c) from what covers it, of which e is given and the rest is measured in shares: g <= G means
that s is as close to the union as w(s) times what is asked.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from palmar import _runtime
from palmar._runtime import CoverFit, TriangleTree
from palmar.tools.cover import PROBE_M, exposed_skin, union_gap
from palmar.tools.region import Regions, zone_triangles
from palmar.tools.solid import Solid, sample_surface, sample_triangles, signed_distance, smooth_normals

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Of G: what the balls are grown by at the end.
EXCESS = {"balanced": 0.5, "inside": 0.0, "outside": 1.0}


@dataclass(frozen=True)
class Patch:
    """The triangles of one zone, cut where its border runs through them."""

    share: float
    corners: Array  # (t, 3, 3)
    face: Numbers  # (t,) of the solid

    @cached_property
    def areas(self) -> Array:
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    @cached_property
    def triangles(self) -> TriangleTree:
        return TriangleTree(
            np.ascontiguousarray(self.corners.reshape(-1, 3)), np.arange(3 * len(self.corners)).reshape(-1, 3)
        )


@dataclass(frozen=True)
class Target:
    solid: Solid
    regions: Regions
    patches: list[Patch]  # one for each share of the regions, in the order of `regions.shares`

    @cached_property
    def zones(self) -> list[tuple[TriangleTree, float]]:
        return [(patch.triangles, patch.share) for patch in self.patches]

    @cached_property
    def crowding(self) -> float:
        """How many times more spheres the zones make of it, roughly: error falls as 1 / count."""
        inner = sum(patch.areas.sum() * (1 / patch.share - 1) for patch in self.patches)
        return float(1 + inner / self.solid.areas.sum())

    def sample(self, count: int, seed: int) -> tuple[Array, Numbers, Numbers]:
        """About `count` points (n, 3), their face (n,) and zone (n,): 0 of the rest, k + 1 of patches[k].

        By area, and in zones as much denser as their error is to be less.
        """
        solid = self.solid
        points, face = sample_surface(solid, round(count / self.crowding), seed)
        if not self.patches:
            return points, face, np.zeros(len(points), dtype=np.int64)
        zone = self.regions.zone_of(points)
        parts = [(points[zone == 0], face[zone == 0], zone[zone == 0])]
        for k, patch in enumerate(self.patches):
            wanted = count / self.crowding / patch.share * patch.areas.sum() / solid.areas.sum()
            points, slot = sample_triangles(patch.corners, patch.areas, max(round(wanted), 200), seed + 1000 * (k + 1))
            zone = self.regions.zone_of(points)
            parts.append((points[zone == k + 1], patch.face[slot][zone == k + 1], zone[zone == k + 1]))
        points, face, zone = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return np.ascontiguousarray(points), face, zone

    def make_fit(self, samples: int, seed: int) -> CoverFit:
        points, face, zone = self.sample(samples, seed)
        inward = -smooth_normals(self.solid, points, face)
        threads = min(os.cpu_count() or 1, 8)
        return CoverFit(self.solid.triangles, self.zones, points, inward, face, zone, seed, threads)

    def held(self, balls: Array, excess: float) -> Array:
        """The balls (n, 4), centres and inside distances, with what they may count with instead."""
        if not self.patches:
            return balls
        held = _runtime.held_inside(self.zones, np.ascontiguousarray(balls), excess)
        return np.column_stack([balls[:, :3], held])

    def stricter(self, zone: Numbers) -> Array:
        """1 / share - 1 of each zone (n,)."""
        return np.array([0.0, *(1 / patch.share - 1 for patch in self.patches)])[zone]

    def gaps(self, held: Array, points: Array, zone: Numbers, excess: float) -> Array:
        """g (n,), see above, of surface points (n, 3) and their zones (n,) under balls (m, 4)."""
        gap = union_gap(held, points)
        return gap + (gap - excess) * self.stricter(zone)


def make_target(solid: Solid, regions: Regions) -> Target:
    """Raises BadMesh if a region holds no part of the surface."""
    return Target(solid, regions, [Patch(share, *zone_triangles(solid, regions, share)) for share in regions.shares])


def zone_errors(target: Target, leaves: Array, error_m: float, count: int, seed: int) -> list[dict[str, float]]:
    """Of each zone its share, what the error may be there, the gap p99 and the largest protrusion, millimetres."""
    owner, direction, _ = exposed_skin(leaves, PROBE_M, np.sqrt(target.solid.areas.sum() / count), seed)
    skin = leaves[owner, :3] + leaves[owner, 3:] * direction
    out, closest, _ = signed_distance(target.solid, skin)
    zone = target.regions.zone_of(closest)
    rows = []
    for k, patch in enumerate(target.patches):
        points, _ = sample_triangles(patch.corners, patch.areas, count, seed + k)
        gap = union_gap(leaves, points[target.regions.zone_of(points) == k + 1])
        rows.append(
            {
                "share": patch.share,
                "error_mm": 1e3 * patch.share * error_m,
                "gap_p99_mm": 1e3 * max(0.0, float(np.quantile(gap, 0.99))),
                "protrusion_max_mm": 1e3 * float(out[zone == k + 1].max(initial=0.0)),
            }
        )
    return rows
