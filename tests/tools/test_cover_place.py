import numpy as np
import pytest

from palmar._runtime import union_exits, union_nearest
from palmar.raster import find_hits, ranks
from palmar.tools.cover import measure_cover
from palmar.tools.cover_map import write_map
from palmar.tools.cover_picture import colour, colour_limit
from palmar.tools.cover_place import surface_errors, worst_places
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import make_solid, signed_distance, smooth_normals
from palmar.unwrap import unwrap

MM = 1e-3


def random_spheres(count, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(size=(count, 3)) * 0.02, rng.uniform(0.002, 0.01, count)])


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def box(size):
    vertices, faces = SHAPES["cube"]()
    return make_solid(vertices / 0.07 * size, faces)


def normals_of(solid, surface):
    return smooth_normals(solid, surface.points, surface.face)


def extruded(outline_mm, length_mm):
    from manifold3d import CrossSection

    mesh = CrossSection([np.array(outline_mm, dtype=float)]).extrude(length_mm).to_mesh64()
    return make_solid(np.asarray(mesh.vert_properties)[:, :3] * MM, np.asarray(mesh.tri_verts, dtype=np.int64))


def test_a_ray_leaves_the_union_where_it_first_is_in_no_ball():
    spheres, rng = random_spheres(60, 0), np.random.default_rng(1)
    points, directions = rng.normal(size=(400, 3)) * 0.02, unit(rng.normal(size=(400, 3)))
    length, owner = union_exits(spheres, points, directions)
    # By steps of 20 um.
    along = np.arange(0, 0.06, 2e-5)
    for k in range(len(points)):
        path = points[k] + along[:, None] * directions[k]
        outside = (np.linalg.norm(path[:, None] - spheres[None, :, :3], axis=2) > spheres[:, 3]).all(axis=1)
        assert along[np.argmax(outside)] - 2e-5 <= length[k] <= along[np.argmax(outside)] + 1e-12
        if owner[k] >= 0:
            end = points[k] + length[k] * directions[k]
            # metres; rounding
            assert np.linalg.norm(end - spheres[owner[k], :3]) == pytest.approx(spheres[owner[k], 3], abs=1e-12)


def test_the_nearest_sphere_is_that_of_the_least_distance():
    spheres, points = random_spheres(200, 2), np.random.default_rng(3).normal(size=(2000, 3)) * 0.03
    every = np.linalg.norm(points[:, None] - spheres[None, :, :3], axis=2) - spheres[:, 3]
    distance, owner = union_nearest(spheres, points)
    outside = every.min(axis=1) > 0
    np.testing.assert_allclose(distance[outside], every.min(axis=1)[outside], atol=1e-15)  # metres; rounding
    np.testing.assert_array_equal(owner[outside], every.argmin(axis=1)[outside])


def test_pixels_of_a_square_of_two_triangles_are_there_once():
    corners = np.array([[[0.3, 0.2], [10.3, 0.2], [10.3, 7.2]], [[0.3, 0.2], [10.3, 7.2], [0.3, 7.2]]])
    hits = find_hits(corners)
    pixels = set(zip(hits.column.tolist(), hits.row.tolist(), strict=True))
    assert pixels == {(x, y) for x in range(10) for y in range(7)} and len(hits.row) == 70
    at = hits.of(corners)
    np.testing.assert_allclose(at, np.column_stack([hits.column, hits.row]) + 0.5, atol=1e-9)  # rounding
    assert len(find_hits(corners[:, ::-1]).row) == 0  # from behind


def test_what_lies_higher_ranks_first():
    square = np.array([[[0.0, 0.0], [4, 0], [4, 4]]])
    hits = find_hits(np.concatenate([square, square, square]))
    height = np.array([1.0, 3.0, 2.0])[hits.face]
    assert {(int(f), int(r)) for f, r in zip(hits.face, ranks(hits, height), strict=True)} == {(1, 0), (2, 1), (0, 2)}


