"""Shaded pictures of a hand at an object for print: graphic hand in skin colour, haptic hand in blue, as in the paper.

An orthographic view drawn by its nearest triangles, twice as fine as asked for and then averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from palmar.eval.judge import Poses, fingertips, palm_spheres, phalanx_capsules
from palmar.model import HandModel
from palmar.raster import find_hits, ranks
from palmar.skin import posed_vertices

Array = NDArray[np.float64]
Pixels = NDArray[np.int64]

SKIN, HAPTIC, OBJECT = (0.91, 0.70, 0.56), (0.20, 0.44, 0.88), (0.66, 0.70, 0.75)
FINER = 2
LIGHT = np.array([-0.35, 0.5, 0.8]) / np.linalg.norm([-0.35, 0.5, 0.8])  # right, up, towards the eye
IN_SIGHT, HIDDEN = 0.45, 0.22  # opacity of the haptic hand where it is in front, and where something hides it
CREASE_DEG = 30.0
LINE_M = 2.5e-3  # a step in depth that is drawn as a line


@dataclass(frozen=True)
class Body:
    """A surface with a unit normal (v, 3) at each vertex (v, 3) and a colour, of all or (v, 3) of each vertex."""

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array
    colour: tuple[float, float, float] | Array


@dataclass(frozen=True)
class Camera:
    """turn: rows right, up, towards the eye; the view is `across_m` wide and high about `middle`."""

    turn: Array
    middle: Array
    across_m: float

    def seen(self, points: Array, pixels: int) -> Array:
        """Column and row, from below, in an image of so many pixels a side, and height towards the eye in metres."""
        at = (points - self.middle) @ self.turn.T
        return np.concatenate([at[..., :2] * pixels / self.across_m + pixels / 2, at[..., 2:]], axis=-1)


def object_body(vertices_m: Array, faces: NDArray[np.integer], colour: tuple[float, float, float] = OBJECT) -> Body:
    """A mesh, smooth but at its creases."""
    mesh = trimesh.Trimesh(vertices_m, faces, process=False)
    smooth = trimesh.graph.smooth_shade(mesh, angle=np.radians(CREASE_DEG))
    return Body(np.asarray(smooth.vertices), np.asarray(smooth.faces), np.asarray(smooth.vertex_normals), colour)


def hand_body(hand: HandModel, pose: Poses, colour: tuple[float, float, float]) -> Body:
    """The hand at the first of the poses: its own mesh if it has one, else its capsules and palm spheres."""
    if hand.mesh is not None:
        at = (pose.flexion_rad[:1], pose.abduction_rad[:1])
        points = posed_vertices(hand.mesh, hand.joint_m, hand.flexion_axis, hand.abduction_axis, *at)[0]
        turn = trimesh.transformations.quaternion_matrix(pose.palm_rotation_wxyz[0])[:3, :3]
        mesh = trimesh.Trimesh(points @ turn.T + pose.palm_position_m[0], hand.mesh.faces, process=False)
        return Body(np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(mesh.vertex_normals), colour)
    points, faces, normals, _ = hand_parts(hand, pose)
    return Body(points, faces, normals, colour)


def hand_parts(hand: HandModel, pose: Poses) -> tuple[Array, NDArray[np.int64], Array, NDArray[np.int64]]:
    """The collision shape at the first of the poses without what is buried in the palm's balls.

    Points and normals, faces, and of each face the part: 0 to 14 the capsules, from 15 on the palm's balls.
    """
    c1, r1, c2, r2 = phalanx_capsules(hand, pose)
    balls = palm_spheres(hand, pose)[0]
    parts = [capsule(c1[0, k], r1[k], c2[0, k], r2[k]) for k in range(15)] + [ball(*sphere) for sphere in balls]
    points = np.concatenate([part[0] for part in parts])
    faces = np.concatenate([part[1] + len(points) // len(parts) * number for number, part in enumerate(parts)])
    in_sight = ~_is_buried(points, len(parts), balls)[faces].all(axis=1)
    owner = np.repeat(np.arange(len(parts)), [len(part[1]) for part in parts])
    return points, faces[in_sight], np.concatenate([part[2] for part in parts]), owner[in_sight]


def _is_buried(points: Array, parts: int, balls: Array) -> NDArray[np.bool_]:
    """Whether a point of a part, all parts with equally many, is deep in a ball (k, 4) of another: never to be seen."""
    owner = np.arange(len(points)) // (len(points) // parts) - (parts - len(balls))
    found = np.zeros(len(points), dtype=bool)
    for number, (*centre, radius) in enumerate(balls):
        found |= (np.linalg.norm(points - centre, axis=1) < 0.97 * radius) & (owner != number)
    return found


@lru_cache(maxsize=1)
def _unit_ball() -> tuple[Array, NDArray[np.int64]]:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def ball(x: float, y: float, z: float, radius: float) -> tuple[Array, NDArray[np.int64], Array]:
    points, faces = _unit_ball()
    return np.array([x, y, z]) + radius * points, faces, points


def capsule(c1: Array, r1: float, c2: Array, r2: float) -> tuple[Array, NDArray[np.int64], Array]:
    """The hull of two balls: points, faces, normals. Its normals are those of either ball, which part at a seam."""
    points, faces = _unit_ball()
    axis = c2 - c1
    length = np.linalg.norm(axis)
    far = points @ (axis / length) > (r1 - r2) / length
    return np.where(far[:, None], c2 + r2 * points, c1 + r1 * points), faces, points


def grasp_camera(hand: HandModel, poses: Poses, object_points: Array, upright: bool = False) -> Camera:
    """From the thumb's side, a little above the back of the hand: the profile of the grasp, and all of it in sight.

    The first pose says from where; what is in sight holds all of them and the object (v, 3). upright: the object's z is
    up rather than the back of the hand.
    """
    c1, _, c2, _ = phalanx_capsules(hand, poses)
    radial = c1[0, 3] - c1[0, 12]
    radial /= np.linalg.norm(radial)
    distal = c1[0, 6] - poses.palm_position_m[0]
    dorsal = np.cross(radial, distal)
    dorsal /= np.linalg.norm(dorsal)
    if (c2[0, 8] - c1[0, 6]) @ dorsal > 0:
        dorsal = -dorsal
    distal = distal / np.linalg.norm(distal)
    towards = 0.9 * radial + 0.15 * dorsal + 0.35 * distal
    towards /= np.linalg.norm(towards)
    right = np.cross(dorsal, towards)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(towards, right), towards])
    if upright and turn[1, 2] < 0:
        turn[:2] *= -1
    parts = (c1, c2, palm_spheres(hand, poses)[..., :3])
    every = np.concatenate([object_points, *(part.reshape(-1, 3) for part in parts)])
    flat = every @ turn.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    reach = max(float(hand.phalanx_radius_m.max()), float(hand.palm_spheres_m[:, 3].max()))
    across = 1.05 * float((high - low)[:2].max() + 2 * reach)
    return Camera(turn, turn.T @ ((low + high) / 2), across)


def draw(solid: Sequence[Body], ghost: Body | None, camera: Camera, pixels: int) -> Array:
    """Red, green, blue, opacity (pixels, pixels, 4), first row below: bodies, and a ghost that shines through them."""
    fine = pixels * FINER
    image, depth, owner = np.zeros((fine, fine, 4)), np.full((fine, fine), -np.inf), np.full((fine, fine), -1)
    for number, body in enumerate(solid):
        at, colour, height = _nearest(body, camera, fine)
        over = height > depth[at]
        at = at[0][over], at[1][over]
        image[*at, :3], image[*at, 3] = colour[over], 1.0
        depth[at], owner[at] = height[over], number
    lines = _lines(depth, owner)
    image[lines, :3] = 0.35 * image[lines, :3]
    image[lines, 3] = 1.0
    if ghost is not None:
        at, colour, height = _nearest(ghost, camera, fine)
        share = np.where(height > depth[at] + 2e-4, IN_SIGHT, np.where(owner[at] == 0, HIDDEN, 0.0))[:, None]
        share = np.where((depth[at] == -np.inf)[:, None], IN_SIGHT, share)
        under = image[at]
        opacity = share + under[:, 3:] * (1 - share)
        mixed = (share * colour + (1 - share) * under[:, 3:] * under[:, :3]) / np.maximum(opacity, 1e-9)
        image[*at, :3], image[*at, 3:] = mixed, opacity
    # Colours weighted by their opacity, so that an edge does not darken.
    parts = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], axis=2)
    parts = parts.reshape(pixels, FINER, pixels, FINER, 4).mean(axis=(1, 3))
    parts[..., :3] /= np.maximum(parts[..., 3:], 1e-9)
    return np.clip(parts, 0, 1)


def _nearest(body: Body, camera: Camera, pixels: int) -> tuple[tuple[Pixels, Pixels], Array, Array]:
    """Row and column of the pixels that the body covers, its shaded colour (n, 3) there, and its height (n,)."""
    corners = camera.seen(body.vertices, pixels)[body.faces]
    inside = ((corners[..., :2] > 0) & (corners[..., :2] < pixels)).all(axis=(1, 2))
    corners, faces = corners[inside], body.faces[inside]
    hits = find_hits(corners[:, :, :2])
    height = hits.of(corners[:, :, 2:])[:, 0]
    first = ranks(hits, height) == 0
    hits, height = hits.taken(first), height[first]
    normals = hits.of(body.normals[faces]) @ camera.turn.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    shade = 0.55 + 0.45 * np.clip(normals @ LIGHT, 0, 1)
    colour = np.broadcast_to(np.asarray(body.colour, dtype=np.float64), (len(body.vertices), 3))
    return (hits.row, hits.column), hits.of(colour[faces]) * shade[:, None], height


def _lines(depth: Array, owner: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels at the outline of a body, or where the depth steps."""
    found = np.zeros(depth.shape, dtype=bool)
    solid = np.where(np.isfinite(depth), depth, -1e3)
    for axis in (0, 1):
        near, far = (np.take(solid, range(k, depth.shape[axis] - 1 + k), axis) for k in (0, 1))
        step = np.abs(near - far) > LINE_M
        pad = [(0, 1) if k == axis else (0, 0) for k in (0, 1)]
        found |= np.pad(step & (near >= far), pad)
        found |= np.pad(step & (far > near), [p[::-1] for p in pad])
    return found & (owner >= 0)


def arrows(hand: HandModel, pose: Poses, force_n: Array, camera: Camera, mm_per_n: float) -> list[tuple[Array, Array]]:
    """Start and end of each fingertip's force (5, 3) in shares of the picture's side; none shorter than 2 mm."""
    tips = fingertips(hand, pose)[0]
    found = []
    for tip, force in zip(tips, force_n, strict=True):
        way = 1e-3 * mm_per_n * force
        if np.linalg.norm(way) > 2e-3:
            found.append((camera.seen(tip, 1)[:2], camera.seen(tip + way, 1)[:2]))
    return found
