import numpy as np
import pytest
from manifold3d import Error, Manifold, Mesh64

from palmar.tools.shapes import SHAPES
from palmar.tools.solid import make_solid, signed_distance


def solid_of(name):
    vertices, faces = SHAPES[name]()
    return Manifold(Mesh64(vert_properties=vertices, tri_verts=faces.astype(np.uint64)))


def test_names_of_the_built_in_shapes():
    assert set(SHAPES) == {
        "sphere",
        "cylinder",
        "triangular_prism",
        "cube",
        "hexagonal_prism",
        "cup",
        "shamrock",
        "rock",
        "ears",
    }


@pytest.mark.parametrize("name", SHAPES)
def test_shape_is_one_closed_body_of_hand_size_about_the_origin(name):
    solid = solid_of(name)
    assert solid.status() == Error.NoError
    assert len(solid.decompose()) == 1
    assert solid.volume() > 0  # outward winding
    box = np.array(solid.bounding_box())
    assert 0.06 <= (box[3:] - box[:3]).max() <= 0.1
    assert np.abs(box[:3] + box[3:]).max() < 1e-12  # metres; rounding of the shift


@pytest.mark.parametrize("name", SHAPES)
def test_shape_is_the_same_each_time(name):
    for first, second in zip(SHAPES[name](), SHAPES[name](), strict=True):
        assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize(
    ("name", "volume_mm3", "within"),
    [
        ("cube", 70**3, 1e-9),
        ("triangular_prism", np.sqrt(3) / 4 * 80**2 * 80, 1e-9),
        ("hexagonal_prism", 1.5 * np.sqrt(3) * 35**2 * 80, 1e-9),
        # Facets lie inside the round body: 128 and 192 of them lose less than 0.1 %.
        ("cylinder", np.pi * 30**2 * 90, 1e-3),
        ("sphere", 4 / 3 * np.pi * 40**3, 1e-3),
        # Walls and floor; the handle, two thirds of a torus, is between a half and the whole of it.
        ("cup", np.pi * (36**2 * 80 - 32.5**2 * 75) + 0.75 * 2 * np.pi**2 * 20 * 4**2, 0.05),
    ],
)
def test_volume_is_that_of_the_formula(name, volume_mm3, within):
    assert solid_of(name).volume() * 1e9 == pytest.approx(volume_mm3, rel=within)


def test_cup_is_hollow_with_a_wall_above_3_mm_and_a_hole_in_its_handle():
    solid = make_solid(*SHAPES["cup"]())
    # The handle makes the box 24 mm longer, so that the axis stands at x = -12 mm.
    axis = np.column_stack([np.full(20, -0.012), np.zeros(20), np.linspace(-0.034, 0.039, 20)])
    assert (signed_distance(solid, axis)[0] > 0).all()
    assert signed_distance(solid, np.array([[0.032, 0, 0]]))[0] > 0.006  # inside the handle's ring
    assert solid_of("cup").genus() == 1
    wall = np.array([[-0.012, 0.03425, 0.0]])  # middle of the wall
    assert signed_distance(solid, wall)[0] == pytest.approx(-0.00175, abs=5e-5)  # 96 facets: 36 (1 - cos(pi / 96)) mm


def test_shamrock_has_notches_in_and_between_its_leaves():
    vertices, faces = SHAPES["shamrock"]()
    solid = solid_of("shamrock")
    # Three hearts and a stem fill well below their hull.
    assert solid.volume() < 0.75 * solid.hull().volume()
    assert len(vertices) > 1000 and len(faces) > 2000