@pytest.mark.parametrize("name", ["cube", "cup", "shamrock"])
def test_every_point_of_a_surface_is_unwrapped_once(name):
    solid = make_solid(*SHAPES[name]())
    surface = unwrap(solid.vertices, solid.faces, 40_000)
    places = surface.row * surface.shape[1] + surface.column
    assert len(np.unique(places)) == len(places)
    assert surface.row.max() < surface.shape[0] and surface.column.max() < surface.shape[1]
    assert np.abs(signed_distance(solid, surface.points)[0]).max() < 1e-9
    # Pixels along 40,000 texels' rims are whole or not there.
    assert surface.areas.sum() == pytest.approx(solid.areas.sum(), rel=0.01)


def test_a_ball_1_mm_larger_than_a_sphere_sticks_out_by_1_mm_everywhere_and_is_felt_so():
    solid = make_solid(*SHAPES["sphere"]())
    surface = unwrap(solid.vertices, solid.faces, 5_000)
    errors = surface_errors(solid, np.array([[0, 0, 0, 0.041]]), surface.points, normals_of(solid, surface))
    facet = 0.02 * MM  # how far facets lie inside the sphere of 40 mm
    assert np.abs(errors.protrusion_m - MM).max() < facet and errors.gap_m.max() == 0
    assert np.abs(errors.felt_offset_m - MM).max() < facet
    # Facets are smoothed; what is left of them is less than one.
    assert errors.normal_deg.max() < 360 / 192 and errors.felt_normal_deg.max() < 360 / 192


def test_the_ball_in_a_cube_leaves_gaps_that_are_worst_at_its_corners():
    solid = box(0.07)
    spheres = np.array([[0.0, 0.0, 0.0, 0.035]])
    surface = unwrap(solid.vertices, solid.faces, 60_000)
    errors = surface_errors(solid, spheres, surface.points, normals_of(solid, surface))
    expected = np.linalg.norm(surface.points, axis=1) - 0.035
    np.testing.assert_allclose(errors.gap_m, expected, atol=1e-12)  # metres; rounding
    # Where the fingertip is free to sink, it does: offset is the other way than protrusion.
    middle = np.linalg.norm(surface.points[:, :2], axis=1) + np.abs(np.abs(surface.points[:, 2]) - 0.035) < 2e-3
    assert middle.any() and np.abs(errors.felt_offset_m[middle]).max() < 0.06 * MM  # 2 mm beside the touching point
    places = worst_places(solid, surface.points, errors.gap_m, surface.areas, 0, "gap", 0.01)
    assert len(places) == 5
    for place in places:
        assert np.abs(np.abs(place["at_mm"]) - 35).max() < 0.5  # mm; a texel is 0.7
        assert place["what"] == "sharp edge" and place["thickness_mm"] is None
        assert place["max_mm"] == pytest.approx(35 * (np.sqrt(3) - 1), abs=0.6)


def test_a_thin_wall_is_named_with_its_thickness():
    solid = box(np.array([0.08, 0.06, 0.001]))
    spheres = np.array(
        [[x, y, 0.0, 0.0012] for x in np.arange(-0.039, 0.04, 0.002) for y in np.arange(-0.029, 0.03, 0.002)]
    )
    spheres = spheres[np.linalg.norm(spheres[:, :2], axis=1) > 0.01]  # a hole in the middle
    surface = unwrap(solid.vertices, solid.faces, 60_000)
    errors = surface_errors(solid, spheres, surface.points, normals_of(solid, surface))
    (first, *_) = worst_places(solid, surface.points, errors.gap_m, surface.areas, 0, "gap", 0.001)
    assert (first["what"], first["thickness_mm"]) == ("thin wall", pytest.approx(1.0, abs=1e-3))
    assert np.linalg.norm(first["centre_mm"][:2]) < 1 and first["max_mm"] == pytest.approx(8.9, abs=0.5)


def test_a_filled_notch_is_named():
    # A V of 90 degrees in a block, bridged by a ball that touches both of its sides from above their middle.
    solid = extruded([(-30, -20), (30, -20), (30, 10), (10, 10), (0, 0), (-10, 10), (-30, 10)], 40.0)
    spheres = np.array([[0, 0.004, 0.02, 0.005], [0, -0.01, 0.02, 0.01]])
    surface = unwrap(solid.vertices, solid.faces, 60_000)
    errors = surface_errors(solid, spheres, surface.points, normals_of(solid, surface))
    (first, *_) = worst_places(solid, surface.points, errors.protrusion_m, surface.areas, 0, "protrusion", 0.002)
    assert first["what"] == "concave notch" and abs(first["centre_mm"][0]) < 5


