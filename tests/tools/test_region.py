from types import SimpleNamespace

import numpy as np
import pytest

from palmar.errors import BadMesh, BadPack, PalmarError
from palmar.tools.cover import exposed_skin, union_gap
from palmar.tools.pack import build
from palmar.tools.region import Regions, read_regions, zone_triangles
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import closest_points, make_solid, sample_surface, signed_distance
from palmar.tools.sphere_tree import build_levels

HEADER = "x_mm,y_mm,z_mm,radius_mm,share\n"
# In the middle of the cube's upper face, which two triangles of 70 mm make.
MIDDLE = Regions(np.array([[0, 0, 0.035, 0.012]]), np.array([0.25]))


def write(path, text):
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def cubes():
    """Leaves of a cube within 2 mm, within 2 mm but 0.5 mm in a region, and within 0.5 mm."""
    mesh = SHAPES["cube"]()
    wanted = {"loose": (2e-3, {}), "region": (2e-3, {"regions": MIDDLE}), "tight": (5e-4, {})}
    return {name: build_levels(*mesh, error_m=error, spheres=None, **more) for name, (error, more) in wanted.items()}


def test_region_keeps_its_error_and_the_rest_keeps_its_own(cubes):
    solid = make_solid(*SHAPES["cube"]())
    leaves = cubes["region"][0][-1]
    points, _ = sample_surface(solid, 400_000, 91)
    near = MIDDLE.zone_of(points) == 1
    gap = union_gap(leaves, points)
    assert np.quantile(gap[near], 0.99) <= 0.5e-3 and np.quantile(gap[~near], 0.99) <= 2e-3
    owner, direction, _ = exposed_skin(leaves, 0.002, 5e-4, 92)
    skin = leaves[owner, :3] + leaves[owner, 3:] * direction
    out, closest, _ = signed_distance(solid, skin)
    near = MIDDLE.zone_of(closest) == 1
    assert near.sum() > 500
    assert out[near].max() <= 0.5e-3 and out.max() <= 2e-3  # protrusion is bound everywhere, not at a percentile
    assert out[~near].max() > 1e-3  # what is allowed there is used


def test_spheres_go_to_the_region_and_are_saved_elsewhere(cubes):
    loose, region, tight = (len(cubes[name][0][-1]) for name in ("loose", "region", "tight"))
    # The disc is 1.5 % of the surface. It and the ring where large balls must keep off cost less than a third of
    # what the whole surface would.
    assert loose < region < loose + (tight - loose) / 3


def test_manifest_says_what_holds_in_each_region(cubes):
    (row,) = cubes["region"][2]["regions"]
    assert row["share"] == 0.25 and row["error_mm"] == pytest.approx(0.5)
    assert row["gap_p99_mm"] <= 0.5 and 0.2 < row["protrusion_max_mm"] <= 0.5
    assert "regions" not in cubes["loose"][2]


@pytest.mark.parametrize("mode", ["inside", "outside"])
def test_modes_hold_with_a_region(mode):
    mesh = SHAPES["cube"]()
    levels, _, _ = build_levels(*mesh, error_m=None, spheres=80, mode=mode, regions=MIDDLE)
    solid = make_solid(*mesh)
    points, _ = sample_surface(solid, 100_000, 93)
    gap = union_gap(levels[-1], points)
    near = MIDDLE.zone_of(points) == 1
    if mode == "inside":
        assert (levels[-1][:, 3] - closest_points(solid, levels[-1][:, :3])[0]).max() <= 1e-6
        assert np.quantile(gap[near], 0.99) < 0.3 * np.quantile(gap[~near], 0.99)  # a quarter, and the samples' rest
    else:
        assert gap.max() <= 0


def test_zone_has_the_surface_in_the_ball_and_a_border():
    solid = make_solid(*SHAPES["cube"]())
    corners, face = zone_triangles(solid, MIDDLE, 0.25)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    # Pieces at the border are up to 0.15 of the radius from their middle, so up to 0.3 wide.
    assert np.pi * 0.012**2 < area < np.pi * (1.3 * 0.012) ** 2
    assert np.allclose(solid.normals[face], [0, 0, 1])


def test_overlapping_regions_keep_the_least_share():
    regions = Regions(np.array([[0, 0, 0, 1.0], [0.5, 0, 0, 1.0]]), np.array([0.5, 0.2]))
    assert regions.shares == [0.2, 0.5]
    points = np.array([[-0.9, 0, 0], [0.2, 0, 0], [1.4, 0, 0], [2, 0, 0]])
    assert regions.zone_of(points).tolist() == [2, 1, 1, 0]


