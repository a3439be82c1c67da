"""A hand and objects that need no file; the hand is the reference hand of the shared scenarios, in numbers."""

from pathlib import Path

import numpy as np
import pytest

from palmar.model import AssetPack, HandModel, SphereTree, save_pack
from palmar.records import Trace
from palmar.tools.hierarchy import bounds_over

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.exists():
        pytest.skip("the shared recordings are not beside this checkout")
    return SHARED


@pytest.fixture(scope="session")
def hand() -> HandModel:
    along = np.array([0.70, 0.62, -0.35]) / np.linalg.norm([0.70, 0.62, -0.35])
    thumb_axis = np.cross(along, [-0.75, 0.15, -0.65])
    thumb_axis /= np.linalg.norm(thumb_axis)
    base = np.array([[28, 22, -6], [28, 88, 0], [9.5, 92, 0], [-9.5, 87, 0], [-28, 78, 0]]) * 1e-3
    length = np.array([[44, 34, 27], [42, 25, 22], [46, 29, 23], [42, 27, 23], [33, 20, 20]]) * 1e-3
    radius = np.array([[11, 10, 8.5], [9, 8, 7], [9, 8, 7], [9, 8, 7], [8, 7, 6]]) * 1e-3
    direction = np.array([along, *[[0.0, 1.0, 0.0]] * 4])
    axis = np.array([thumb_axis, *[[-1.0, 0.0, 0.0]] * 4])
    start = np.concatenate([np.zeros((5, 1)), np.cumsum(length, axis=1)], axis=1)
    points = base[:, None] + start[:, :, None] * direction[:, None]
    x, y = np.meshgrid(np.linspace(-36, 36, 9), np.linspace(4, 84, 11))
    palm = np.column_stack([x.ravel(), y.ravel(), np.zeros(99), np.full(99, 11.0)]) * 1e-3
    return HandModel(
        palm_spheres_m=palm,
        joint_m=points[:, :3],
        flexion_axis=np.repeat(axis[:, None], 3, axis=1),
        abduction_axis=np.cross(axis, direction),
        phalanx_m=np.stack([points[:, :3], points[:, 1:]], axis=2),
        phalanx_radius_m=np.repeat(radius[:, :, None], 2, axis=2),
        flexion_limit_rad=np.tile([-0.2, 1.8], (5, 3, 1)),
        abduction_limit_rad=np.tile([-0.4, 0.4], (5, 1)),
        joint_stiffness_n_m_per_rad=np.full((5, 3), 0.5),
        palm_stiffness_n_per_m=np.array([1000.0]),
        palm_rotation_stiffness_n_m_per_rad=np.array([0.5]),
        about={"name": "reference", "side": "right"},
    )


@pytest.fixture(scope="session")
def trees() -> dict[str, SphereTree]:
    """A rod of 30 mm, a ball of 70 mm, a ring of 20 mm round a hole of 80 mm, a marble of 6 mm far from the origin."""
    z, turn = np.linspace(-0.085, 0.085, 40), np.linspace(0, 2 * np.pi, 80, endpoint=False)
    spheres = {
        "rod": np.column_stack([0 * z, 0 * z, z, np.full(40, 0.015)]),
        "ball": np.array([[0.0, 0.0, 0.0, 0.035]]),
        "ring": np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), 0 * turn, np.full(80, 0.01)]),
        "marble": np.array([[0.3, -0.2, 0.1, 0.003]]),
    }
    return {
        name: SphereTree([s], [bounds_over(s)], s[:, :3], np.zeros((0, 3), dtype=np.int32))
        for name, s in spheres.items()
    }


@pytest.fixture(scope="session")
def moving(hand: HandModel) -> Trace:
    """Two seconds at 200 Hz of a hand that closes and opens while its palm goes to and fro."""
    time_s = np.arange(400) / 200
    closed = 0.5 - 0.5 * np.cos(2 * np.pi * time_s)
    return Trace(
        header={"device": "script", "hand": "reference", "side": "right", "rate_hz": "200"},
        time_s=time_s,
        palm_position_m=0.1 * np.stack([np.sin(time_s), np.cos(time_s), 0 * time_s], axis=1),
        palm_rotation_wxyz=np.stack([np.cos(closed), 0 * closed, 0 * closed, np.sin(closed)], axis=1),
        flexion_rad=closed[:, None, None] * np.array([1.0, 1.1, 0.7]) * np.ones((5, 1)),
        abduction_rad=0.3 * np.sin(2 * np.pi * time_s)[:, None] * np.ones(5),
        tracked=np.ones(400, dtype=bool),
        has_object_pose=np.zeros(400, dtype=bool),
        object_position_m=np.zeros((400, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (400, 1)),
    )


@pytest.fixture(scope="session")
def ball_pack(hand: HandModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball in front of the palm of a hand that stands at the origin, where its fingers close."""
    ball = np.array([[0.0, 0.06, -0.045, 0.03]])
    corners = 0.03 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]]) + ball[:, :3]
    about = {"levels": [{"spheres": 1}]}
    tree = SphereTree([ball], [bounds_over(ball)], corners, np.zeros((0, 3), dtype=np.int32), about)
    path = tmp_path_factory.mktemp("pack") / "ball.pack"
    save_pack(path, AssetPack(hand, {"ball": tree}, {}))
    return path
