"""The hand's own mesh, and how its links carry it: linear blend skinning over palm and fifteen phalanges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LINKS = 16


@dataclass(frozen=True)
class HandMesh:
    """The surface that a hand model was fitted to, closed at the wrist, in the palm frame. SI units."""

    vertices_m: Array  # (v, 3) at `flexion_rad`, all abductions zero
    faces: NDArray[np.int32]  # (f, 3) outward
    weights: Array  # (v, 16) share of each link, rows sum to 1
    flexion_rad: Array  # (5, 3) the angles that the mesh was modelled at

    @property
    def is_cap(self) -> NDArray[np.bool_]:
        """(f,) faces that only close the wrist: they lie in the plane y = 0."""
        return (np.abs(self.vertices_m[self.faces, 1]) < 1e-9).all(axis=1)


def link_motions(
    joint_m: Array, flexion_axis: Array, abduction_axis: Array, flexion_rad: Array, abduction_rad: Array
) -> tuple[Array, Array]:
    """Turn (n, 16, 3, 3) and shift (n, 16, 3) that carry points of each link from the zero pose, in the palm frame.

    joint_m, flexion_axis (5, 3, 3), abduction_axis (5, 3): a HandModel's; flexion_rad (n, 5, 3), abduction_rad (n, 5).
    """
    from scipy.spatial.transform import Rotation

    n = len(flexion_rad)
    turns = np.tile(np.eye(3), (n, LINKS, 1, 1))
    shifts = np.zeros((n, LINKS, 3))
    for f in range(5):
        turn = Rotation.from_rotvec(abduction_rad[:, f, None] * abduction_axis[f]).as_matrix()
        shift = joint_m[f, 0] - turn @ joint_m[f, 0]
        for j in range(3):
            bend = Rotation.from_rotvec(flexion_rad[:, f, j, None] * flexion_axis[f, j]).as_matrix()
            shift = shift + np.einsum("nab,nb->na", turn, joint_m[f, j] - bend @ joint_m[f, j])
            turn = turn @ bend
            turns[:, 1 + 3 * f + j], shifts[:, 1 + 3 * f + j] = turn, shift
    return turns, shifts


def posed_vertices(
    mesh: HandMesh,
    joint_m: Array,
    flexion_axis: Array,
    abduction_axis: Array,
    flexion_rad: Array,
    abduction_rad: Array,
) -> Array:
    """The mesh's vertices (n, v, 3) at n poses, in the palm frame. Arguments as of `link_motions`."""
    rest = link_motions(joint_m, flexion_axis, abduction_axis, mesh.flexion_rad[None], np.zeros((1, 5)))
    turn, shift = link_motions(joint_m, flexion_axis, abduction_axis, flexion_rad, abduction_rad)
    # From the pose of the mesh to the pose asked for, link by link.
    turn = turn @ rest[0].transpose(0, 1, 3, 2)
    shift = shift - np.einsum("nlab,lb->nla", turn, rest[1][0])
    blended = np.einsum("vl,nlab->nvab", mesh.weights, turn)
    return np.einsum("nvab,vb->nva", blended, mesh.vertices_m) + np.einsum("vl,nla->nva", mesh.weights, shift)
