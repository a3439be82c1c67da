"""Where a hand touches, on analytic cases, and that the maps say so."""

import numpy as np
import OpenEXR
import pytest
import trimesh

from palmar.eval.gap import Mesh
from palmar.eval.judge import Poses, Shape
from palmar.eval.maps import six_views
from palmar.eval.touch import TOUCH_M, touch_hand, touch_object
from palmar.eval.view3d import coarser, strongest_contacts
from palmar.exr import write_parts
from palmar.tools.shapes import SHAPES


def ball_on_way(z, radius):
    """A hand of which only one palm ball is near the origin, at heights z (n,)."""
    n = len(z)
    far = np.full((n, 15, 3), 10.0)
    palm = np.stack([np.zeros(n), np.zeros(n), z], axis=1)[:, None]
    return Shape(far, np.full(15, 0.01), far + 0.01, np.full(15, 0.01), palm, np.array([radius]))


def test_a_ball_on_a_plane_leaves_its_cap_as_depth_and_its_time_as_contact():
    z = np.array([0.03, 0.0095, 0.009, 0.0095, 0.03])  # a ball of 10 mm, 1 mm deep at the most
    across = np.linspace(-0.02, 0.02, 81)
    points = np.stack([across, np.zeros(81), np.zeros(81)], axis=1)
    depth, contact = touch_object(ball_on_way(z, 0.01), points, np.full(5, 0.001))
    np.testing.assert_allclose(depth, np.maximum(0, 0.01 - np.hypot(across, 0.009)), atol=1e-15)  # rounding
    assert contact[40] == pytest.approx(0.003) and contact[0] == 0
    near = np.hypot(across, 0.009) - 0.01 < TOUCH_M
    assert ((contact > 0) == near).all()


def test_points_of_the_hand_are_as_deep_as_the_hand_went(hand):
    box = trimesh.creation.box((0.2, 0.2, 0.02))
    n = 4
    poses = Poses(
        np.array([[0, 0, z] for z in (0.05, 0.02, 0.0185, 0.05)]),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.zeros((n, 5, 3)),
        np.zeros((n, 5)),
    )
    frames = np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 3))
    skin = np.array([[0.0, 0, -0.01], [0, 0, 0.01]]), np.array([0, 0])  # below and above a palm ball
    depth, contact = touch_hand(hand, poses, frames, Mesh(box.vertices, box.faces), skin, np.full(n, 0.001))
    np.testing.assert_allclose(depth, [0.0015, 0], atol=1e-12)  # metres; rounding
    np.testing.assert_allclose(contact, [0.002, 0], atol=1e-15)


def test_six_views_show_every_side_once_unmirrored_and_tell_depth_and_normal():
    vertices, faces = SHAPES["cube"]()
    views = {view.name: view for view in six_views(vertices, faces.astype(np.int64), 50)}
    assert list(views) == ["from +x", "from -x", "from +y", "from -y", "from +z", "from -z"]
    for name, view in views.items():
        axis, sign = "xyz".index(name[-1]), 1 if "+" in name else -1
        assert len(view.points) == 50 * 50 and np.abs(view.depth_m).max() < 1e-12
        assert (view.normals[:, axis] == sign).all()
        # Right cross up is towards the eye in every view, or its picture would be mirrored.
        column = np.polyfit(view.column, view.points, 1)[0]
        row = np.polyfit(view.row, view.points, 1)[0]
        assert np.sign(np.cross(column, -row)[axis]) == sign


def test_parts_read_back_with_their_names_and_floats(tmp_path):
    image = np.arange(12.0).reshape(3, 4) / 7
    write_parts(tmp_path / "a.exr", {"one": {"depth_mm": image}, "two": {"depth_mm": 2 * image}}, {"touch_mm": 0.5})
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as read:
        assert [part.name() for part in read.parts] == ["one", "two"]
        np.testing.assert_array_equal(read.parts[1].channels["depth_mm"].pixels, (2 * image).astype(np.float32))
        assert read.parts[0].header["touch_mm"] == 0.5


def test_a_coarse_mesh_stays_below_its_count_and_near_the_fine_one():
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = coarser(np.asarray(ball.vertices), np.asarray(ball.faces), 3000)
    assert 500 < len(faces) <= 3000
    assert np.abs(np.linalg.norm(vertices, axis=1) - 1).max() < 0.05  # of a radius; a cell is a twentieth


def test_the_strongest_contacts_of_a_frame_stay(make_run):
    links = {3: range(20), 5: [1]}
    force = np.concatenate([np.arange(20.0), [0.0]])
    run = make_run(8, contact_links=links, contact_force_n=force, contact_normal=np.tile([0, 0, 1.0], (21, 1)))
    found = strongest_contacts(run, np.array([0, 3, 5]))
    assert found["start"]["shape"] == [4] and found["point_m"]["shape"] == [16, 3]  # of 19 that push, and of none
