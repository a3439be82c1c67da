"""The hand's own mesh against a true mesh: every step's depth is that of all its points, and no mesh is no number."""

from dataclasses import replace

import numpy as np
import pytest

from palmar.eval import hand_mesh
from palmar.eval.case import Case, NotMeasured
from palmar.eval.hand_mesh import penetration_hand_mesh
from palmar.skin import HandMesh, posed_vertices

HALF_M = 0.02  # of the box that is the object
BOX = HALF_M * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
BOX_FACES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    dtype=np.int32,
).reshape(12, 3)


@pytest.fixture
def meshed(hand):
    """A block of 10 mm on the index's tip, its base blended with the phalanx before, and one in the palm."""
    corners, faces = 0.25 * BOX, BOX_FACES
    vertices = np.vstack([corners + np.array([-0.02, 0.13, 0]), corners + np.array([0, 0.02, 0])])
    weights = np.eye(16)[[6] * 8 + [0] * 8]
    weights[:2, 5:7] = 0.5
    mesh = HandMesh(vertices, np.vstack([faces, faces + 8]), weights, np.full((5, 3), 0.1))
    return replace(hand, mesh=mesh)


def test_depth_is_that_of_every_point_at_every_step(meshed, make_pack, make_run, monkeypatch):
    monkeypatch.setattr(hand_mesh, "HELD", 10_000)  # 250 steps
    n = 600
    time = np.linspace(0, 2 * np.pi, n)
    run = make_run(
        n,
        palm_position_m=np.stack(
            [0.02 + 0.01 * np.sin(time), -0.11 + 0 * time, 0.02 + 0.03 * np.cos(3 * time)], axis=1
        ),
        flexion_rad=0.4 + 0.4 * np.sin(2 * time)[:, None, None] * np.ones((1, 5, 3)),
    )
    pack = replace(make_pack([0, 0, 0, 0.02]), hand=meshed)
    found = penetration_hand_mesh(Case(run, pack, "thing"))
    joints = (meshed.joint_m, meshed.flexion_axis, meshed.abduction_axis)
    vertices = posed_vertices(meshed.mesh, *joints, run.flexion_rad, run.abduction_rad)
    points = np.concatenate([vertices, vertices[:, meshed.mesh.faces].mean(axis=2)], axis=1)
    points = points + run.palm_position_m[:, None]
    inside = (HALF_M - np.abs(points).max(axis=2)).max(axis=1)
    # mm; rounding of distances of 0.1 m.
    np.testing.assert_allclose(found, 1e3 * np.maximum(inside, 0), rtol=0, atol=1e-10)
    assert found.max() > 1 and found.min() == 0


def test_a_hand_without_a_mesh_is_not_measured(make_pack, make_run):
    with pytest.raises(NotMeasured, match="fit-hand"):
        penetration_hand_mesh(Case(make_run(2), make_pack([0, 0, 0, 0.02]), "thing"))
