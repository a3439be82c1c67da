"""A small hand, boxes, and runs made step by step for the tests of the judge and the metrics."""

import json

import numpy as np
import pytest

from palmar.model import AssetPack, HandModel, SphereTree
from palmar.records import Run
from palmar.tools.hierarchy import bounds_over

# A box from -20 to 20 mm: faces outward.
BOX = 0.02 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
BOX_FACES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    dtype=np.int32,
).reshape(12, 3)


@pytest.fixture
def hand():
    """Five straight fingers along y, 20 mm apart, phalanges of 30 mm, radii 8 to 6 mm; 4 palm spheres of 10 mm."""
    joint, phalanx = np.zeros((5, 3, 3)), np.zeros((5, 3, 2, 3))
    for f in range(5):
        for j in range(3):
            joint[f, j] = phalanx[f, j, 0] = [0.02 * (f - 2), 0.05 + 0.03 * j, 0]
            phalanx[f, j, 1] = phalanx[f, j, 0] + [0, 0.03, 0]
    return HandModel(
        palm_spheres_m=np.array([[x, y, 0, 0.01] for x in (-0.02, 0.02) for y in (0, 0.03)]),
        joint_m=joint,
        flexion_axis=np.tile([-1.0, 0, 0], (5, 3, 1)),
        abduction_axis=np.tile([0.0, 0, 1], (5, 1)),
        phalanx_m=phalanx,
        phalanx_radius_m=np.tile([[0.008, 0.0075], [0.0075, 0.007], [0.007, 0.006]], (5, 1, 1)),
        flexion_limit_rad=np.tile([-0.5, 2.0], (5, 3, 1)),
        abduction_limit_rad=np.tile([-0.5, 0.5], (5, 1)),
        joint_stiffness_n_m_per_rad=np.full((5, 3), 0.5),
        palm_stiffness_n_per_m=np.array([1000.0]),
        palm_rotation_stiffness_n_m_per_rad=np.array([10.0]),
    )


@pytest.fixture
def make_pack(hand):
    def make(leaves, vertices=BOX, faces=BOX_FACES, about=None):
        leaves = np.atleast_2d(np.asarray(leaves, dtype=float))
        figures = {
            "spheres": len(leaves),
            "protrusion_mm": {"max": 0.1, "p99": 0.05, "mean": 0.01},
            "gap_mm": {"max": 0.4, "p99": 0.2, "mean": 0.1},
            "normal_error_deg": {"median": 3.0, "p95": 9.0},
        }
        about = {"levels": [figures], "parameters": {"error_mm": 0.5}} | (about or {})
        tree = SphereTree([leaves], [bounds_over(leaves)], np.asarray(vertices), faces, about)
        return AssetPack(hand, {"thing": tree}, {})

    return make


@pytest.fixture
def make_run():
    """make(n, phases, contact_links={step: [links]}, **columns); haptic columns are the graphic ones unless given."""

    def make(n, phases=(), contact_links=None, header=None, **columns):
        def rest(*shape):
            return np.zeros((n, *shape))

        pose = {
            "palm_position_m": rest(3),
            "palm_rotation_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "flexion_rad": rest(5, 3),
            "abduction_rad": rest(5),
        }
        pose |= {name: columns.pop(name) for name in list(columns) if name in pose}
        links = [list((contact_links or {}).get(step, [])) for step in range(n)]
        count = sum(map(len, links))
        values = {
            "header": {"phases": json.dumps(list(phases))} | (header or {}),
            "time_s": 1e-3 * np.arange(n),
            "status": np.zeros(n, dtype=np.uint32),
            **pose,
            **{f"haptic_{name}": value.copy() for name, value in pose.items()},
            "object_position_m": rest(3),
            "object_rotation_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "palm_force_n": rest(3),
            "palm_torque_n_m": rest(3),
            "joint_torque_n_m": rest(5, 3),
            "fingertip_force_n": rest(5, 3),
            "equation14_force_n": rest(5, 3),
            "contacts": np.array([len(each) for each in links], dtype=np.uint32),
            "operations": np.zeros(n, dtype=np.uint32),
            "state_hash": np.zeros(n, dtype=np.uint64),
            **{name: np.full(n, 10.0) for name in ("cpu_us", "wall_us", "search_us", "solve_us", "verify_us")},
            "contact_start": np.concatenate([[0], np.cumsum([len(each) for each in links])]).astype(np.int64),
            "contact_link": np.array([link for each in links for link in each], dtype=np.uint8),
            "contact_object_sphere": np.zeros(count, dtype=np.uint32),
            "contact_palm_sphere": np.zeros(count, dtype=np.uint32),
            "contact_gap_m": np.zeros(count),
            "contact_force_n": np.zeros(count),
            "contact_point_m": np.zeros((count, 3)),
            "contact_normal": np.zeros((count, 3)),
        }
        return Run(**(values | columns))

    return make
