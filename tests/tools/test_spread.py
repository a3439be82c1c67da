"""Spheres spread under a surface: so many as asked for, the error shared as stated."""

import numpy as np

from palmar.tools.cover import union_gap
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import make_solid, sample_surface, signed_distance
from palmar.tools.spread import spread_levels


def test_each_level_has_its_count_and_sticks_out_by_no_more_than_it_leaves_bare():
    vertices, faces = SHAPES["rock"]()
    tree = spread_levels(vertices, faces, [100, 800], {"source": "shape:rock"})
    assert [len(level) for level in tree.levels] == [100, 800]
    solid = make_solid(vertices, faces)
    points, _ = sample_surface(solid, 5000, 9)
    gaps = []
    for level in tree.levels:
        out = signed_distance(solid, level[:, :3])[0] + level[:, 3]
        bare = np.quantile(np.maximum(union_gap(level, points), 0), 0.99)
        # Shared evenly: what sticks out is half of what the balls inside left bare, to the other samples' noise.
        assert np.ptp(out) < 1e-9 and 0.7 < bare / out.max() < 1.4
        gaps.append(bare)
    assert gaps[1] < 0.4 * gaps[0]  # a smooth surface would have an eighth; a rock has edges


def test_the_same_seed_gives_the_same_spheres():
    vertices, faces = SHAPES["cube"]()
    a, b = (spread_levels(vertices, faces, [60], {}) for _ in range(2))
    assert np.array_equal(a.leaves, b.leaves)
