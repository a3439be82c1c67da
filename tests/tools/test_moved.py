import numpy as np
import pytest
import trimesh

from palmar.tools.moved import distance_between


def none(points, normals):
    return np.zeros(len(points), dtype=bool)


def both_ways(first, second, drop=none):
    a, b = (first.vertices, first.faces), (second.vertices, second.faces)
    return distance_between(*a, *b, 0, drop), distance_between(*b, *a, 0, none)


def test_a_box_in_a_larger_box():
    small, large = trimesh.creation.box((0.02, 0.02, 0.02)), trimesh.creation.box((0.024, 0.024, 0.024))
    out, back = both_ways(small, large)
    # Every point of the small one is 2 mm below; the corners of the large one are sqrt(3) times as far.
    assert out["max"] == pytest.approx(2.0) and out["p99"] == pytest.approx(2.0) and out["mean"] == pytest.approx(2.0)
    assert back["max"] <= 2 * np.sqrt(3) <= back["at_most"] <= 1.02 * 2 * np.sqrt(3)
    assert np.abs(np.abs(back["at_mm"]) - 12).max() < 0.2


def test_a_needle_between_samples_is_found():
    # Samples by area hardly see a cone of 0.01 mm; its height is the distance.
    block = trimesh.creation.box((0.05, 0.05, 0.05))
    needle = trimesh.creation.cone(5e-6, 0.01, sections=8)
    needle.apply_translation((0.01, 0.012, 0.025))
    both = trimesh.util.concatenate([block, needle])
    out, back = both_ways(both, block)
    assert out["max"] <= 10.0 <= out["at_most"] <= 10.2
    np.testing.assert_allclose(out["at_mm"], [10, 12, 35], atol=0.2)  # mm; 1 % of the height
    assert out["p99"] < 1e-6 and back["max"] < 1e-6


def test_the_same_surface_in_other_triangles_has_not_moved():
    block = trimesh.creation.box((0.05, 0.05, 0.05))
    finer = block.subdivide().subdivide()
    for moved in both_ways(block, finer):
        assert moved["max"] < 1e-9 and moved["at_most"] < 0.02  # mm; 2e-4 of the size


def test_what_does_not_count_is_left_out():
    block, inner = trimesh.creation.box((0.05, 0.05, 0.05)), trimesh.creation.icosphere(3, 0.01)
    both = trimesh.util.concatenate([block, inner])

    def inside(points, normals):
        return np.abs(points).max(axis=1) < 0.024

    assert both_ways(both, block)[0]["max"] == pytest.approx(25.0, abs=10)  # the ball counts
    out, _ = both_ways(both, block, inside)
    assert out["max"] < 1e-9 and out["at_most"] < 0.02
    nothing = distance_between(inner.vertices, inner.faces, block.vertices, block.faces, 0, inside)
    assert (nothing["max"], nothing["at_mm"]) == (0.0, None)
