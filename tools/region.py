"""Regions of a surface where spheres are to be closer to it: balls, from a CSV file or from what runs touched."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.errors import BadMesh, BadPack
from palmar.records import read_run
from palmar.seen import contact_points
from palmar.tools.solid import Solid

Array = NDArray[np.float64]

COLUMNS = ("x_mm", "y_mm", "z_mm", "radius_mm", "share")
LEAST_SHARE, MOST_SHARES = 0.05, 4
TOUCHED_SHARE = 0.5
_TOUCHED_MM = 5.0  # around a contact: half a fingertip
_THINNED_MM = 2.0  # contacts closer than that are one
_BORDER = 0.15  # of a region's radius: pieces of triangles along its border


@dataclass(frozen=True)
class Regions:
    """The surface in each ball may have that share of the error; where several lie over each other, the least."""

    balls_m: Array  # (k, 4): centre, radius, in the frame of the mesh
    share: Array  # (k,)

    @property
    def shares(self) -> list[float]:
        return sorted(set(self.share.tolist()))

    def zone_of(self, points: Array) -> NDArray[np.int64]:
        """Of points (n, 3) the place + 1 of their share in `shares`, 0 outside of all regions."""
        zone = np.zeros(len(points), dtype=np.int64)
        if len(self.share):
            tree = cKDTree(points)
            for k in reversed(range(len(self.shares))):
                own = self.balls_m[self.share == self.shares[k]]
                for near in tree.query_ball_point(own[:, :3], own[:, 3]):
                    zone[near] = k + 1
        return zone


NO_REGIONS = Regions(np.empty((0, 4)), np.empty(0))


def read_regions(
    files: Sequence[str | Path], touched: Sequence[str | Path], touched_share: float, more: Regions = NO_REGIONS
) -> Regions:
    """Regions of CSV files (one ball a row; columns x_mm, y_mm, z_mm, radius_mm, share), round contacts of runs, more.

    Raises BadPack, BadTrace.
    """
    parts = [*map(_read_csv, files), *(_touched(path, touched_share) for path in touched), (more.balls_m, more.share)]
    regions = Regions(*(np.concatenate([part[k] for part in parts]) for k in range(2)))
    if len(regions.shares) > MOST_SHARES:
        raise BadPack(
            "E-REGION",
            str((*files, *touched, "paint")[0]),
            f"{len(regions.shares)} different shares; up to {MOST_SHARES} are allowed",
        )
    return regions


def _read_csv(path: str | Path) -> tuple[Array, Array]:
    where = str(path)
    try:
        text = Path(path).read_bytes().decode("utf-8-sig", "replace")
    except OSError as error:
        raise BadPack("E-REGION", where, f"{error.strerror}; a CSV of regions is needed") from None
    rows = list(csv.reader(io.StringIO(text)))
    header = [name.strip().lower() for name in rows[0]] if rows else []
    if sorted(header) != sorted(COLUMNS):
        raise BadPack(
            "E-REGION", f"{where}:line 1", f"columns {','.join(header)[:60]!r}; {', '.join(COLUMNS)} are needed"
        )
    found = []
    for line, row in enumerate(rows[1:], 2):
        if row:
            found.append(_numbers(f"{where}:line {line}", dict(zip(header, row, strict=False))))
    if not found:
        raise BadPack("E-REGION", where, "no regions; at least one is needed")
    values = np.array(found)
    return values[:, :4] / 1e3, values[:, 4]


def _numbers(at: str, row: dict[str, str]) -> list[float]:
    values = []
    for name in COLUMNS:
        try:
            value = float(row.get(name, ""))
        except ValueError:
            value = math.nan
        low, high, needed = -1e6, 1e6, "a number"
        if name == "radius_mm":
            low, needed = 1e-6, "a number above 0"
        if name == "share":
            low, high, needed = LEAST_SHARE, 1.0, f"{LEAST_SHARE} to 1"
        if not low <= value <= high:
            raise BadPack("E-REGION", f"{at}, column {name}", f"{row.get(name, '')[:20]!r}; {needed} is needed")
        values.append(value)
    return values


def _touched(path: str | Path, share: float) -> tuple[Array, Array]:
    """Balls round the contacts of a run, in the object's frame."""
    _, points = contact_points(read_run(path))
    if not len(points):
        raise BadPack("E-REGION", str(path), "the run has no contact; one that touches the object is needed")
    _, first = np.unique(np.floor(points / (_THINNED_MM / 1e3)).astype(np.int64), axis=0, return_index=True)
    points = points[np.sort(first)]
    return np.column_stack([points, np.full(len(points), _TOUCHED_MM / 1e3)]), np.full(len(points), share)


def zone_triangles(solid: Solid, regions: Regions, share: float) -> tuple[Array, NDArray[np.int64]]:
    """Corners (t, 3, 3) and faces (t,) of all surface in the regions of this share, and a little more at its border.

    Raises BadMesh if there is none.
    """
    balls = regions.balls_m[regions.share == share]
    finest = _BORDER * balls[:, 3].min()
    corners, face = solid.vertices[solid.faces], np.arange(len(solid.faces))
    kept: list[tuple[Array, NDArray[np.int64]]] = []
    while len(face):
        middle = corners.mean(axis=1)
        extent = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        inside = _depth(balls, middle)
        corners, face, extent, inside = (values[inside >= -extent] for values in (corners, face, extent, inside))
        whole = (extent <= finest) | (inside >= extent)
        kept.append((corners[whole], face[whole]))
        a, b, c = (corners[~whole, k] for k in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
        face = np.tile(face[~whole], 4)
    corners, face = (np.concatenate([part[k] for part in kept]) for k in range(2))
    if not len(face) or not (regions.zone_of(corners.mean(axis=1)) > 0).any():
        at = ", ".join(f"{value * 1e3:.4g}" for value in balls[0, :3])
        raise BadMesh(
            "E-REGION", "region", f"no surface lies in the regions of share {share:g}; the first is at {at} mm"
        )
    return corners, face


def _depth(balls: Array, points: Array) -> Array:
    """How deep each point (n, 3) lies in the ball (k, 4) that holds it best; below 0 outside."""
    depth = np.full(len(points), -np.inf)
    for radius in np.unique(balls[:, 3]):
        away, _ = cKDTree(balls[balls[:, 3] == radius, :3]).query(points)
        depth = np.maximum(depth, radius - away)
    return depth
