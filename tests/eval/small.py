"""A small hand and one-object packs, for tests of the judge and the metrics."""

import numpy as np

from palmar.model import AssetPack, HandModel, SphereTree
from palmar.tools.hierarchy import bounds_over

# A box from -20 to 20 mm: faces outward.
BOX = 0.02 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
BOX_FACES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    dtype=np.int32,
).reshape(12, 3)


def small_hand():
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


def small_pack(hand, leaves, vertices=BOX, faces=BOX_FACES, about=None):
    """The object `thing` of these spheres, a box unless it has another mesh."""
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