def test_the_middle_of_a_flat_side_is_plain():
    solid = box(0.07)
    surface = unwrap(solid.vertices, solid.faces, 20_000)
    errors = surface_errors(solid, np.array([[0, 0, 0, 0.036]]), surface.points, normals_of(solid, surface))
    first = worst_places(solid, surface.points, errors.protrusion_m, surface.areas, 0, "protrusion", 0.001)[0]
    # 36 mm - sqrt(36^2 - 0.9^2): a texel of 1.2 mm beside the middle.
    assert first["what"] == "plain side" and first["max_mm"] == pytest.approx(1.0, abs=0.012)


def test_the_map_reads_back_with_named_float_channels(tmp_path):
    import OpenEXR

    solid = make_solid(*SHAPES["cup"]())
    surface = unwrap(solid.vertices, solid.faces, 5_000)
    errors = surface_errors(solid, random_spheres(50, 4), surface.points, normals_of(solid, surface))
    names = write_map(tmp_path / "a.exr", surface, errors, colour(errors.signed_m * 1e3, 2.0))
    read = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    assert set(read) == set(names)
    for name, value in (("gap_mm", errors.gap_m * 1e3), ("position_mm.y", surface.points[:, 1] * 1e3)):
        pixels = read[name].pixels
        assert pixels.dtype == np.float32
        np.testing.assert_array_equal(pixels[surface.row, surface.column], value.astype(np.float32))
    assert read["A"].pixels.sum() == len(surface.points)


def test_measured_figures_of_a_ball_that_is_1_mm_too_large():
    found = measure_cover(make_solid(*SHAPES["sphere"]()), np.array([[0, 0, 0, 0.041]]))
    facet = 0.02  # mm
    for kind in (found["protrusion_mm"], found["felt"]["offset_mm"]):
        assert kind["p50"] == pytest.approx(1.0, abs=facet) and kind["max"] == pytest.approx(1.0, abs=facet)
    assert found["felt"]["held_off_mm"] == pytest.approx(1.0, abs=facet) and found["felt"]["let_in_mm"] == 0
    assert found["gap_mm"]["max"] == 0 and found["felt"]["inside_share"] == 0
    # The mesh is a little smaller than its sphere: by 1 - (sin x / x) of its facets, squared.
    assert found["volume"]["ratio"] == pytest.approx((41 / 40) ** 3, rel=3e-3)


def test_the_volume_of_two_balls_is_that_of_two_caps():
    radius, apart = 0.02, 0.015
    spheres = np.array([[0, 0, 0, radius], [apart, 0, 0, radius]])
    height = radius - apart / 2
    expected = 2 * (4 / 3 * np.pi * radius**3 - np.pi * height**2 * (3 * radius - height) / 3)
    found = measure_cover(make_solid(*SHAPES["sphere"]()), spheres)["volume"]
    assert found["union_cm3"] == pytest.approx(expected * 1e6, rel=2e-3)  # patches at the seam


def test_a_fingertip_that_falls_through_is_counted():
    # Small balls 5 mm in from the corners of a cube: the middle of a fingertip around them is mostly outside of it.
    spheres = np.array([[x, y, z, 0.004] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])
    directions = unit(np.random.default_rng(0).normal(size=(100_000, 3)))
    share = (directions < 5 / (4 + 7)).all(axis=1).mean()
    assert measure_cover(box(0.07), spheres)["felt"]["inside_share"] == pytest.approx(
        share, abs=0.01
    )  # samples of both


@pytest.mark.parametrize(("largest", "limit"), [(0.9, 1.0), (1.0, 1.0), (2.3, 2.5), (0.021, 0.025), (0.0, 0.001)])
def test_colour_scales_end_at_round_numbers(largest, limit):
    assert colour_limit(largest) == pytest.approx(limit)
    assert (colour(np.array([-2 * limit, 2 * limit]), limit) == colour(np.array([-limit, limit]), limit)).all()
