"""Covering samples with few balls: which candidate covers which sample, greedy choice, ruin and recreate."""

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


def ruin_and_recreate(
    pairs: Incidence, chosen: list[int], spare: int, target: int, rounds: int, seed: int
) -> list[int]:
    """Fewer candidates for the same cover: take some neighbours out, cover their samples again, keep what is no worse.

    Schrimpf et al. 2000. Stops at `target` or after `rounds`; at most `spare` samples stay uncovered, as in `chosen`.
    """
    rng = np.random.default_rng(seed)
    count = np.bincount(pairs.of(chosen).sample, minlength=pairs.samples)
    inside = np.zeros(len(pairs.start) - 1, dtype=bool)
    inside[chosen] = True
    scratch = _Scratch(np.zeros(pairs.samples, dtype=bool), np.zeros(len(inside), dtype=np.int32))
    now = list(chosen)
    place = {k: at for at, k in enumerate(now)}
    uncovered = int((count == 0).sum())
    spare = max(spare, uncovered)
    for _ in range(rounds):
        if len(now) <= target:
            break
        ruined = _neighbourhood(pairs, inside, now[rng.integers(len(now))], rng)
        removed = _gather(pairs.start, pairs.sample, ruined)
        np.subtract.at(count, removed, 1)
        bare = np.unique(removed[count[removed] == 0])
        fresh, left = _recreate(pairs, bare, spare - uncovered, len(ruined), scratch, rng)
        if fresh is None:
            np.add.at(count, removed, 1)
            continue
        np.add.at(count, _gather(pairs.start, pairs.sample, fresh), 1)
        inside[ruined] = False
        inside[fresh] = True
        for k in ruined.tolist():
            last = now.pop()
            if last != k:
                now[place[k]], place[last] = last, place[k]
        place.update(zip(fresh.tolist(), range(len(now), len(now) + len(fresh)), strict=True))
        now += fresh.tolist()
        uncovered += left
    return now


@dataclass(frozen=True)
class _Scratch:
    """Reused by every round: which samples are bare now, and where a candidate stands among those that touch them."""

    bare: NDArray[np.bool_]
    slot: Index


def _neighbourhood(pairs: Incidence, inside: NDArray[np.bool_], middle: int, rng: np.random.Generator) -> Index:
    """The chosen candidates that share most samples with `middle`, itself among them: 3 to 10 of them."""
    row = pairs.sample[pairs.start[middle] : pairs.start[middle + 1]]
    around = _gather(pairs.sample_start, pairs.candidate, row)
    around, shared = np.unique(around[inside[around]], return_counts=True)
    score = shared * rng.uniform(0.5, 1, len(shared))
    score[around == middle] = np.inf
    return around[np.argsort(-score, kind="stable")[: int(rng.integers(3, 11))]]


def _recreate(
    pairs: Incidence, bare: Index, spare: int, limit: int, scratch: _Scratch, rng: np.random.Generator
) -> tuple[Index | None, int]:
    """Cover the bare samples but `spare` of them with at most `limit` candidates, or None; and how many stay bare."""
    touched = _gather(pairs.sample_start, pairs.candidate, bare)
    gain = np.bincount(touched, minlength=len(scratch.slot))
    candidates = np.flatnonzero(gain)
    gain = gain[candidates]
    scratch.slot[candidates] = np.arange(len(candidates))
    # A different greedy order each time: gains are weighed by up to 15 %.
    taste = rng.uniform(0.85, 1, len(candidates))
    scratch.bare[bare] = True
    picked: list[int] = []
    left = len(bare)
    while left > spare and len(picked) < limit:
        k = int(candidates[np.argmax(gain * taste)])
        row = pairs.sample[pairs.start[k] : pairs.start[k + 1]]
        row = row[scratch.bare[row]]
        scratch.bare[row] = False
        left -= len(row)
        picked.append(k)
        if left > spare:
            touched = scratch.slot[_gather(pairs.sample_start, pairs.candidate, row)]
            gain = gain - np.bincount(touched, minlength=len(gain))
    scratch.bare[bare] = False
    return (np.array(picked, dtype=np.int32), left) if left <= spare else (None, left)
