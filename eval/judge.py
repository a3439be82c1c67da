"""The hand and its exact gaps once more, from docs/formats.md alone, sharing no code with the solver.

Every answer covers the exact shape: 15 tapered capsules and all palm spheres against all leaf spheres or the true mesh.
Steps and pairs are left out only where a bound proves that they cannot matter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmar.eval.gap import Flags, Mesh, capsule_mesh_gap, capsule_point_gap
from palmar.model import AssetPack, HandModel
from palmar.records import Run

Array = NDArray[np.float64]
STRIDES = (32, 4, 1)  # steps between judged steps; what lies between is skipped where a bound allows it
PAIRS = 100_000  # pairs held at once
FIRST_PAIRS = 32  # of a link, looked at before any other
BLOCK = 4096  # steps held at once
TOLERANCE_M = 2e-7  # of gaps to the mesh: 500 times below the paper's depth of 0.1 mm
SWEEP_M = 1e-3  # between the points of an axis that are followed from step to step


@dataclass(frozen=True)
class Poses:
    """n configurations of a hand, in the world."""

    palm_position_m: Array  # (n, 3)
    palm_rotation_wxyz: Array  # (n, 4)
    flexion_rad: Array  # (n, 5, 3)
    abduction_rad: Array  # (n, 5)

    def __getitem__(self, steps: slice | NDArray[np.integer]) -> Poses:
        return Poses(
            self.palm_position_m[steps],
            self.palm_rotation_wxyz[steps],
            self.flexion_rad[steps],
            self.abduction_rad[steps],
        )


def graphic_poses(run: Run) -> Poses:
    return Poses(run.palm_position_m, run.palm_rotation_wxyz, run.flexion_rad, run.abduction_rad)


def haptic_poses(run: Run) -> Poses:
    return Poses(
        run.haptic_palm_position_m, run.haptic_palm_rotation_wxyz, run.haptic_flexion_rad, run.haptic_abduction_rad
    )


@dataclass(frozen=True)
class Shape:
    """The exact shape of a hand over n steps, in one frame."""

    c1: Array  # (n, 15, 3) ends of the tapered capsules towards the palm
    r1: Array  # (15,)
    c2: Array  # (n, 15, 3) ends towards the tips
    r2: Array  # (15,)
    palm: Array  # (n, p, 3)
    palm_radius: Array  # (p,)

    def __getitem__(self, steps: slice | NDArray[np.integer]) -> Shape:
        return Shape(self.c1[steps], self.r1, self.c2[steps], self.r2, self.palm[steps], self.palm_radius)


def carried(before: Shape, after: Shape) -> tuple[Array, Array]:
    """Farthest that a point of each link is carried, step by step: phalanges (n, 15), palm spheres (n, p). Metres."""
    # A point inside is carried by a mean of what carries the two ends.
    phalanges = np.maximum(_norm(after.c1 - before.c1), _norm(after.c2 - before.c2))
    return phalanges, _norm(after.palm - before.palm)


def _norm(vectors: Array) -> Array:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _rotation(wxyz: Array) -> Array:
    return Rotation.from_quat(np.roll(wxyz, -1, axis=-1)).as_matrix()


def _phalanx_points(hand: HandModel, poses: Poses, points: Array) -> Array:
    """Points (5, 3, k, 3) fixed to each phalanx at the zero pose -> (n, 5, 3, k, 3) in the world."""
    placed = np.empty((len(poses.abduction_rad), *points.shape))
    for f in range(5):
        turn = Rotation.from_rotvec(poses.abduction_rad[:, f, None] * hand.abduction_axis[f]).as_matrix()
        shift = hand.joint_m[f, 0] - turn @ hand.joint_m[f, 0]
        for j in range(3):
            joint = hand.joint_m[f, j]
            flexion = Rotation.from_rotvec(poses.flexion_rad[:, f, j, None] * hand.flexion_axis[f, j]).as_matrix()
            shift = shift + np.einsum("nab,nb->na", turn, joint - flexion @ joint)
            turn = turn @ flexion
            placed[:, f, j] = np.einsum("nab,kb->nka", turn, points[f, j]) + shift[:, None]
    return palm_points(poses, placed)


def palm_points(poses: Poses, points: Array) -> Array:
    """Points (n, ..., 3) in the palm frame -> the same in the world."""
    position = poses.palm_position_m.reshape(len(points), *(1,) * (points.ndim - 2), 3)
    return np.einsum("nab,n...b->n...a", _rotation(poses.palm_rotation_wxyz), points) + position


def _capsules_at_rest(hand: HandModel) -> tuple[Array, Array]:
    """Centres (5, 3, 2, 3) and radii (5, 3, 2) of the two spheres of each tapered capsule, palm frame, zero pose."""
    d, e = hand.phalanx_m[:, :, 0], hand.phalanx_m[:, :, 1]
    length = _norm(e - d)[..., None]
    tan_phi = (hand.phalanx_radius_m[..., :1] - hand.phalanx_radius_m[..., 1:]) / length
    radii = hand.phalanx_radius_m * np.sqrt(1 + tan_phi**2)  # r / cos(phi)
    backwards = (d - e) / length
    centres = hand.phalanx_m + (hand.phalanx_radius_m * tan_phi)[..., None] * backwards[:, :, None]
    return centres, radii


def phalanx_capsules(hand: HandModel, poses: Poses) -> tuple[Array, Array, Array, Array]:
    """Tapered capsules in the world: c1 (n, 15, 3), r1 (15,), c2 (n, 15, 3), r2 (15,); 1 at the palm's side. Metres."""
    centres, radii = _capsules_at_rest(hand)
    placed = _phalanx_points(hand, poses, centres).reshape(-1, 15, 2, 3)
    radii = radii.reshape(15, 2)
    return placed[:, :, 0], radii[:, 0], placed[:, :, 1], radii[:, 1]


