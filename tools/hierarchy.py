"""Levels of spheres above given leaves. A parent contains its children, in float64 and after rounding to float32."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CHILDREN = 8
# Rounding to float32 and sums in float32 move a sphere by at most a few 2^-24 of its place and size.
_ROUNDING = 8 * 2.0**-24


def levels_over(leaves: Array) -> tuple[list[Array], list[NDArray[np.int32]]]:
    """Levels (n_k, 4), root first, over leaves (n, 4), which keep their order; parents (n_k,), -1 on level 0.

    A parent has at most 8 children and is the smallest ball around them to 1 %.
    """
    leaves = np.ascontiguousarray(leaves, dtype=np.float64)
    assert len(leaves), "a tree needs a leaf"
    height = 0
    while CHILDREN**height < len(leaves):
        height += 1
    # groups[k] lists, for each node of level k, its leaves.
    groups = [[np.arange(len(leaves))]]
    parents: list[NDArray[np.int32]] = []
    for left in range(height, 1, -1):
        split = [_split(leaves, group, _branches(len(group), left)) for group in groups[-1]]
        parents.append(np.repeat(np.arange(len(split)), [len(parts) for parts in split]).astype(np.int32))
        groups.append([part for parts in split for part in parts])
    levels = [leaves]
    if height:
        leaf_parent = np.empty(len(leaves), dtype=np.int32)
        for k, group in enumerate(groups[-1]):
            leaf_parent[group] = k
        parents.append(leaf_parent)
    for parent in reversed(parents):
        levels.insert(0, _bounding_spheres(levels[0], parent))
    return levels, [np.full(1, -1, dtype=np.int32), *parents]


def _branches(count: int, height: int) -> int:
    """Children of a node with so many leaves so many levels down: an even tree with at most 8 at each node."""
    return max(-(-count // CHILDREN ** (height - 1)), min(CHILDREN, round(count ** (1 / height))), 1)


def _split(leaves: Array, group: NDArray[np.int64], parts: int) -> list[NDArray[np.int64]]:
    """Cut a group across the direction in which its centres spread most, until there are `parts` even groups."""
    if parts <= 1 or len(group) <= 1:
        return [group]
    centres = leaves[group, :3]
    offset = centres - centres.mean(axis=0)
    axis = np.linalg.eigh(offset.T @ offset)[1][:, -1]
    # An axis has no sign of its own; this one makes the order repeatable.
    axis *= np.sign(axis[np.argmax(np.abs(axis))])
    order = group[np.argsort(offset @ axis, kind="stable")]
    low = parts // 2
    cut = round(len(group) * low / parts)
    return _split(leaves, order[:cut], low) + _split(leaves, order[cut:], parts - low)


def _bounding_spheres(children: Array, parent: NDArray[np.int32]) -> Array:
    """The smallest ball around each parent's child balls, to 1 %, rounded outwards."""
    count = int(parent.max()) + 1
    order = np.argsort(parent, kind="stable")
    sizes = np.bincount(parent, minlength=count)
    starts = np.cumsum(sizes) - sizes
    column = np.minimum(np.arange(sizes.max())[None, :], sizes[:, None] - 1)  # the last child fills the row
    balls = children[order[starts[:, None] + column]]
    centres, radii = balls[..., :3], balls[..., 3]

    # Badoiu and Clarkson 2003, with balls for points: step 1/k towards the farthest.
    middle = centres.mean(axis=1)
    best, best_radius = middle.copy(), np.full(count, np.inf)
    rows = np.arange(count)
    for k in range(1, 200):
        offset = centres - middle[:, None]
        away = np.linalg.norm(offset, axis=2)
        reach = away + radii
        far = np.argmax(reach, axis=1)
        radius = reach[rows, far]
        better = radius < best_radius
        best[better], best_radius[better] = middle[better], radius[better]
        # From the far end of the farthest ball, not from its centre.
        stretch = radius / np.maximum(away[rows, far], 1e-300)
        middle = middle + offset[rows, far] * (stretch / (k + 1))[:, None] * (away[rows, far] > 0)[:, None]

    best = best.astype(np.float32).astype(np.float64)
    reach = (np.linalg.norm(centres - best[:, None], axis=2) + radii).max(axis=1)
    reach += _ROUNDING * (reach + np.abs(best).max(axis=1) * 2)
    return np.column_stack([best, np.nextafter(reach.astype(np.float32), np.float32(np.inf)).astype(np.float64)])
