"""What of a surface hands came near over runs, and which of their parts came near at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.eval.gap import Flags, Mesh
from palmar.eval.judge import Shape, graphic_poses, mesh_gap, shape_in_object
from palmar.model import FINGERS, AssetPack
from palmar.pack_check import PARTS
from palmar.records import Run

Array = NDArray[np.float64]

BETWEEN_M = 4e-3  # between the balls that stand for a capsule
THINNED_M = 5e-4  # places of a ball in one cell of this size are one
RADII_M = 2.5e-4  # radii are rounded up to multiples of this
PART_BAND_M = 0.05
SLACK_M = THINNED_M * 3**0.5  # a place may stand for one so far away


@dataclass(frozen=True)
class Reach:
    reached: Flags  # (m,) points that some link comes within the guard of
    part_m: dict[str, float]  # least gap of each part of the hand to any point, metres; infinite beyond the guard


def find_reach(runs: Sequence[Run], pack: AssetPack, points: Array, guard_m: float) -> Reach:
    """What the exact graphic hand comes near in any of the runs: points (m, 3) in the object's frame, and its parts.

    No point within guard_m is missed, and none farther than guard_m + 1.5 mm counts.
    """
    places: dict[tuple[str, int], list[Array]] = {}
    low, high = points.min(axis=0), points.max(axis=0)
    for run in runs:
        shape = shape_in_object(pack.hand, graphic_poses(run), run)
        for part, radius, centres in _balls(shape):
            # What is farther from the box around the points reaches none.
            near = (np.maximum(low - centres, centres - high).max(axis=1)) <= radius + guard_m
            size = int(np.ceil(radius / RADII_M))
            places.setdefault((part, size), []).append(_thinned(centres[near]))
    reached = np.zeros(len(points), dtype=np.bool_)
    part_m = dict.fromkeys(PARTS, np.inf)
    for (part, size), found in places.items():
        centres = _thinned(np.concatenate(found))
        if len(centres):
            far = size * RADII_M + guard_m + SLACK_M
            away, _ = cKDTree(centres).query(points, distance_upper_bound=far)
            reached |= away < far
            gap = float(away.min()) - size * RADII_M - SLACK_M
            part_m[part] = min(part_m[part], max(gap, 0.0))
    return Reach(reached, part_m)


def _balls(shape: Shape) -> Iterator[tuple[str, float, Array]]:
    """Balls whose union holds the hand: part, radius, centres (n, 3) over the steps."""
    for k in range(15):
        c1, c2, r1, r2 = shape.c1[:, k], shape.c2[:, k], shape.r1[k], shape.r2[k]
        length = float(np.linalg.norm(c2[0] - c1[0])) if len(c1) else 0.0
        count = 2 + int(length / BETWEEN_M)
        half = length / (count - 1) / 2
        for s in np.linspace(0, 1, count):
            radius = r1 + s * (r2 - r1)
            # A point between two balls, up to the guard away from the capsule, is no farther from one of them.
            yield FINGERS[k // 3], float(np.hypot(radius + abs(r2 - r1) / count, half)), c1 + s * (c2 - c1)
    for p, radius in enumerate(shape.palm_radius):
        yield "palm", float(radius), shape.palm[:, p]


def _thinned(centres: Array) -> Array:
    """One of the centres (n, 3) in each cell, the first."""
    cells = np.floor(centres / THINNED_M).astype(np.int64)
    key = (cells[:, 0] * 2_000_003 + cells[:, 1]) * 2_000_003 + cells[:, 2]
    _, first = np.unique(key, return_index=True)
    return centres[np.sort(first)]


def part_gap(run: Run, pack: AssetPack, name: str, parts: Sequence[str]) -> Array:
    """(n,) metres: least gap of some parts of the graphic hand to the true mesh at each step, cut at PART_BAND_M."""
    tree = pack.objects[name]
    shape = shape_in_object(pack.hand, graphic_poses(run), run)
    phalanges, palm = mesh_gap(shape, Mesh(tree.vertices_m, tree.faces), PART_BAND_M, 1e-4)
    asked = np.repeat([finger in parts for finger in FINGERS], 3)
    columns = [phalanges[:, asked], *([palm] if "palm" in parts else [])]
    return np.hstack(columns).min(axis=1)
