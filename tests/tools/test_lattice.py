"""Objects of scenes: the spheres against the solid they stand for, and the table's mistakes by name."""

import igl
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.tools.lattice import KINDS, lattice_object, scene_object
from palmar.tools.shapes import SHAPES

# Solids are made of circles with 96 edges, which cut off r (1 - cos(pi / 96)) < 0.054 % of a radius, and of balls with
# facets that cut off twice that; the largest round part has 40 mm.
FACETS_MM = 0.05


def signed_distance_mm(tree, points):
    squared, *_ = igl.point_mesh_squared_distance(points, tree.vertices_m, tree.faces.astype(np.int64))
    winding = igl.fast_winding_number(tree.vertices_m, tree.faces.astype(np.int64), points)
    return 1e3 * np.sqrt(squared) * np.where(winding > 0.5, -1, 1)


@pytest.fixture(scope="module")
def objects():
    return {kind: lattice_object({"kind": kind}) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_every_sphere_lies_inside_its_solid_but_at_the_cut_ends(objects, kind):
    tree = objects[kind]
    out = signed_distance_mm(tree, tree.leaves[:, :3]) + 1e3 * tree.leaves[:, 3]
    # Sheets are cut off flat at the last centres of y, where a row's spheres stand out by up to their radius.
    inner = np.abs(tree.leaves[:, 1]) < tree.leaves[:, 1].max() - tree.leaves[:, 3]
    sheet = kind in ("plate", "ridge", "slot", "notch", "wedge")
    assert out[inner if sheet else slice(None)].max() <= FACETS_MM


@pytest.mark.parametrize("kind", KINDS)
def test_the_stated_gap_holds_for_other_points_of_the_surface(objects, kind):
    tree = objects[kind]
    generator = np.random.default_rng(1)
    corners = tree.vertices_m[tree.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = generator.choice(len(area), 2000, p=area / area.sum())
    weight = generator.dirichlet([1, 1, 1], 2000)
    points = np.einsum("nk,nki->ni", weight, corners[face])
    # Where all radii are one the nearest centre decides; the others are few.
    few = len(tree.leaves) <= 100
    near = np.arange(len(tree.leaves))[None] if few else cKDTree(tree.leaves[:, :3]).query(points)[1][:, None]
    gap = (np.linalg.norm(points[:, None] - tree.leaves[near, :3], axis=2) - tree.leaves[near, 3]).min(axis=1)
    # 0.02 mm: both are samples of one continuous gap, 20,000 there and 2,000 here
    assert 1e3 * gap.max() <= tree.about["levels"][-1]["gap_mm"]["max"] + 0.02


def test_a_plate_is_one_row_with_its_top_at_zero_and_the_pitch_asked_for(objects):
    leaves = lattice_object({"kind": "plate", "radius_m": 0.004, "pitch_m": 0.0073, "width_m": 0.05}).leaves
    assert np.all(leaves[:, 2] == -0.004) and np.all(leaves[:, 3] == 0.004)
    distance = cKDTree(leaves[:, :3]).query(leaves[:, :3], k=2)[0][:, 1]
    np.testing.assert_allclose(distance, 0.0073, rtol=1e-9)
    # The gap at the middle of four centres, R above them: sqrt(R^2 + s^2 / 2) - R.
    stated = objects["plate"].about["levels"][-1]["gap_mm"]["max"]
    assert stated == pytest.approx(1e3 * (np.sqrt(0.003**2 + 0.003**2 / 2) - 0.003), abs=0.02)


def test_inner_faces_of_a_slot_and_a_notch_are_where_their_numbers_say():
    slot = lattice_object({"kind": "slot", "gap_m": 0.012}).leaves
    assert 2 * (np.abs(slot[:, 0]) - slot[:, 3]).min() == pytest.approx(0.012, abs=1e-9)
    notch = lattice_object({"kind": "notch", "angle_rad": 1.0})
    # The planes of both inner faces go through the y axis and touch the spheres.
    for side in (-1, 1):
        normal = np.array([-side * np.cos(0.5), 0.0, np.sin(0.5)])
        reach = (notch.leaves[:, :3] @ normal + notch.leaves[:, 3])[side * notch.leaves[:, 0] > 1e-6]
        np.testing.assert_allclose(reach, 0.0, atol=1e-9)


def test_turned_and_moved_objects_are_the_same_objects():
    here = lattice_object({"kind": "ears"})
    shift = np.array([0.1, 0.2, -0.3])
    there = lattice_object({"kind": "ears", "turn_rad": [0.3, -1.0, 0.5], "position_m": shift.tolist()})
    turn = Rotation.from_rotvec([0.3, -1.0, 0.5])
    np.testing.assert_allclose(turn.apply(here.leaves[:, :3]) + shift, there.leaves[:, :3], atol=1e-12)
    # The same vertices; those of one edge may come in another order.
    assert cKDTree(there.vertices_m).query(turn.apply(here.vertices_m) + shift)[0].max() < 1e-12
    np.testing.assert_array_equal(here.leaves[:, 3], there.leaves[:, 3])


def test_a_ball_of_one_sphere_is_exact_from_half_a_millimetre_to_five_metres():
    for radius in (0.0005, 0.04, 5.0):
        tree = lattice_object({"kind": "ball", "radius_m": radius})
        np.testing.assert_array_equal(tree.leaves, [[0, 0, 0, radius]])
        # 384 edges of a circle: 1 - cos(pi / 384)^2 of the radius at the middle of a facet
        far = np.linalg.norm(tree.vertices_m, axis=1)
        np.testing.assert_allclose(far, radius, rtol=1e-7)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({}, "E-CONF object:kind: is missing"),
        ({"kind": "plat"}, "E-CONF object:kind: found 'plat'; allowed is one of plate, "),
        ({"kind": "plate", "pich_m": 1}, "E-CONF object:pich_m: unknown key; nearest: pitch_m"),
        ({"kind": "plate", "pitch_m": 0}, "E-CONF object:pitch_m: found 0; a number above 0"),
        ({"kind": "plate", "pitch_m": "fine"}, "E-CONF object:pitch_m: found 'fine'; a number from 0"),
        ({"kind": "plate", "pitch_m": 1e-4}, "E-CONF object:pitch_m: 3243601 spheres; up to 200000"),
        ({"kind": "ball", "position_m": [0, 1]}, "E-CONF object:position_m: found [0, 1]; three numbers"),
    ],
)
def test_a_mistake_in_the_table_is_named(table, said):
    with pytest.raises(PalmarError) as caught:
        lattice_object(table)
    assert str(caught.value).startswith(said)


def test_a_built_in_shape_is_built_and_then_placed():
    tree = scene_object({"kind": "shape:sphere", "spheres": 8, "position_m": [0.1, 0.0, 0.0]})
    np.testing.assert_allclose(tree.vertices_m, SHAPES["sphere"]()[0] + np.array([0.1, 0.0, 0.0]), atol=1e-15)
    # Eight spheres stand for one of 40 mm: none has its centre outside, and together they are about the same middle.
    assert np.linalg.norm(tree.leaves[:, :3] - [0.1, 0.0, 0.0], axis=1).max() < 0.04
    assert len(tree.about["levels"]) == len(tree.levels)
    with pytest.raises(PalmarError, match=r"E-CONF object:spheres: is missing"):
        scene_object({"kind": "shape:sphere"})
