"""Whether the levels of a SphereTree are a tree whose parents contain their children."""

from __future__ import annotations

from typing import Any

import numpy as np

from palmar.model import SphereTree


def check_tree(tree: SphereTree) -> dict[str, Any]:
    """What is wrong with a tree, counted, in the precision of the pack (float64) and in that of a search (float32).

    levels: number; nodes; not_contained: spheres that their parent does not contain; not_contained_float32: the same
    with all numbers and sums in float32; farthest_out_mm: how far the worst of them reaches out (float64);
    without_parent: spheres whose parent is no sphere of the level above; childless: spheres above the leaves without a
    child; most_children.
    """
    wrong = wrong32 = lost = childless = most = 0
    farthest = 0.0
    for k in range(1, len(tree.levels)):
        above, below, parent = tree.levels[k - 1], tree.levels[k], tree.parents[k]
        known = (parent >= 0) & (parent < len(above))
        lost += int((~known).sum())
        counts = np.bincount(parent[known], minlength=len(above))
        childless += int((counts == 0).sum())
        most = max(most, int(counts.max(initial=0)))
        out = _reach(below[known], above[parent[known]])
        wrong += int((out > 0).sum())
        farthest = max(farthest, float(out.max(initial=0.0)))
        narrow = (array.astype(np.float32) for array in (below[known], above[parent[known]]))
        wrong32 += int((_reach(*narrow) > 0).sum())
    return {
        "levels": len(tree.levels),
        "nodes": sum(len(level) for level in tree.levels),
        "not_contained": wrong,
        "not_contained_float32": wrong32,
        "farthest_out_mm": farthest * 1e3,
        "without_parent": lost + int((tree.parents[0] != -1).sum()),
        "childless": childless,
        "most_children": most,
        "valid": wrong == wrong32 == lost == childless == 0,
    }


def _reach(children: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """How far each child reaches out of its parent; 0 or below: it does not."""
    offset = children[:, :3] - parents[:, :3]
    return np.sqrt((offset * offset).sum(axis=1)) + children[:, 3] - parents[:, 3]