def palm_spheres(hand: HandModel, poses: Poses) -> Array:
    """Palm spheres in the world: (n, p, 4), x y z radius. Metres."""
    n = len(poses.abduction_rad)
    centres = palm_points(poses, np.broadcast_to(hand.palm_spheres_m[:, :3], (n, len(hand.palm_spheres_m), 3)))
    radii = np.broadcast_to(hand.palm_spheres_m[:, 3:], (*centres.shape[:2], 1))
    return np.concatenate([centres, radii], axis=2)


def fingertip_force(hand: HandModel, graphic: Poses, haptic: Poses) -> Array:
    """The paper's F_N at each fingertip: (n, 5, 3) newtons, world axes.

    Stiffness times the way from haptic to graphic fingertip across the distal phalanx of the graphic hand. A fingertip
    is the centre of the ball at the phalanx's end.
    """
    c1, _, c2, _ = phalanx_capsules(hand, graphic)
    c1, tip = c1[:, 2::3], c2[:, 2::3]
    axis = (tip - c1) / _norm(tip - c1)[..., None]
    way = tip - fingertips(hand, haptic)
    return hand.palm_stiffness_n_per_m * (way - np.einsum("nfi,nfi->nf", way, axis)[..., None] * axis)


def fingertips(hand: HandModel, poses: Poses) -> Array:
    """Centres of the balls at the ends of the five distal phalanges: (n, 5, 3) in the world, metres."""
    return phalanx_capsules(hand, poses)[2][:, 2::3]


def in_object_frame(run: Run, points: Array, first: int = 0) -> Array:
    """Points (n, k, 3) of the world in the object's frame of n steps of the run from `first` on."""
    steps = slice(first, first + len(points))
    return into_frame(run.object_rotation_wxyz[steps], run.object_position_m[steps], points)


def into_frame(rotation_wxyz: Array, position_m: Array, points: Array) -> Array:
    """Points (n, k, 3) of the world in frames that stand at position_m (n, 3), turned by rotation_wxyz (n, 4)."""
    return np.einsum("nab,nkb->nka", _rotation(rotation_wxyz).transpose(0, 2, 1), points - position_m[:, None])


def shape_in_object(hand: HandModel, poses: Poses, run: Run, steps: NDArray[np.integer] | None = None) -> Shape:
    """The hand's exact shape in the object's frame of each step of the run, or of those steps; a pose for each."""
    turn, place = run.object_rotation_wxyz, run.object_position_m
    if steps is not None:
        turn, place = turn[steps], place[steps]
    c1, r1, c2, r2 = phalanx_capsules(hand, poses)
    palm = palm_spheres(hand, poses)[..., :3]
    c1, c2, palm = (into_frame(turn, place, points) for points in (c1, c2, palm))
    return Shape(c1, r1, c2, r2, palm, hand.palm_spheres_m[:, 3])


# ---- against the leaf spheres


