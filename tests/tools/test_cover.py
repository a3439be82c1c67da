import numpy as np
import pytest

from palmar.errors import BadMesh
from palmar.tools.cover import exposed_skin, level_errors, union_gap
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import make_solid, sample_surface, signed_distance


def random_spheres(count, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(size=(count, 3)) * 0.02, rng.uniform(0.002, 0.01, count)])


def test_ball_larger_than_a_sphere_by_1_mm_protrudes_by_1_mm():
    vertices, faces = SHAPES["sphere"]()
    (row,) = level_errors([np.array([[0, 0, 0, 0.041]])], vertices, faces)
    # Vertices lie on the sphere, the middle of the largest facet deepest inside; 1e-9 mm of rounding.
    deepest = -signed_distance(make_solid(vertices, faces), np.zeros((1, 3)))[0][0] * 1e3
    assert 1.0 <= row["protrusion_mm"]["max"] <= 41 - deepest + 1e-9
    assert 1.0 <= row["protrusion_mm"]["mean"] <= row["protrusion_mm"]["p99"] <= row["protrusion_mm"]["max"]
    assert row["gap_mm"] == {"max": 0, "p99": 0, "mean": 0}
    assert row["spheres"] == 1


def test_protrusion_of_a_ball_just_inside_plus_an_offset_is_the_offset():
    vertices, faces = SHAPES["sphere"]()
    inside = -signed_distance(make_solid(vertices, faces), np.zeros((1, 3)))[0][0]
    (row,) = level_errors([np.array([[0, 0, 0, inside + 5e-4]])], vertices, faces)
    # 1e-3 mm: the samples do not hit the touching point itself.
    assert row["protrusion_mm"]["max"] == pytest.approx(0.5, abs=1e-3)


def test_gap_of_the_inscribed_ball_of_a_cube_is_that_of_its_corners():
    (row,) = level_errors([np.array([[0, 0, 0, 0.035]])], *SHAPES["cube"]())
    assert row["protrusion_mm"]["max"] == 0
    # At (x, y) of a face the gap is sqrt(35^2 + x^2 + y^2) - 35.
    side = np.linspace(-35, 35, 1401)
    gap = np.sqrt(35**2 + side[:, None] ** 2 + side**2) - 35
    assert row["gap_mm"]["mean"] == pytest.approx(gap.mean(), rel=5e-3)
    assert row["gap_mm"]["p99"] == pytest.approx(np.quantile(gap, 0.99), rel=5e-3)
    assert gap.max() - 0.5 < row["gap_mm"]["max"] <= gap.max()  # mm; samples stop short of the corner itself


def test_skin_inside_the_mesh_is_reached_only_from_outside():
    # A ball in the cube's middle: its skin lies in the dark of the mesh, but nothing hides it.
    (row,) = level_errors([np.array([[0, 0, 0, 0.02]])], *SHAPES["cube"]())
    assert row["protrusion_mm"] == {"max": 0, "p99": 0, "mean": 0}
    assert row["gap_mm"]["mean"] > 15


def test_exact_sphere_has_no_normal_error_but_its_facets():
    (row,) = level_errors([np.array([[0, 0, 0, 0.04]])], *SHAPES["sphere"]())
    assert row["normal_error_deg"]["p95"] < 2 * 360 / 192  # two facets


def test_union_gap_is_the_least_over_all_spheres():
    spheres, points = random_spheres(300, 0), np.random.default_rng(1).normal(size=(5000, 3)) * 0.04
    every = (np.linalg.norm(points[:, None] - spheres[None, :, :3], axis=2) - spheres[:, 3]).min(axis=1)
    found = union_gap(spheres, points)
    np.testing.assert_allclose(np.maximum(found, 0), np.maximum(every, 0), atol=1e-15)  # metres; rounding
    assert ((found > 0) == (every > 0)).all()