def test_region_off_the_surface_is_refused():
    regions = Regions(np.array([[0, 0, 0.3, 0.01]]), np.array([0.5]))
    with pytest.raises(BadMesh, match=r"no surface lies .* 0, 0, 300 mm"):
        build_levels(*SHAPES["cube"](), error_m=1e-3, spheres=None, regions=regions)


def test_csv_is_read_in_any_order_of_columns(tmp_path):
    path = write(tmp_path / "a.csv", "share,x_mm,y_mm,z_mm,radius_mm\n0.5,1,2,3,4\n\n0.25,5,6,7,8\n")
    regions = read_regions([path], [], 0.5)
    assert regions.balls_m.tolist() == [[0.001, 0.002, 0.003, 0.004], [0.005, 0.006, 0.007, 0.008]]
    assert regions.share.tolist() == [0.5, 0.25]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: columns"),
        ("x,y,z,r\n1,2,3,4\n", "x_mm, y_mm, z_mm, radius_mm, share are needed"),
        (HEADER, "no regions"),
        (HEADER + "1,2,3,4\n", "line 2, column share: ''; 0.05 to 1"),
        (HEADER + "1,2,3,4,0.01\n", "line 2, column share: '0.01'"),
        (HEADER + "1,2,3,0,0.5\n", "column radius_mm: '0'; a number above 0"),
        (HEADER + "1,nan,3,4,0.5\n", "column y_mm: 'nan'; a number"),
        (HEADER + "".join(f"0,0,0,1,0.{k}\n" for k in range(1, 6)), "5 different shares; up to 4"),
    ],
)
def test_bad_csv_costs_one_line(tmp_path, text, words):
    with pytest.raises(BadPack, match=words.replace("(", r"\(")) as caught:
        read_regions([write(tmp_path / "a.csv", text)], [], 0.5)
    assert "\n" not in str(caught.value)


def test_contacts_of_a_run_are_taken_into_the_objects_frame(monkeypatch):
    # The object is turned by 90 degrees about z and moved; its point (11, 1, 1) mm is at (-1, 11, 1) from its place.
    half = np.sqrt(0.5)
    run = SimpleNamespace(
        time_s=np.zeros(2),
        contact_start=np.array([0, 0, 2]),
        contact_point_m=np.array([[0.999, 2.011, 3.001], [0.999, 2.0111, 3.001]]),
        object_position_m=np.array([[9, 9, 9], [1, 2, 3.0]]),
        object_rotation_wxyz=np.array([[1, 0, 0, 0], [half, 0, 0, half]]),
    )
    monkeypatch.setattr("palmar.tools.region.read_run", lambda path: run)
    regions = read_regions([], ["a.run.mcap"], 0.3)
    # Two contacts a tenth of a millimetre apart are one.
    np.testing.assert_allclose(regions.balls_m, [[0.011, 0.001, 0.001, 0.005]], atol=1e-15)  # metres; rounding
    assert regions.share.tolist() == [0.3]
    run.contact_start[:] = 0
    run.contact_point_m = run.contact_point_m[:0]
    with pytest.raises(BadPack, match="no contact"):
        read_regions([], ["a.run.mcap"], 0.3)


def test_build_takes_regions_by_argument_and_by_list(tmp_path):
    write(tmp_path / "top.csv", HEADER + "0,0,35,12,0.5\n")
    argued = build(["shape:cube"], tmp_path / "a.pack", spheres=15, region=[tmp_path / "top.csv"])
    (tmp_path / "list.toml").write_text('[[object]]\nmesh = "shape:cube"\nspheres = 15\nregion = "top.csv"\n')
    listed = build([tmp_path / "list.toml"], tmp_path / "b.pack")
    assert argued["sha256"] == listed["sha256"]
    parameters = argued["objects"]["cube"]["parameters"]
    assert parameters["regions"][0]["share"] == 0.5 and parameters["region_files"][0][0] == "top.csv"
    for text, words in (("region = 3\n", "a path or a list"), ("touched_share = 0.001\n", "touched_share")):
        (tmp_path / "bad.toml").write_text('[[object]]\nmesh = "shape:cube"\n' + text)
        with pytest.raises(PalmarError, match=words):
            build([tmp_path / "bad.toml"], tmp_path / "c.pack")
    assert not (tmp_path / "c.pack").exists()
