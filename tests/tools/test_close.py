"""Closing: which meshes bound a solid, what is mended exactly, and what closing the rest costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from palmar.errors import BadMesh
from palmar.tools.close import close_mesh, find_faults, require_closed
from palmar.tools.mesh import Mesh, read_mesh

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="the shared recordings and meshes are not beside the checkout"
)

BOX = trimesh.creation.box((0.04, 0.06, 0.1))


def solid(mesh: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32), "made", "", "m", 1.0)


def test_open_flipped_inside_out_overlapping_and_doubled_boxes_are_told_apart():
    whole = solid(BOX)
    require_closed("box", whole)
    cases = {
        "E-MESH-OPEN": whole.faces[1:],
        "E-MESH-WINDING": np.vstack([whole.faces[:1, ::-1], whole.faces[1:]]),
        "E-MESH-INSIDE-OUT": whole.faces[:, ::-1],
    }
    for code, faces in cases.items():
        with pytest.raises(BadMesh, match=code):
            require_closed("box", Mesh(whole.vertices_m, faces, "box", "", "m", 1.0))
    shifted = BOX.copy()
    shifted.apply_translation([0.01, 0.013, 0.02])
    with pytest.raises(BadMesh, match=r"E-MESH-OVERLAP.*2 bodies"):
        require_closed("boxes", solid(trimesh.util.concatenate([BOX, shifted])))
    doubled = Mesh(whole.vertices_m, np.vstack([whole.faces, whole.faces[:, ::-1]]), "box", "", "m", 1.0)
    with pytest.raises(BadMesh):
        require_closed("doubled", doubled)


def test_cheap_faults_are_mended_exactly():
    whole = solid(BOX)
    volume = 0.04 * 0.06 * 0.1
    shifted = BOX.copy()
    shifted.apply_translation([0.01, 0.013, 0.02])
    union = 2 * volume - 0.03 * 0.047 * 0.08
    cases = {
        "same": (whole, volume, None),
        "flipped": (
            Mesh(whole.vertices_m, np.vstack([whole.faces[:3, ::-1], whole.faces[3:]]), "", "", "m", 1),
            volume,
            "repaired",
        ),
        "inside out": (Mesh(whole.vertices_m, whole.faces[:, ::-1], "", "", "m", 1), volume, "repaired"),
        "doubled": (
            Mesh(whole.vertices_m, np.vstack([whole.faces, whole.faces[:, ::-1]]), "", "", "m", 1),
            volume,
            "repaired",
        ),
        "overlapping": (solid(trimesh.util.concatenate([BOX, shifted])), union, "united"),
    }
    for name, (mesh, expected, how) in cases.items():
        closed, about = close_mesh(name, mesh)
        require_closed(name, closed)
        assert (about and about["how"]) == how
        # 1e-9: rounding of sums of a few dozen products.
        assert find_faults(closed).volume_m3 == pytest.approx(expected, rel=1e-9), name
        assert not about or about["warnings"] == []


def test_a_hole_is_spanned_and_the_distance_stated():
    ball = trimesh.creation.icosphere(3, radius=0.05)
    cap = ball.triangles_center[:, 2] > 0.045
    opened = solid(ball.submesh([~cap], append=True))
    with pytest.raises(BadMesh, match="E-MESH-OPEN"):
        require_closed("ball", opened)
    closed, about = close_mesh("ball", opened, cells=32)
    require_closed("ball", closed)
    assert about["how"] == "remeshed"
    # The skin that was there is kept to a quarter of a cell; the hole's rim, an open edge, is blurred by one cell.
    assert about["moved_mm"]["mesh_to_solid"]["mean"] < 0.25 * about["cell_mm"]
    assert about["moved_mm"]["mesh_to_solid"]["max"] < about["cell_mm"]
    # A ball of 2880 cells' worth of volume less at most the cap, 1.3 % of it.
    assert find_faults(closed).volume_m3 == pytest.approx(ball.volume, rel=0.02)


def test_a_sheet_has_no_inside_and_says_so():
    sheet = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]]), np.array([[0, 1, 2]], np.int32), "", "", "m", 1.0)
    with pytest.raises(BadMesh, match="E-MESH-SOUP"):
        close_mesh("sheet", sheet, cells=32)


@pytest.mark.parametrize("seed", range(2))
def test_soup_is_refused_or_its_loss_is_stated(seed):
    corners = np.random.default_rng(seed).random((60, 3, 3)) * 0.1
    soup = Mesh(corners.reshape(-1, 3), np.arange(180, dtype=np.int32).reshape(-1, 3), "soup", "", "m", 1.0)
    try:
        closed, about = close_mesh("soup", soup, cells=20)
    except BadMesh as error:
        assert error.code == "E-MESH-SOUP"
    else:
        require_closed("soup", closed)
        assert any("what encloses nothing is lost" in warning for warning in about["warnings"])


def test_closing_twice_gives_the_same_bytes():
    opened = solid(trimesh.creation.icosphere(2, radius=0.05).submesh([np.arange(300)], append=True))
    first, second = (close_mesh("ball", opened, cells=32) for _ in range(2))
    assert first[0].vertices_m.tobytes() == second[0].vertices_m.tobytes()
    assert first[0].faces.tobytes() == second[0].faces.tobytes()
    assert first[1] == second[1]


@needs_data
@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("bunny.obj", None),
        ("teacup.glb", None),
        ("torus.obj", None),
        ("spot_low.obj", None),
        ("nefertiti_70k.obj", None),
        ("utah_teapot.obj", "E-MESH-OPEN"),
        ("cube_no_bottom.obj", "E-MESH-OPEN"),
        ("soup.stl", "E-MESH-OPEN"),
        ("chair_doubled.obj", "E-MESH-FLAT"),
        ("box_10_bodies.stl", "E-MESH-OVERLAP"),
        ("multibody_winding.stl", "E-MESH-WINDING"),
    ],
)
def test_known_meshes_are_taken_or_refused(name, code):
    mesh = read_mesh(DATA / "meshes" / name, size_mm=100)
    if code is None:
        require_closed(name, mesh)
        return
    with pytest.raises(BadMesh) as caught:
        require_closed(name, mesh)
    assert caught.value.code == code


@needs_data
@pytest.mark.parametrize("name", ["utah_teapot.obj", "cube_no_bottom.obj"])
def test_known_broken_meshes_are_closed_at_a_coarse_grid(name):
    closed, about = close_mesh(name, read_mesh(DATA / "meshes" / name, size_mm=100), cells=32)
    require_closed(name, closed)
    moved = about["moved_mm"]["mesh_to_solid"]
    assert moved["mean"] < about["cell_mm"] and (moved["max"] <= 1.0 or about["warnings"])
