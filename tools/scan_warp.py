"""A rigged hand bent, stretched and placed like a scan: its warp by 85 numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.model import HandModel
from palmar.skin import LINKS, link_motions
from palmar.tools.hand_quality import capsules_of

Array = NDArray[np.float64]

# The numbers of a warp: where and how large the palm is, then for each finger where it begins, how it is turned, bent
# and stretched. Scales as logarithms; those of phalanges, of thickness and of the palm's sides are over the scale of
# the whole hand. Metres and radians.
TURN, SHIFT, SCALE, PALM = slice(0, 3), slice(3, 6), 6, slice(7, 10)
OF_FINGERS, PER_FINGER = 10, 15
ROOT, ABDUCTION, TWIST, FLEXION = slice(0, 3), 3, 4, slice(5, 8)
LENGTH, THICK, FLAT = slice(8, 11), slice(11, 14), 14
COUNT = OF_FINGERS + 5 * PER_FINGER

LOOSE_RAD = np.radians(10)  # beyond the limits of flexion and abduction
# Farthest from the hand that is given.
LARGEST_SCALE, LARGEST_STRETCH, LARGEST_PALM, LARGEST_ROOT_M = 0.5, 0.35, 0.3, 0.02
LARGEST_TWIST_RAD = np.radians([60.0, 20.0, 20.0, 20.0, 20.0])  # a thumb's axes lie differently in every rig


@dataclass(frozen=True)
class Links:
    """Where the links of k warped hands are, in the scan's frame."""

    maps: Array  # (k, 16, 3, 4) affine, from the mesh
    chains: Array  # (k, 5, 4, 3) joints, and the skin at the fingertip
    flexion: Array  # (k, 5, 3, 3) axes


@dataclass(frozen=True)
class Warp:
    """A rigged hand with its mesh that is moved by the numbers of a warp (COUNT,)."""

    hand: HandModel
    tip_m: Array  # (5, 3) skin at the end of each finger, at the zero pose
    back_turn: Array  # (16, 3, 3) of each link: zero pose from the pose of the mesh
    back_shift: Array  # (16, 3)

    def links(self, numbers: Array) -> Links:
        """Of rows of numbers (k, COUNT)."""
        hand, k = self.hand, len(numbers)
        finger = numbers[:, OF_FINGERS:].reshape(k, 5, PER_FINGER)
        size = np.exp(numbers[:, SCALE, None])
        palm = size * np.exp(numbers[:, PALM])  # (k, 3)
        chain = np.concatenate([hand.joint_m, self.tip_m[:, None]], axis=1)
        bone = np.diff(chain, axis=1)
        along = bone / np.linalg.norm(bone, axis=2, keepdims=True)
        length = size[..., None] * np.exp(finger[..., LENGTH])  # (k, 5, 3)
        root = palm[:, None] * chain[:, 0] + size[..., None] * finger[..., ROOT]
        placed = np.cumsum(np.concatenate([root[:, :, None], length[..., None] * bone], axis=2), axis=2)
        stretch = self._stretch(along, length, size, finger)

        turn = np.empty((k, LINKS, 3, 3))
        start = np.empty((k, LINKS, 3))  # where each link's own joint is
        turn[:, 0], start[:, 0] = np.eye(3), 0
        for f in range(5):
            now = _turns(hand.abduction_axis[f], finger[:, f, ABDUCTION]) @ _turns(along[f, 0], finger[:, f, TWIST])
            at = placed[:, f, 0]
            for j in range(3):
                now = now @ _turns(hand.flexion_axis[f, j], finger[:, f, 5 + j])
                turn[:, 1 + 3 * f + j], start[:, 1 + 3 * f + j] = now, at
                at = at + np.einsum("kab,kb->ka", now, placed[:, f, j + 1] - placed[:, f, j])
        world = Rotation.from_rotvec(numbers[:, TURN]).as_matrix()
        turn = world[:, None] @ turn
        start = np.einsum("kab,klb->kla", world, start) + numbers[:, None, SHIFT]
        ends = start[:, 3::3] + np.einsum("kfab,kfb->kfa", turn[:, 3::3], placed[:, :, 3] - placed[:, :, 2])
        chains = np.concatenate([start[:, 1:].reshape(k, 5, 3, 3), ends[:, :, None]], axis=2)
        flexion = np.einsum("kfjab,fjb->kfja", turn[:, 1:].reshape(k, 5, 3, 3, 3), hand.flexion_axis)

        sides = palm[:, None, :, None] * np.eye(3)
        full = turn @ np.concatenate([sides, stretch.reshape(k, 15, 3, 3)], axis=1)
        own = np.concatenate([np.zeros((1, 3)), hand.joint_m.reshape(15, 3)])
        offset = start + np.einsum("klab,lb->kla", full, self.back_shift - own)
        return Links(np.concatenate([full @ self.back_turn, offset[..., None]], axis=3), chains, flexion)

    def _stretch(self, along: Array, length: Array, size: Array, finger: Array) -> Array:
        """(k, 5, 3, 3, 3): of each phalanx along its bone, across it and flat."""
        across = self.hand.flexion_axis - np.einsum("fja,fja->fj", self.hand.flexion_axis, along)[..., None] * along
        across = across / np.linalg.norm(across, axis=2, keepdims=True)
        deep = np.cross(along, across)
        thick, flat = size[..., None] * np.exp(finger[..., THICK]), finger[..., FLAT, None]
        scale = np.stack([length, thick * np.exp(flat), thick * np.exp(-flat)], axis=3)
        axes = np.stack([along, across, deep], axis=2)
        return np.einsum("kfjs,fjsa,fjsb->kfjab", scale, axes, axes)

    def vertices(self, numbers: Array) -> Array:
        """The mesh's vertices (v, 3) in the scan's frame, of one row of numbers (COUNT,)."""
        mesh = self.hand.mesh
        assert mesh is not None
        blended = (mesh.weights @ self.links(numbers[None]).maps[0].reshape(LINKS, 12)).reshape(-1, 3, 4)
        return np.einsum("vab,vb->va", blended[..., :3], mesh.vertices_m) + blended[..., 3]


