"""Where a hand has to be to grasp an object of which only the spheres are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.model import HandModel
from palmar.profile import palm_axes
from palmar.traces.kinematics import Array, phalanges_in_palm

SEARCH_STEPS, CLOSING_STEPS = 9, 65  # closings tried between open and fist, to choose the side and to place the fingers
ANCHORS_M = (0.0, -0.02, -0.04)  # how far towards the wrist from the knuckles the object's middle may lie
FAR_ANCHORS_M = (0.02, 0.04)  # and before them, where the palm stays off the object
SEARCH_CELLS = 24  # the side is chosen with the largest leaf of each cell, so many cells along the object's diagonal


@dataclass(frozen=True)
class Closing:
    """How a hand closes and how hard it takes hold."""

    hand: HandModel
    opened_rad: Array  # (5, 3)
    fist_rad: Array  # (5, 3)
    abduction_rad: Array  # (5,)
    press_m: float  # palm into the leaves; below 0 off them
    squeeze_m: float  # deepest phalanx of a finger into the leaves


@dataclass(frozen=True)
class Grasp:
    """Palm pose, closed flexions, and the directions of the palm, in the object's frame."""

    position_m: Array  # (3,) pressed in
    rotation: Array  # (3, 3) object from palm
    flexion_rad: Array  # (5, 3)
    hold: Array  # (5,) how much of the squeeze the finger gets by closing: 0 none, 1 all, -1 it was in while open
    palmar: Array  # (3,) out of the palm's inner side
    distal: Array  # (3,) towards the fingertips
    radial: Array  # (3,) across the palm
    middle_m: Array  # (3,) middle of the palm


def place_grasp(closing: Closing, leaves: Array, vary_m: Array, vary_rad: Array) -> Grasp:
    """The grasp, along the axes of the object's box, in which most fingers get hold and wrap farthest round it.

    leaves: (n, 4) spheres; vary_m (2,) along the surface and vary_rad (3,) are added to the chosen one. Raises
    PalmarError E-CONF if the palm meets the object from no side.
    """
    few = _largest_of_cells(leaves)
    low, high = (leaves[:, :3] - leaves[:, 3:]).min(axis=0), (leaves[:, :3] + leaves[:, 3:]).max(axis=0)
    middle = 0.5 * (low + high)
    # A ring has nothing in its middle: its tube is the other thing to take hold of.
    nearest = few[np.argmin(((few[:, :3] - middle) ** 2).sum(axis=1)), :3]
    hollow = np.linalg.norm(nearest - middle) > 0.005  # metres; nearer than this the two grasps are one
    axes = palm_axes(closing.hand)
    best, best_score = None, -np.inf
    for object_from_axes in _box_rotations():
        for anchor_m in ANCHORS_M:
            for target in (middle, nearest) if hollow else (middle,):
                rotation = object_from_axes @ axes.T
                grasp = _grasp(closing, few, rotation, target, anchor_m, np.zeros(2), SEARCH_STEPS)
                if grasp is None:
                    continue
                way = np.abs(closing.fist_rad - closing.opened_rad).sum(1)
                reach = np.abs(grasp.flexion_rad - closing.opened_rad).sum(1) / np.maximum(way, 1e-9)
                score = float((grasp.hold * (1.0 + reach)).sum())
                # Only a clear gain replaces an earlier one, so that rounding cannot choose the side.
                if score > best_score + 1e-6:
                    best, best_score = (rotation, target, anchor_m), score
    if best is None:
        raise PalmarError(
            "E-CONF", "object", "the palm meets it from no side; an object with spheres near its middle is needed"
        )
    rotation, target, anchor_m = best
    turned = Rotation.from_rotvec(vary_rad).as_matrix() @ rotation
    grasp = _grasp(closing, leaves, turned, target, anchor_m, vary_m, CLOSING_STEPS)
    if grasp is None:
        # A thing smaller than the variation is passed by; the chosen grasp itself meets it.
        grasp = _grasp(closing, leaves, rotation, target, anchor_m, np.zeros(2), CLOSING_STEPS)
    assert grasp is not None
    return grasp


