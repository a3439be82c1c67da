"""Triangles seen along one direction: which of them lie under each pixel, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Hits:
    """One row for each pair of a pixel and a triangle over its middle: column, row, face and shares of its corners."""

    column: Ints  # (n,)
    row: Ints  # (n,)
    face: Ints  # (n,)
    share: Array  # (n, 3)

    def taken(self, which: Ints | NDArray[np.bool_]) -> Hits:
        return Hits(self.column[which], self.row[which], self.face[which], self.share[which])

    def of(self, corners: Array) -> Array:
        """Values (n, k) of what faces (f, 3, k) have at their corners."""
        return np.einsum("nc,nck->nk", self.share, corners[self.face])


def find_hits(corners: Array) -> Hits:
    """Every pixel whose middle lies under a triangle. corners (f, 3, 2) in pixels; pixel k reaches from k to k + 1.

    Triangles seen from behind, or edge on, have none. A middle on the edge of two triangles belongs to one of them.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    double = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    front = np.flatnonzero(double > 1e-12)
    corners, double = corners[front], double[front]
    # Rows whose middle y + 0.5 lies in [low, high).
    first = np.ceil(corners[:, :, 1].min(axis=1) - 0.5).astype(np.int64)
    count = np.maximum(np.ceil(corners[:, :, 1].max(axis=1) - 0.5).astype(np.int64) - first, 0)
    owner = np.repeat(np.arange(len(front)), count)
    row = first[owner] + _counted(count)
    y = row + 0.5
    left, right = np.full(len(owner), np.inf), np.full(len(owner), -np.inf)
    for k in range(3):
        p, q = corners[owner, k], corners[owner, (k + 1) % 3]
        crossed = (p[:, 1] <= y) != (q[:, 1] <= y)
        # From the lower end, whichever triangle asks: neighbours then agree to the last bit.
        low, high = np.where((p[:, 1] <= q[:, 1])[:, None], p, q), np.where((p[:, 1] <= q[:, 1])[:, None], q, p)
        part = (y - low[:, 1]) / np.where(crossed, high[:, 1] - low[:, 1], 1)
        x = low[:, 0] + part * (high[:, 0] - low[:, 0])
        left = np.where(crossed, np.minimum(left, x), left)
        right = np.where(crossed, np.maximum(right, x), right)
    start = np.where(left <= right, np.ceil(left - 0.5), 0).astype(np.int64)
    width = np.where(left <= right, np.ceil(right - 0.5) - start, 0).astype(np.int64)
    span = np.repeat(np.arange(len(owner)), np.maximum(width, 0))
    column, row, owner = start[span] + _counted(np.maximum(width, 0)), row[span], owner[span]
    at = np.column_stack([column, row]) + 0.5
    a, b, c = (corners[owner, k] for k in range(3))
    share_b = _cross(at - a, c - a) / double[owner]
    share_c = _cross(b - a, at - a) / double[owner]
    share = np.clip(np.column_stack([1 - share_b - share_c, share_b, share_c]), 0, 1)
    return Hits(column, row, front[owner], share / share.sum(axis=1, keepdims=True))


def ranks(hits: Hits, height: Array) -> Ints:
    """For each hit how many of its pixel's hits lie higher (n,)."""
    order = np.lexsort((hits.face, -height, hits.column, hits.row))
    row, column = hits.row[order], hits.column[order]
    fresh = np.ones(len(order), dtype=bool)
    fresh[1:] = (row[1:] != row[:-1]) | (column[1:] != column[:-1])
    place = np.arange(len(order))
    start = np.maximum.accumulate(np.where(fresh, place, 0))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = place - start
    return rank


def _counted(counts: Ints) -> Ints:
    """0, 1, ..., count - 1 for each count, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _cross(u: Array, v: Array) -> Array:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
