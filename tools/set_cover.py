"""Covering samples with few balls out of many candidates: which covers which, and a greedy choice."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class Incidence:
    """Both directions of "candidate reaches sample": candidate k holds samples[start[k]:start[k+1]] with gap `gap`."""

    start: NDArray[np.int64]
    sample: Index
    gap: NDArray[np.float32]
    sample_start: NDArray[np.int64]
    candidate: Index
    samples: int

    def within(self, budget: float) -> Incidence:
        """Only the pairs whose gap is at most the budget."""
        keep = self.gap <= budget
        owner = np.repeat(np.arange(len(self.start) - 1, dtype=np.int32), np.diff(self.start))
        return _index(owner[keep], self.sample[keep], self.gap[keep], len(self.start) - 1, self.samples)

    def of(self, candidates: list[int]) -> Incidence:
        """Only these candidates, renumbered in the order given."""
        rows = np.array(candidates, dtype=np.int32)
        counts = self.start[rows + 1] - self.start[rows]
        owner = np.repeat(np.arange(len(rows), dtype=np.int32), counts)
        return _index(
            owner, _gather(self.start, self.sample, rows), _gather(self.start, self.gap, rows), len(rows), self.samples
        )


def find_incidence(balls: Array, points: Array, budget: float) -> Incidence:
    """Pairs with gap = |point - centre| - inside distance at most the budget. balls (n, 4), points (m, 3)."""
    found = cKDTree(points).query_ball_point(balls[:, :3], balls[:, 3] + budget)
    counts = np.array([len(part) for part in found], dtype=np.int64)
    sample = np.fromiter(chain.from_iterable(found), dtype=np.int32, count=int(counts.sum()))
    owner = np.repeat(np.arange(len(balls), dtype=np.int32), counts)
    gap = np.linalg.norm(points[sample] - balls[owner, :3], axis=1) - balls[owner, 3]
    return _index(owner, sample, gap.astype(np.float32), len(balls), len(points))


def cover_greedily(pairs: Incidence, chosen: list[int], spare: int, limit: int) -> list[int]:
    """Add the candidate that covers most uncovered samples, until at most `spare` are left or `limit` are chosen."""
    covered = np.zeros(pairs.samples, dtype=bool)
    for k in chosen:
        covered[pairs.sample[pairs.start[k] : pairs.start[k + 1]]] = True
    owner = np.repeat(np.arange(len(pairs.start) - 1), np.diff(pairs.start))
    gain = np.bincount(owner[~covered[pairs.sample]], minlength=len(pairs.start) - 1)
    left = int((~covered).sum())
    heap = [(-int(g), k) for k, g in enumerate(gain) if g > 0]
    heapq.heapify(heap)
    picked = list(chosen)
    while left > spare and heap and len(picked) < limit:
        old, k = heapq.heappop(heap)
        now = int(gain[k])
        if now != -old:
            if now > 0:
                heapq.heappush(heap, (-now, k))
            continue
        row = pairs.sample[pairs.start[k] : pairs.start[k + 1]]
        fresh = row[~covered[row]]
        covered[fresh] = True
        left -= len(fresh)
        picked.append(k)
        touched = _gather(pairs.sample_start, pairs.candidate, fresh)
        gain -= np.bincount(touched, minlength=len(gain))
    return picked


def _gather(start: NDArray[np.int64], values: NDArray[Any], rows: NDArray[np.integer]) -> NDArray[Any]:
    """The rows' values, one after the other."""
    first, counts = start[rows], start[rows + 1] - start[rows]
    ends = np.cumsum(counts)
    return values[np.repeat(first - (ends - counts), counts) + np.arange(counts.sum())]


def _index(owner: Index, sample: Index, gap: NDArray[np.float32], candidates: int, samples: int) -> Incidence:
    start = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=candidates))])
    order = np.argsort(sample, kind="stable")
    sample_start = np.concatenate([[0], np.cumsum(np.bincount(sample, minlength=samples))])
    return Incidence(start, sample, gap, sample_start, owner[order], samples)
