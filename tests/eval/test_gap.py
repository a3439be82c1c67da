"""Exact gaps against other ways to the same number."""

import numpy as np
import pytest
import trimesh

from palmar.eval.gap import Mesh, capsule_mesh_gap, capsule_point_gap, signed_distance


def gap_by_supporting_planes(c1, r1, c2, r2, point):
    """Signed distance to the hull of two balls: the largest, over directions n, of n.point - max n.x over the hull.

    The best direction lies in the plane of axis and point; 200,000 of them are tried, twice.
    """
    u = (c2 - c1) / np.linalg.norm(c2 - c1)
    across = point - c1 - (point - c1) @ u * u
    v = across / np.linalg.norm(across)
    p = np.array([(point - c1) @ u, (point - c1) @ v])
    length = np.linalg.norm(c2 - c1)

    def best(angles):
        n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        values = n @ p - np.maximum(r1, length * n[:, 0] + r2)
        return values.max(), angles[np.argmax(values)]

    _, at = best(np.linspace(-np.pi, np.pi, 200_001))
    return best(np.linspace(at - 1e-4, at + 1e-4, 20_001))[0]


def test_capsule_gap_is_the_distance_to_the_hull_of_two_balls_inside_and_out():
    rng = np.random.default_rng(1)
    for _ in range(40):
        c1, c2 = rng.normal(size=(2, 3)) * 0.02
        r1, r2 = rng.uniform(0.3, 1, 2) * 0.4 * np.linalg.norm(c2 - c1)
        point = c1 + rng.normal(size=3) * 0.03
        gap = capsule_point_gap(c1, r1, c2, r2, point)
        # metres; the finer fan steps by 1e-8 rad, the hull reaches some 0.1 m
        assert gap == pytest.approx(gap_by_supporting_planes(c1, r1, c2, r2, point), abs=1e-9)


def test_capsule_of_no_length_and_capsule_in_a_ball_are_balls():
    point = np.array([0.03, 0.0, 0.04])
    zero, near = np.zeros(3), np.array([0.0, 0.0, 0.001])
    assert capsule_point_gap(zero, 0.01, zero, 0.01, point) == pytest.approx(0.04, abs=1e-15)
    assert capsule_point_gap(zero, 0.01, near, 0.002, point) == pytest.approx(0.04, abs=1e-15)
    assert capsule_point_gap(near, 0.002, zero, 0.01, point) == pytest.approx(0.04, abs=1e-15)


def test_signed_distance_of_a_box_is_known():
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    points = np.array([[0.03, 0, 0], [0.0, 0.015, 0], [0.023, 0.024, 0.0]])
    assert signed_distance(box.vertices, box.faces, points) == pytest.approx([0.01, -0.005, 0.005], abs=1e-15)


@pytest.fixture(scope="module")
def knot():
    """A closed mesh with edges, hollows and thin parts."""
    torus = trimesh.creation.torus(0.03, 0.012, major_sections=24, minor_sections=12)
    torus.vertices *= 1 + 0.15 * np.sin(300 * torus.vertices[:, :1] + 200 * torus.vertices[:, 1:2])
    return Mesh(torus.vertices, torus.faces)


@pytest.mark.parametrize("band", [np.inf, 0.0])
def test_capsule_mesh_gap_is_the_least_of_ball_gaps_along_the_axis(knot, band):
    rng = np.random.default_rng(2)
    k, tolerance = 150, 1e-7
    c1 = rng.normal(size=(k, 3)) * 0.03
    c2 = c1 + rng.normal(size=(k, 3)) * 0.02
    r1, r2 = rng.uniform(0.001, 0.01, (2, k))
    found, bound = capsule_mesh_gap(knot, c1, r1, c2, r2, band, tolerance)

    along = np.linspace(0, 1, 1001)[None, :, None]
    centres = (1 - along) * c1[:, None] + along * c2[:, None]
    radii = (1 - along[..., 0]) * r1[:, None] + along[..., 0] * r2[:, None]
    sampled = (knot.closest(centres.reshape(-1, 3))[0].reshape(k, -1) - radii).min(axis=1)
    # A ball gap changes along the axis by at most the way plus the change of radius.
    between = (np.linalg.norm(c2 - c1, axis=1) + np.abs(r2 - r1)) / 2000
    assert (bound <= sampled).all()
    near = sampled < band
    assert near.any() and (found[near] - tolerance <= bound[near]).all()
    assert (found[near] <= sampled[near] + tolerance).all() and (found >= sampled - between).all()
    assert (bound[~near] >= band - between[~near]).all()


def test_capsule_pressed_into_a_face_is_exactly_that_deep():
    box = trimesh.creation.box((0.2, 0.2, 0.02))
    mesh = Mesh(box.vertices, box.faces)
    # Axis parallel to the face, 6 mm above it with radius 8 mm; then tapered, the thick end deepest.
    ends = np.array([[-0.02, 0.001, 0.016]]), np.array([[0.02, 0.002, 0.016]])
    for r1, r2, depth in ((0.008, 0.008, 0.002), (0.009, 0.007, 0.003)):
        found, bound = capsule_mesh_gap(mesh, ends[0], np.array([r1]), ends[1], np.array([r2]), 0.0, 2e-7)
        assert found[0] == pytest.approx(-depth, abs=1e-15)
        assert bound[0] >= -depth - 2e-7  # metres, the tolerance asked for