def _box_rotations() -> list[Array]:
    """The 24 ways to lay three axes along those of a box."""
    signed = [sign * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
    return [np.column_stack([a, b, np.cross(a, b)]) for a in signed for b in signed if a @ b == 0]


def _largest_of_cells(leaves: Array) -> Array:
    """The largest sphere of every cubic cell, in the order of the leaves."""
    low, high = leaves[:, :3].min(axis=0), leaves[:, :3].max(axis=0)
    cell_m = max(float(np.linalg.norm(high - low)) / SEARCH_CELLS, 1e-6)
    cell = np.floor((leaves[:, :3] - low) / cell_m).astype(np.int64)
    by_radius = np.argsort(-leaves[:, 3], kind="stable")
    _, first = np.unique(cell[by_radius], axis=0, return_index=True)
    return leaves[np.sort(by_radius[first])]


def _grasp(
    closing: Closing, leaves: Array, rotation: Array, target: Array, anchor_m: float, shift_m: Array, steps: int
) -> Grasp | None:
    """One grasp: the target under the anchor, the palm pressed on along its normal, the fingers closed."""
    hand = closing.hand
    palmar, distal, radial = (rotation @ palm_axes(hand)).T
    anchor = hand.joint_m[1:, 0].mean(axis=0) @ rotation.T + anchor_m * distal
    position = target - anchor + shift_m[0] * radial + shift_m[1] * distal
    travel_m = _travel(hand, leaves, rotation, position, palmar)
    if travel_m is None:
        return None
    position = position + (travel_m + closing.press_m) * palmar

    part = np.linspace(0.0, 1.0, steps)[:, None, None]
    flexions = closing.opened_rad + part * (closing.fist_rad - closing.opened_rad)
    phalanges = phalanges_in_palm(hand, flexions, np.tile(closing.abduction_rad, (steps, 1))) @ rotation.T + position
    depth = -_gap(phalanges, hand.phalanx_radius_m, leaves).min(axis=2)  # (steps, 5)
    deep = depth >= closing.squeeze_m
    moves = (closing.fist_rad != closing.opened_rad).any(axis=1)
    wraps = np.clip(depth.max(axis=0) / max(closing.squeeze_m, 1e-6), 0.0, 1.0)
    # A finger that does not close is in the way if it touches.
    hold = np.where(deep[0] | (~moves & (depth[0] > 0)), -1.0, np.where(moves, wraps, 0.0))
    # As deep as asked, else as deep as it gets, else a fist.
    reaches = np.where((depth > 0).any(axis=0), depth.argmax(axis=0), steps - 1)
    chosen = np.where(deep.any(axis=0), deep.argmax(axis=0), reaches)
    return Grasp(
        position_m=position,
        rotation=rotation,
        flexion_rad=flexions[chosen, np.arange(5)],
        hold=hold,
        palmar=palmar,
        distal=distal,
        radial=radial,
        middle_m=hand.palm_spheres_m[:, :3].mean(axis=0) @ rotation.T + position,
    )


def _travel(hand: HandModel, leaves: Array, rotation: Array, position: Array, palmar: Array) -> float | None:
    """How far along its normal the palm gets until a palm sphere touches a leaf, metres; None if it passes by."""
    balls = hand.palm_spheres_m[:, :3] @ rotation.T + position
    # Across the normal two coordinates are enough: |c_i - o_j|^2 there against (r_i + R_j)^2.
    across = np.linalg.svd(palmar[None])[2][1:].T
    apart2 = (((leaves[:, :3] @ across)[None] - (balls @ across)[:, None]) ** 2).sum(-1)
    reach2 = (leaves[None, :, 3] + hand.palm_spheres_m[:, None, 3]) ** 2
    i, j = np.nonzero(apart2 < reach2)
    if not i.size:
        return None
    along = (leaves[:, :3] @ palmar)[j] - (balls @ palmar)[i]
    return float((along - np.sqrt((reach2 - apart2)[i, j])).min())


def _gap(phalanges: Array, radius_m: Array, leaves: Array) -> Array:
    """Gap of a phalanx, as a capsule of mean radius, to the nearest leaf. (n, 5, 3, 2, 3) to (n, 5, 3) metres."""
    gap = np.empty(phalanges.shape[:3])
    for f, k in np.ndindex(5, 3):
        start, axis = phalanges[:, f, k, 0], phalanges[:, f, k, 1] - phalanges[:, f, k, 0]  # (n, 3)
        apart = leaves[:, :3] - start[:, None]  # (n, leaves, 3)
        along = np.clip(np.einsum("nli,ni->nl", apart, axis) / np.einsum("ni,ni->n", axis, axis)[:, None], 0.0, 1.0)
        apart -= along[..., None] * axis[:, None]
        off = np.sqrt(np.einsum("nli,nli->nl", apart, apart)) - leaves[:, 3]
        gap[:, f, k] = off.min(axis=1) - radius_m[f, k].mean()
    return gap
