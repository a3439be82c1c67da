import numpy as np
import pytest
import trimesh

from palmar.errors import BadMesh, PalmarError
from palmar.tools.pack import build
from palmar.tools.painted import PAINTED_SHARE, read_painted

RADIUS_MM = 40.0


def painted(path, how):
    """A ball of 40 mm whose weight is 1 at the top and falls to 0 at the equator, written in millimetres."""
    ball = trimesh.creation.icosphere(3, RADIUS_MM)
    weight = np.clip(ball.vertices[:, 2] / RADIUS_MM, 0, 1)
    if how == "red":
        grey = (200 * (1 - weight)).astype(np.uint8)
        red = grey + (255 * weight).astype(np.uint8)
        ball.visual.vertex_colors = np.column_stack([red, grey, grey, np.full(len(grey), 255)])
    elif how:
        ball.vertex_attributes[how] = weight.astype(np.float32)
    ball.export(path)
    return path


@pytest.mark.parametrize(
    ("name", "how"),
    [
        *(("a.ply", "weight"), ("a.ply", "quality"), ("a.ply", "red")),
        *(("a.glb", "_WEIGHT"), ("a.glb", "red"), ("a.obj", "red")),
    ],
)
def test_paint_becomes_regions_by_its_weight(tmp_path, name, how):
    regions = read_painted(painted(tmp_path / name, how), 1e-3)
    assert regions.shares == pytest.approx([PAINTED_SHARE ** (k / 3) for k in (3, 2, 1)])
    # Points of the sphere by height: thirds of the weight, a region's radius (80 mm / 30) off their borders.
    height = np.linspace(-1, 1, 4001)
    points = 0.04 * np.column_stack([np.sqrt(1 - height**2), np.zeros(4001), height])
    zone, margin = regions.zone_of(points), 1.2 / 30 * 2
    assert (zone[height < 1 / 6 - margin] == 0).all()
    for number, (low, high) in enumerate([(5 / 6, 2), (1 / 2, 5 / 6), (1 / 6, 1 / 2)], 1):
        # Where regions lie over each other the stricter holds, so borders move down only.
        assert (zone[(height > low + 0.01) & (height < high - margin if number > 1 else True)] <= number).all()
        assert (zone[(height > low + 0.01) & (height < high - 0.01)] > 0).all()
        assert (zone[(height < low - margin)] != number).all()


def test_a_painted_top_gets_its_spheres_and_keeps_its_error(tmp_path):
    path = painted(tmp_path / "ball.ply", "weight")
    plain = build([path], tmp_path / "plain.pack", units="mm", spheres=30)
    answer = build([path], tmp_path / "painted.pack", units="mm", spheres=30, region=["painted"])
    parameters = answer["objects"]["ball"]["parameters"]
    assert parameters["painted"] and parameters["region_files"] == []
    assert [row["share"] for row in parameters["regions"]] == pytest.approx([0.25, 0.25 ** (2 / 3), 0.25 ** (1 / 3)])
    assert all(row["protrusion_max_mm"] <= row["error_mm"] for row in parameters["regions"])
    assert plain["sha256"] != answer["sha256"]
    (tmp_path / "list.toml").write_text(
        '[[object]]\nmesh = "ball.ply"\nunits = "mm"\nspheres = 30\nregion = "painted"\n'
    )
    assert build([tmp_path / "list.toml"], tmp_path / "listed.pack")["sha256"] == answer["sha256"]


@pytest.mark.parametrize(
    ("how", "factor", "words"),
    [
        ("", 1, "vertices have no paint; one of weight"),
        ("weight", 3, r"vertex \d+, weight: .*; 0 to 1 is needed"),
        ("weight", 0.1, "no vertex is painted"),
    ],
)
def test_paint_that_says_nothing_costs_one_line(tmp_path, how, factor, words):
    ball = trimesh.creation.icosphere(2, RADIUS_MM)
    if how:
        ball.vertex_attributes[how] = factor * np.linspace(0, 1, len(ball.vertices)).astype(np.float32)
    ball.export(tmp_path / "a.ply")
    with pytest.raises(BadMesh, match=words) as caught:
        read_painted(tmp_path / "a.ply", 1e-3)
    assert "\n" not in str(caught.value)


def test_a_shape_has_no_paint(tmp_path):
    with pytest.raises(PalmarError, match="shape:cube has no paint"):
        build(["shape:cube"], tmp_path / "a.pack", spheres=4, region=["painted"])
    assert not (tmp_path / "a.pack").exists()
