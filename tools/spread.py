"""Spheres spread evenly under a surface: levels of any count in seconds, where `build` searches for the best ones.

Each sphere is the largest ball inside that touches the surface at one of so many evenly spread points; all of a level
are then grown by one length that shares the error evenly between what sticks out and what is left bare. They are worse
than built ones of the same count, and all a comparison of solvers over levels needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.model import SphereTree
from palmar.tools.cover import union_gap
from palmar.tools.hierarchy import in_tree_order
from palmar.tools.lattice import leaf_errors
from palmar.tools.medial import medial_balls
from palmar.tools.solid import make_solid, sample_surface

Array = NDArray[np.float64]

_SAMPLES = 20_000  # of the surface, for the error that the spheres share
_SLACK_M = 1e-5  # facets shallower than this stop no ball


def spread_levels(
    vertices_m: Array, faces: NDArray[np.integer], counts: Sequence[int], about: dict[str, Any], seed: int = 0
) -> SphereTree:
    """A SphereTree with one level for each of the ascending counts, over a closed mesh (v, 3) metres, (f, 3) outward.

    about: what is known of the mesh; the levels and their errors are added. Same input and seed, same bytes. Raises
    BadMesh.
    """
    solid = make_solid(vertices_m, faces)
    samples, _ = sample_surface(solid, _SAMPLES, seed)
    levels, bounds, errors = [], [], []
    for count in counts:
        points, face = sample_surface(solid, count, seed + 1)
        balls = medial_balls(solid, points, face, _SLACK_M)
        balls = np.column_stack(
            [balls[:, :3], balls[:, 3] + 0.5 * max(np.quantile(union_gap(balls, samples), 0.99), 0)]
        )
        level, over = in_tree_order(balls)
        levels.append(level)
        bounds.append(over)
        errors.append(leaf_errors(level, vertices_m, faces))
    told = {**about, "method": "spread evenly", "parameters": {"counts": [*counts], "seed": seed}, "levels": errors}
    return SphereTree(levels, bounds, vertices_m, np.asarray(faces, dtype=np.int32), told)
