"""The graphic hand's own mesh against the object's true mesh. Formula: docs/metrics.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.eval.case import Case, NotMeasured
from palmar.eval.judge import graphic_poses, in_object_frame
from palmar.skin import HandMesh, posed_vertices

Array = NDArray[np.float64]

HELD = 400_000  # points at once, over some steps


def penetration_hand_mesh(case: Case) -> Array:
    """(n,) mm: deepest that a vertex, or middle of a face, of the hand's own mesh is inside the object's true mesh."""
    hand, run = case.pack.hand, case.run
    if hand.mesh is None:
        raise NotMeasured("the hand has no mesh of its own; `palmar fit-hand` gives it one")
    poses = graphic_poses(run)
    deepest = np.zeros(len(run.time_s))
    before: Array | None = None
    safe = np.zeros(len(hand.mesh.vertices_m) + len(hand.mesh.faces))
    block = max(1, HELD // len(safe))
    for start in range(0, len(deepest), block):
        part = poses[np.arange(start, min(start + block, len(deepest)))]
        points = _skin(
            hand.mesh, hand.joint_m, hand.flexion_axis, hand.abduction_axis, part.flexion_rad, part.abduction_rad
        )
        turn = Rotation.from_quat(np.roll(part.palm_rotation_wxyz, -1, axis=1)).as_matrix()
        world = np.einsum("nab,nkb->nka", turn, points) + part.palm_position_m[:, None]
        placed = in_object_frame(run, world, start)
        for k, now in enumerate(placed):
            # A point that was d outside stays outside until it has moved by d.
            safe -= 0 if before is None else np.sqrt(np.einsum("ka,ka->k", now - before, now - before))
            near = np.flatnonzero(safe <= 0)
            if len(near):
                distance = case.mesh.closest(now[near])[0]
                safe[near] = np.maximum(distance, 0)
                deepest[start + k] = max(0.0, -float(distance.min()))
            before = now
    return 1e3 * deepest


def penetration_hand_mesh_limit(case: Case) -> float | None:
    """mm: what the model of the object and that of the hand leave bare, and 0.1."""
    declared = case.model_error.get("gap_mm", {}).get("max")
    sweep = case.pack.hand.about.get("error", {}).get("sweep", {})
    if declared is None or not sweep:
        return None
    return 0.1 + declared + max(sweep[part]["gap_mm"]["max"] for part in ("palm", "phalanges"))


def _skin(mesh: HandMesh, *pose: Array) -> Array:
    """Vertices and middles of the faces (n, k, 3) in the palm frame."""
    vertices = posed_vertices(mesh, *pose)
    return np.concatenate([vertices, vertices[:, mesh.faces].mean(axis=2)], axis=1)
