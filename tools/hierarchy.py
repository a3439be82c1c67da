"""Balls over the spheres of a level, for search: each contains what stands below it, in float64 and in float32."""

from __future__ import annotations

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


def _bounds(spheres: Array) -> tuple[NDArray[np.int32], Bounds]:
    assert len(spheres), "a tree needs a sphere"
    order, sphere_parent, balls, parent = bound_tree(np.ascontiguousarray(spheres, dtype=np.float64), _REACH_M)
    return order, Bounds(balls, parent, sphere_parent)
