"""What each mode promises, measured by other code than the builder's: see independent.py and mesh_figures.py."""

import numpy as np
import pytest
from independent import distance_to_triangles, solid_angle_winding
from mesh_figures import DATA, get_mesh, measure, plate_of_1_mm, row, two_bodies

from palmar.tools.mesh import Mesh
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import closest_points, is_inside, make_solid
from palmar.tools.sphere_tree import MODES, build_levels

MADE = {
    "plate of 1 mm": (plate_of_1_mm, 4e-3),
    "two bodies, 40 and 2 mm": (two_bodies, 5e-4),
    "hexagonal prism": (SHAPES["hexagonal_prism"], 3e-3),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", MADE)
def test_promises_hold(name, mode):
    make, error_m = MADE[name]
    vertices, faces = make()
    mesh = Mesh(vertices, np.asarray(faces, dtype=np.int32), name, "", "m", 1.0)
    levels, _, parameters = build_levels(mesh.vertices_m, mesh.faces, error_m=error_m, spheres=None, mode=mode)
    for what, value, limit, holds in measure(mesh, mode, levels[-1], parameters, error_m, 0):
        assert holds, f"{what}: {value} of {limit}"


def test_the_other_code_agrees_with_the_libraries():
    vertices, faces = SHAPES["cup"]()
    solid, points = make_solid(vertices, faces), np.random.default_rng(0).normal(size=(500, 3)) * 0.04
    np.testing.assert_allclose(
        distance_to_triangles(points, vertices, faces), closest_points(solid, points)[0], atol=1e-12
    )  # metres; rounding
    np.testing.assert_array_equal(solid_angle_winding(points, vertices, faces) > 0.5, is_inside(solid, points))


@pytest.mark.skipif(not (DATA / "meshes").is_dir(), reason="the shared meshes are not on this machine")
@pytest.mark.parametrize("name", ["spheres_objects/twobody.obj", "meshes/saucer.glb", "meshes/multibody_winding.stl"])
def test_shared_meshes_keep_what_is_promised_in_every_mode(name):
    for mode in MODES:
        holds, line = row(str(DATA / name), mode, 3.0, 0)
        assert holds and " leaves" in line, line


@pytest.mark.skipif(not (DATA / "meshes").is_dir(), reason="the shared meshes are not on this machine")
def test_a_soup_is_refused_in_one_line():
    assert len(get_mesh(str(DATA / "meshes" / "soup.stl")).faces)
    holds, line = row(str(DATA / "meshes" / "soup.stl"), "balanced", 3.0, 0)
    assert holds and "E-MESH-SOUP" in line and "\n" not in line