def test_skin_of_two_balls_has_the_area_of_two_caps():
    # Equal balls of radius r at distance d: each loses a cap of height r - d / 2.
    radius, apart = 0.02, 0.015
    spheres = np.array([[0, 0, 0, radius], [apart, 0, 0, radius]])
    owner, direction, angle = exposed_skin(spheres, 0.0, 2e-4, 0)
    expected = 2 * (4 * np.pi * radius**2 - 2 * np.pi * radius * (radius - apart / 2))
    assert (angle * radius**2).sum() == pytest.approx(expected, rel=2e-3)  # patches at the seam
    points = spheres[owner, :3] + radius * direction
    other = spheres[1 - owner, :3]
    assert np.linalg.norm(points - other, axis=1).min() >= radius * (1 - 1e-8)


def test_skin_in_a_seam_is_out_of_a_probes_reach():
    spheres = np.array([[0, 0, 0, 0.02], [0.03, 0, 0, 0.02]])
    owner, direction, _ = exposed_skin(spheres, 0.002, 2e-4, 0)
    probe = spheres[owner, :3] + 0.022 * direction
    assert np.linalg.norm(probe - spheres[1 - owner, :3], axis=1).min() >= 0.022 * (1 - 1e-8)


@pytest.mark.parametrize("offset", [0.0, 0.002])
def test_skin_is_all_that_no_other_sphere_hides(offset):
    # More spheres around each than are looked at for what hides a patch whole, small ones in large ones, two equal.
    spheres = random_spheres(200, 5)
    spheres[::7, 3] *= 0.1
    spheres[1] = spheres[0]
    owner, direction, angle = exposed_skin(spheres, offset, 1e-3, 0)
    reach = spheres[:, 3] + offset

    def hidden(points, of):
        squared = ((points[:, None] - spheres[None, :, :3]) ** 2).sum(axis=2)
        least = np.maximum(reach - 1e-9 * reach.max(), 0) ** 2
        squared[np.arange(len(points)), of] = np.inf
        return (squared < least).any(axis=1)

    assert not hidden(spheres[owner, :3] + reach[owner, None] * direction, owner).any()
    # The area of each sphere's own skin, by 500 random directions.
    way = np.random.default_rng(1).normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    bare = [1 - hidden(spheres[k, :3] + reach[k] * way, np.full(500, k)).mean() for k in range(len(spheres))]
    area = 4 * np.pi * reach**2
    found = np.bincount(owner, angle, minlength=len(spheres)) * reach**2
    # Both are samples, of 500 directions and one in each square of 1.4 mm: 3 standard deviations of the difference.
    spread = area**2 * np.multiply(bare, 1 - np.array(bare)) * (1 / 500 + 1 / np.maximum(area / 2e-6, 6))
    assert abs(found.sum() - (area * bare).sum()) < 3 * np.sqrt(spread.sum())


def test_samples_are_even_by_area():
    # Two faces of a stretched box hold their share of the samples to within a few.
    vertices, faces = SHAPES["cube"]()
    solid = make_solid(vertices * [1, 1, 2], faces)
    points, face = sample_surface(solid, 10_000, 3)
    expected = 10_000 * solid.areas / solid.areas.sum()
    assert np.abs(np.bincount(face, minlength=len(faces)) - expected).max() <= 1
    distance, _, _ = signed_distance(solid, points)
    assert np.abs(distance).max() < 1e-15


def test_sign_is_that_of_the_winding_number_beside_edges_too():
    import igl

    solid = make_solid(*SHAPES["shamrock"]())
    rng = np.random.default_rng(0)
    points = sample_surface(solid, 4000, 0)[0] + rng.normal(size=(4000, 3)) * 3e-4
    inside = igl.fast_winding_number(solid.vertices, solid.faces, points) > 0.5
    assert ((signed_distance(solid, points)[0] < 0) == inside).all()


def test_errors_repeat_for_a_seed():
    levels = [random_spheres(40, 2)]
    mesh = SHAPES["cube"]()
    assert level_errors(levels, *mesh, seed=5) == level_errors(levels, *mesh, seed=5)


def test_mesh_inside_out_is_refused():
    vertices, faces = SHAPES["cube"]()
    with pytest.raises(BadMesh, match="wind outwards"):
        level_errors([np.array([[0, 0, 0, 0.03]])], vertices, faces[:, ::-1])
