"""Where a hand touches: how deep and for how long, at points of the object's surface and at points of the hand's own.

What a step adds is found at steps that are spread evenly over the run, and at those where the judge saw the deepest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palmar.eval.gap import Mesh, capsule_point_gap
from palmar.eval.judge import Poses, Shape, into_frame, palm_points
from palmar.model import HandModel
from palmar.records import Run
from palmar.skin import link_motions

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TOUCH_M = 5e-4  # nearer than this counts as contact: what sphere models of this project leave between hand and mesh
BLOCK = 10  # steps at once
OBJECT_STEPS, HAND_STEPS = 1200, 600  # that are looked at
DEEPEST_STEPS = 100


@dataclass(frozen=True)
class Touched:
    """At each of k points: the deepest it was inside the other body, and how long it touched."""

    depth_m: Array  # (k,)
    contact_s: Array  # (k,)
    steps: Ints  # that were looked at
    stride: int  # how far they are apart


def spread_steps(run: Run, most: int, depth: Array | None) -> tuple[Ints, Array, int]:
    """Steps to look at, the seconds that each stands for (0: none, it is among them for its depth), their stride."""
    count = len(run.time_s)
    stride = -(-count // most)
    even = np.arange(0, count, stride)
    deepest = np.zeros(0, dtype=np.int64)
    if depth is not None and stride > 1:
        order = np.argsort(-np.nan_to_num(depth), kind="stable")[:DEEPEST_STEPS]
        deepest = order[np.nan_to_num(depth)[order] > 0]
    steps = np.union1d(even, deepest)
    ends = np.append(run.time_s[even[1:]], run.time_s[-1] + (np.median(np.diff(run.time_s)) if count > 1 else 1e-3))
    seconds = np.zeros(len(steps))
    seconds[np.searchsorted(steps, even)] = ends - run.time_s[even]
    return steps, seconds, stride


def touch_object(shape: Shape, points: Array, seconds: Array) -> tuple[Array, Array]:
    """Deepest that points (k, 3) of the object are inside the hand over n steps, m, and how long it touches them, s.

    shape: the hand at those steps in the object's frame; seconds (n,): the time that each step stands for.
    """
    depth, contact = np.zeros(len(points)), np.zeros(len(points))
    tree = cKDTree(points)
    links = [(shape.c1[:, k], shape.r1[k], shape.c2[:, k], shape.r2[k]) for k in range(15)]
    links += [(shape.palm[:, k], r, shape.palm[:, k], r) for k, r in enumerate(shape.palm_radius)]
    for start in range(0, len(seconds), BLOCK):
        at = slice(start, start + BLOCK)
        touches = np.zeros((len(seconds[at]), len(points)), dtype=bool)
        for c1, r1, c2, r2 in links:
            a, b = c1[at], c2[at]
            moved = max(np.linalg.norm(a - a[0], axis=1).max(), np.linalg.norm(b - b[0], axis=1).max())
            reach = 0.5 * np.linalg.norm(b[0] - a[0]) + max(r1, r2) + TOUCH_M + moved
            near = np.array(tree.query_ball_point(0.5 * (a[0] + b[0]), reach), dtype=np.int64)
            if len(near):
                near = near[capsule_point_gap(a[0], r1, b[0], r2, points[near]) < TOUCH_M + moved]
            if not len(near):
                continue
            gap = capsule_point_gap(a[:, None], r1, b[:, None], r2, points[near])
            depth[near] = np.maximum(depth[near], -gap.min(axis=0))
            touches[:, near] |= gap < TOUCH_M
        contact += seconds[at] @ touches
    return depth, contact


def touch_hand(
    hand: HandModel, poses: Poses, frames: tuple[Array, Array], mesh: Mesh, skin: tuple[Array, Ints], seconds: Array
) -> tuple[Array, Array]:
    """Deepest that points fixed to the hand's links are inside the mesh over n steps, m, and how long they touch, s.

    frames: rotation (n, 4) and place (n, 3) of the object. skin: points (k, 3) in the palm frame at the zero pose, link
    (k,) of each, 0 the palm.
    """
    points, link = skin
    depth, contact, safe = np.zeros(len(points)), np.zeros(len(points)), np.zeros(len(points))
    before: Array | None = None
    order = np.argsort(link, kind="stable")
    parts = np.split(order, np.searchsorted(link[order], np.arange(1, 16)))
    for start in range(0, len(seconds), BLOCK):
        at = np.arange(start, min(start + BLOCK, len(seconds)))
        some = poses[at]
        turn, shift = link_motions(
            hand.joint_m, hand.flexion_axis, hand.abduction_axis, some.flexion_rad, some.abduction_rad
        )
        placed = np.empty((len(at), *points.shape))
        for k, own in enumerate(parts):
            placed[:, own] = np.einsum("nab,kb->nka", turn[:, k], points[own]) + shift[:, k, None]
        placed = into_frame(frames[0][at], frames[1][at], palm_points(some, placed))
        for now, lasts in zip(placed, seconds[at], strict=True):
            # A point that was d outside stays outside until it has moved by d.
            safe -= 0 if before is None else np.linalg.norm(now - before, axis=1)
            near = np.flatnonzero(safe <= TOUCH_M)
            if len(near):
                distance = mesh.closest(now[near])[0]
                safe[near] = distance
                depth[near] = np.maximum(depth[near], -distance)
                contact[near] += lasts * (distance < TOUCH_M)
            before = now
    return depth, contact