def make_warp(hand: HandModel) -> Warp:
    """Of a hand that has a mesh."""
    assert hand.mesh is not None
    joints = (hand.joint_m, hand.flexion_axis, hand.abduction_axis)
    turn, shift = link_motions(*joints, hand.mesh.flexion_rad[None], np.zeros((1, 5)))
    back = turn[0].transpose(0, 2, 1)
    last = capsules_of(hand).reshape(5, 3, 8)[:, 2]
    ahead = last[:, 3:6] - last[:, :3]
    tip = last[:, 3:6] + last[:, 7:] * ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return Warp(hand, tip, back, -np.einsum("lab,lb->la", back, shift[0]))


def bounds_of(warp: Warp) -> tuple[Array, Array]:
    """Lowest and highest of each number."""
    high = np.full(COUNT, np.inf)
    high[SCALE], high[PALM] = LARGEST_SCALE, LARGEST_PALM
    finger = np.full((2, 5, PER_FINGER), LARGEST_STRETCH)
    finger[:, :, ROOT] = LARGEST_ROOT_M
    finger[:, :, TWIST] = LARGEST_TWIST_RAD
    finger[0] *= -1
    for k, sign in ((0, -1), (1, 1)):
        finger[k, :, ABDUCTION] = warp.hand.abduction_limit_rad[:, k] + sign * LOOSE_RAD
        finger[k, :, FLEXION] = warp.hand.flexion_limit_rad[..., k] + sign * LOOSE_RAD
    low = -high
    low[OF_FINGERS:], high[OF_FINGERS:] = finger.reshape(2, -1)
    return low, high


def _turns(axis: Array, angle: Array) -> Array:
    """Turns (k, 3, 3) about one axis."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * cross + (1 - np.cos(angle))[:, None, None] * (cross @ cross)
