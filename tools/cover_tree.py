"""Whether the balls over each level of a SphereTree are a tree that contains what stands below it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.model import Bounds, SphereTree


def check_tree(tree: SphereTree) -> dict[str, Any]:
    """What is wrong with the search trees of all levels, counted, in float64 and in the float32 of a search.

    levels: number; balls: over all of them; not_contained: balls and spheres that the ball above does not contain;
    not_contained_float32: the same with all numbers and sums in float32; farthest_out_mm: how far the worst of them
    reaches out (float64); without_parent: balls and spheres that no ball holds, one root a level apart; childless:
    balls with nothing below; most_children.
    """
    wrong = wrong32 = lost = childless = most = 0
    farthest = 0.0
    for spheres, bounds in zip(tree.levels, tree.bounds, strict=True):
        below, parent, roots = _below(spheres, bounds)
        known = (parent >= 0) & (parent < len(bounds.balls_m))
        lost += int((~known).sum()) + abs(roots - 1)
        counts = np.bincount(parent[known], minlength=len(bounds.balls_m))
        childless += int((counts == 0).sum())
        most = max(most, int(counts.max(initial=0)))
        above = bounds.balls_m[parent[known]]
        out = _reach(below[known], above)
        wrong += int((out > 0).sum())
        farthest = max(farthest, float(out.max(initial=0.0)))
        narrow = (array.astype(np.float32) for array in (below[known], above))
        wrong32 += int((_reach(*narrow) > 0).sum())
    return {
        "levels": len(tree.levels),
        "balls": sum(len(bounds.balls_m) for bounds in tree.bounds),
        "not_contained": wrong,
        "not_contained_float32": wrong32,
        "farthest_out_mm": farthest * 1e3,
        "without_parent": lost,
        "childless": childless,
        "most_children": most,
        "valid": wrong == wrong32 == lost == childless == 0,
    }


def _below(spheres: NDArray[np.float64], bounds: Bounds) -> tuple[NDArray[np.float64], NDArray[np.int64], int]:
    """All balls but roots and all spheres (k, 4), the row of the ball above each (k,), and the number of roots."""
    inner = bounds.parent != -1
    parent = np.concatenate([bounds.parent[inner], bounds.sphere_parent]).astype(np.int64)
    return np.concatenate([bounds.balls_m[inner], spheres]), parent, int((~inner).sum())


def _reach(children: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """How far each child reaches out of its parent; 0 or below: it does not."""
    offset = children[:, :3] - parents[:, :3]
    return np.sqrt((offset * offset).sum(axis=1)) + children[:, 3] - parents[:, 3]
