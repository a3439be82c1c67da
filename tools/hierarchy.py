"""Balls over the spheres of a level, for search: each contains what stands below it, in float64 and in float32."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar._runtime import bound_tree
from palmar.model import Bounds

Array = NDArray[np.float64]

# What a tree is mostly asked about: a fingertip.
_REACH_M = 0.007


def bounds_over(spheres: Array) -> Bounds:
    """Bounds over spheres (n, 4) in metres, which keep their order."""
    order, bounds = _bounds(spheres)
    parent = np.empty_like(bounds.sphere_parent)
    parent[order] = bounds.sphere_parent
    return Bounds(bounds.balls_m, bounds.parent, parent)


def in_tree_order(spheres: Array) -> tuple[Array, Bounds]:
    """The spheres (n, 4) in metres, branch by branch, so that those in a row are neighbours, and bounds over them."""
    order, bounds = _bounds(spheres)
    return spheres[order], bounds


def search(
    spheres: Array, bounds: Bounds, centres: Array, radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Spheres that balls of this radius at centres (q, 3) meet, in float32 as a solver would search.

    Returns query (k,), sphere (k,), and visits (q,): how many balls and spheres each query was held against, the root
    among them; the children of a ball that it does not meet are not visited.
    """
    place, reach = centres.astype(np.float32), np.float32(radius)
    balls, leaves = bounds.balls_m.astype(np.float32), spheres.astype(np.float32)
    number = np.arange(len(balls) + 1)
    inner = np.searchsorted(bounds.parent, number)  # siblings stand side by side; the root's -1 comes first
    order = np.argsort(bounds.sphere_parent, kind="stable")
    outer = np.searchsorted(bounds.sphere_parent[order], number)
    query, ball = np.arange(len(place)), np.zeros(len(place), dtype=np.int64)
    visits = np.ones(len(place), dtype=np.int64)
    found: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    while len(query):
        query, ball = _met(query, ball, place, balls, reach)
        whom, slot = _below(query, ball, outer)
        query, ball = _below(query, ball, inner)
        visits += np.bincount(whom, minlength=len(place)) + np.bincount(query, minlength=len(place))
        found.append(_met(whom, order[slot], place, leaves, reach))
    return np.concatenate([of for of, _ in found]), np.concatenate([which for _, which in found]), visits


def _met(
    query: NDArray[np.int64],
    ball: NDArray[np.int64],
    place: NDArray[np.float32],
    balls: NDArray[np.float32],
    reach: Any,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    met = np.linalg.norm(place[query] - balls[ball, :3], axis=1) <= balls[ball, 3] + reach
    return query[met], ball[met]


def _below(
    query: NDArray[np.int64], ball: NDArray[np.int64], start: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each query with each child start[ball] .. start[ball + 1] - 1 of its ball."""
    counts = start[ball + 1] - start[ball]
    ends = np.cumsum(counts)
    child = np.repeat(start[ball] - (ends - counts), counts) + np.arange(counts.sum())
    return np.repeat(query, counts), child


def _bounds(spheres: Array) -> tuple[NDArray[np.int32], Bounds]:
    assert len(spheres), "a tree needs a sphere"
    order, sphere_parent, balls, parent = bound_tree(np.ascontiguousarray(spheres, dtype=np.float64), _REACH_M)
    return order, Bounds(balls, parent, sphere_parent)