def sphere_gap(shape: Shape, leaves: Array, band_m: float = 1e-3, reach_m: float = 3e-3) -> Array:
    """Least signed gap of the whole hand to any leaf sphere, each step: (n,) metres; exact below band_m, else band_m.

    leaves: (m, 4) in the object's frame. A link is compared with the leaves within band + reach of it until it has
    moved by reach: until then every other leaf is farther than band. Of those only the ones that may be nearest count.
    """
    least = np.full(len(shape.c1), band_m)
    centres, radii = leaves[:, :3], leaves[:, 3]
    tree = cKDTree(centres)
    far = band_m + reach_m + radii.max()
    half = 0.5 * _norm(shape.c2[0] - shape.c1[0]) + np.maximum(shape.r1, shape.r2) if len(least) else np.zeros(15)

    for k in range(15):
        c1, c2, r1, r2 = shape.c1[:, k], shape.c2[:, k], shape.r1[k], shape.r2[k]
        ends = np.stack([c1, c2], axis=1)
        start = 0
        while start < len(least):
            near = np.array(tree.query_ball_point(0.5 * (c1[start] + c2[start]), half[k] + far), dtype=np.int64)
            gaps = capsule_point_gap(c1[start], r1, c2[start], r2, centres[near]) - radii[near]
            end = _until_moved(start, reach_m, ends)
            for at, pairs in _that_may_matter(least, gaps, ends, start, end):
                leaf = near[pairs]
                gap = capsule_point_gap(c1[at, None], r1, c2[at, None], r2, centres[leaf]) - radii[leaf]
                least[at] = np.minimum(least[at], gap.min(axis=1))
            start = end

    start = 0
    while start < len(least):
        near = tree.query_ball_point(shape.palm[start], shape.palm_radius + far)
        ball = np.repeat(np.arange(len(near)), [len(found) for found in near])
        leaf = np.array([i for found in near for i in found], dtype=np.int64)
        reach = shape.palm_radius[ball] + radii[leaf]
        gaps = _norm(shape.palm[start, ball] - centres[leaf]) - reach
        end = _until_moved(start, reach_m, shape.palm)
        for at, pairs in _that_may_matter(least, gaps, shape.palm, start, end):
            gap = _norm(shape.palm[at[:, None], ball[pairs]] - centres[leaf[pairs]]) - reach[pairs]
            least[at] = np.minimum(least[at], gap.min(axis=1))
        start = end
    return least


