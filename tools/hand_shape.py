"""A hand mesh at one pose: even skin points, which link each belongs to, and which of them the air touches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palmar.model import HandModel
from palmar.skin import HandMesh, link_motions, posed_vertices
from palmar.tools.solid import Solid, is_inside, make_solid, morton_order
from palmar.tools.surface import spread

Array = NDArray[np.float64]

LIFT_M = 2e-4  # a point this far above its face and still inside the mesh lies in a fold


@dataclass(frozen=True)
class SkinPoints:
    """Points on the triangles of a hand mesh, the same ones at every pose."""

    mesh: HandMesh
    face: NDArray[np.int64]  # (n,)
    mix: Array  # (n, 3) of the face's corners
    area_m2: Array  # (n,) at the mesh's own pose
    link: NDArray[np.int64]  # (n,) the one with the largest share
    real: NDArray[np.bool_]  # (n,) not on the cap that closes the wrist


@dataclass(frozen=True)
class PosedHand:
    """A hand mesh and where its links are, at one pose, in the palm frame."""

    solid: Solid
    points_m: Array  # (n, 3)
    open_air: NDArray[np.bool_]  # (n,) false in folds
    turn: Array  # (16, 3, 3) palm from the zero pose of each link
    shift: Array  # (16, 3)

    def local(self, link: int, points: Array) -> Array:
        """Points (k, 3) of the palm frame at the zero pose of a link."""
        return (points - self.shift[link]) @ self.turn[link]


def skin_points(mesh: HandMesh, spacing_m: float) -> SkinPoints:
    """About one point for each spacing^2 and, on a coarse mesh, at least one on each face."""
    face, mix, area = spread(mesh.vertices_m, mesh.faces, spacing_m)
    wanted = int(area.sum() / spacing_m**2)
    if len(mesh.faces) > 2 * wanted:
        picked = _evenly(mesh.vertices_m[mesh.faces].mean(axis=1)[face], area, 2 * wanted)
        face, mix, area = face[picked], mix[picked], np.full(len(picked), area.sum() / len(picked))
    return replace(points_at(mesh, face, mix), area_m2=area)


def points_at(mesh: HandMesh, face: NDArray[np.int64], mix: Array) -> SkinPoints:
    """Points at barycentric coordinates (n, 3) of faces (n,), each with area 1."""
    shares = np.einsum("nk,nkl->nl", mix, mesh.weights[mesh.faces[face]])
    return SkinPoints(mesh, face, mix, np.ones(len(face)), shares.argmax(axis=1), ~mesh.is_cap[face])


def _evenly(points: Array, area: Array, count: int) -> NDArray[np.intp]:
    """So many of the points, each for the same area, one after the other along a space-filling curve."""
    order = morton_order(points)
    ends = np.cumsum(area[order])
    at = (np.arange(count) + 0.5) * ends[-1] / count
    return order[np.minimum(np.searchsorted(ends, at), len(order) - 1)]


def pose_hand(skin: SkinPoints, hand: HandModel, flexion_rad: Array) -> PosedHand:
    """Bend the mesh by the hand's own joints. flexion_rad: (5, 3)."""
    joints = (hand.joint_m, hand.flexion_axis, hand.abduction_axis)
    asked = (flexion_rad[None], np.zeros((1, 5)))
    vertices = posed_vertices(skin.mesh, *joints, *asked)[0]
    turn, shift = link_motions(*joints, *asked)
    solid = make_solid(vertices, skin.mesh.faces)
    points = np.einsum("nk,nka->na", skin.mix, vertices[skin.mesh.faces[skin.face]])
    above = points + LIFT_M * solid.normals[skin.face]
    return PosedHand(solid, points, ~is_inside(solid, above), turn[0], shift[0])


def sweep_angles(hand: HandModel, degrees: float) -> Array:
    """All flexions (5, 3) at so many degrees, each within its limits."""
    low, high = hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1]
    return np.clip(np.full((5, 3), np.radians(degrees)), low, high)