def _that_may_matter(
    least: Array, gaps: Array, points: Array, start: int, end: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Steps from start to end and pairs to look at together, the nearest pairs first; `least` may fall on the way.

    gaps: of the pairs at start. A pair whose link has moved by m since then has a gap of at least its first less m.
    """
    moved = _norm(points[start:end] - points[start]).max(axis=1)
    near = np.flatnonzero(gaps - moved.max() < least[start:end].max())
    nearest_first = near[np.argsort(gaps[near])]
    done, size = 0, FIRST_PAIRS
    while done < len(nearest_first):
        at = start + np.flatnonzero(gaps[nearest_first[done]] - moved < least[start:end])
        if not len(at):
            return
        pairs = nearest_first[done : done + size]
        rows = max(1, PAIRS // len(pairs))
        for i in range(0, len(at), rows):
            yield at[i : i + rows], pairs
        done, size = done + size, 2 * size


def _until_moved(start: int, reach: float, points: Array) -> int:
    """First step after start, at most 500 on, by which any of the points (n, k, 3) has left its place by over reach."""
    over: Flags = (_norm(points[start : start + 500] - points[start]) > reach).any(axis=1)
    return start + (int(np.argmax(over)) if over.any() else len(over))


def penetration_spheres(pack: AssetPack, run: Run, object_name: str) -> Array:
    """Deepest overlap of the graphic hand with any leaf sphere, each step: (n,) metres, 0 where there is none."""
    shape = shape_in_object(pack.hand, graphic_poses(run), run)
    return np.maximum(0, -sphere_gap(shape, pack.objects[object_name].leaves))


# ---- against the true mesh


def mesh_gap(shape: Shape, mesh: Mesh, band_m: float = 0.0, tolerance_m: float = TOLERANCE_M) -> tuple[Array, Array]:
    """Least of signed distance - radius over each link: phalanges (n, 15) and palm spheres (n, p), metres.

    Exact to tolerance_m where below band_m, else band_m. A link with gap g that moved by m has a gap of at least g - m.
    """
    blocks = [
        _mesh_gap_of_block(shape[i : i + BLOCK], mesh, band_m, tolerance_m) for i in range(0, len(shape.c1), BLOCK)
    ]
    gap = np.concatenate(blocks) if blocks else np.zeros((0, 15 + len(shape.palm_radius)))
    return gap[:, :15], gap[:, 15:]


def _mesh_gap_of_block(shape: Shape, mesh: Mesh, band: float, tolerance: float) -> Array:
    n, p = len(shape.c1), len(shape.palm_radius)
    low = np.full((n, 15 + p), -np.inf)
    gap = np.full((n, 15 + p), np.inf)
    steps = np.arange(n)
    for stride in STRIDES:
        sampled = steps[::stride]
        at, link = np.nonzero((low[sampled] < band) & np.isinf(gap[sampled]))
        at = sampled[at]
        bone = link < 15
        i, k = at[bone], link[bone]
        # A little room above the band lets one sample speak for its neighbours.
        room = band + (0 if stride == 1 else 1e-4 * stride)
        gap[i, k], low[i, k] = capsule_mesh_gap(
            mesh, shape.c1[i, k], shape.r1[k], shape.c2[i, k], shape.r2[k], room, tolerance
        )
        i, k = at[~bone], link[~bone] - 15
        gap[i, 15 + k] = low[i, 15 + k] = mesh.closest(shape.palm[i, k])[0] - shape.palm_radius[k]
        if stride > 1:
            for near in (steps // stride * stride, np.minimum(-(-steps // stride) * stride, sampled[-1])):
                low = np.maximum(low, low[near] - np.hstack(carried(shape[near], shape)))
    return np.where(low < band, np.minimum(gap, band), band)


def penetration_mesh(pack: AssetPack, run: Run, object_name: str) -> Array:
    """Deepest that the graphic hand is inside the true mesh, each step: (n,) metres, 0 where it is outside.

    Depth is the largest r - signed distance over the balls that make up the hand.
    """
    tree = pack.objects[object_name]
    shape = shape_in_object(pack.hand, graphic_poses(run), run)
    phalanges, palm = mesh_gap(shape, Mesh(tree.vertices_m, tree.faces))
    return np.maximum(0, -np.hstack([phalanges, palm]).min(axis=1))


def gap_to_mesh(shape: Shape, mesh: Mesh, asked: Flags, tolerance_m: float = TOLERANCE_M) -> Array:
    """Signed gap of the phalanges asked for, (n, 15) of them, to the true mesh: (n, 15) metres, NaN where not asked."""
    gap = np.full(asked.shape, np.nan)
    i, k = np.nonzero(asked)
    gap[i, k] = capsule_mesh_gap(mesh, shape.c1[i, k], shape.r1[k], shape.c2[i, k], shape.r2[k], np.inf, tolerance_m)[0]
    return gap


def wrong_side(shape: Shape, mesh: Mesh, phalanx_gap: Array, palm_gap: Array) -> Flags:
    """Steps in which a link's axis is inside the true mesh or went through it since the step before: (n,).

    The axis of a palm sphere is its centre. phalanx_gap, palm_gap: of `mesh_gap`. Axes are followed by
    points at most SWEEP_M apart on straight paths. An axis farther from the surface than it moved cannot go through it.
    """
    least_radius = np.minimum(shape.r1, shape.r2)
    wrong = np.zeros(len(shape.c1), dtype=np.bool_)
    wrong |= (palm_gap < -shape.palm_radius).any(axis=1)

    i, k = np.nonzero(phalanx_gap < -least_radius)
    wrong[i[_touches_inside(mesh, shape.c1[i, k], shape.c2[i, k])]] = True

    moved, palm_moved = carried(shape[:-1], shape[1:])
    for link in range(15):
        at = np.flatnonzero((moved[:, link] >= phalanx_gap[:-1, link] + least_radius[link]) & ~wrong[1:])
        if len(at):
            along = np.linspace(0, 1, 1 + int(np.ceil(_norm(shape.c2[0, link] - shape.c1[0, link]) / SWEEP_M)))[:, None]
            before, after = (
                (1 - along) * shape.c1[t, link, None] + along * shape.c2[t, link, None] for t in (at, at + 1)
            )
            crossed = _touches_inside(mesh, before.reshape(-1, 3), after.reshape(-1, 3)).reshape(len(at), -1)
            wrong[at[crossed.any(axis=1)] + 1] = True
    i, k = np.nonzero((palm_moved >= palm_gap[:-1] + shape.palm_radius) & ~wrong[1:, None])
    wrong[i[_touches_inside(mesh, shape.palm[i, k], shape.palm[i + 1, k])] + 1] = True
    return wrong


def _touches_inside(mesh: Mesh, start: Array, end: Array) -> Flags:
    """Whether each segment (k, 3) to (k, 3) has a point inside; a part thinner than TOLERANCE_M may go unseen."""
    none = np.zeros(len(start))
    return capsule_mesh_gap(mesh, start, none, end, none, 0.0, TOLERANCE_M, enough_m=0.0)[0] < 0
