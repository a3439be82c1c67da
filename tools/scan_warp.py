"""A rigged hand bent, stretched and placed like a scan: its warp by 55 numbers, fitted to landmarks and to points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmar.model import HandModel
from palmar.skin import LINKS, link_motions
from palmar.tools.hand_quality import capsules_of
from palmar.tools.surface import spread

Array = NDArray[np.float64]

# The numbers of a warp: where and how large the palm is, then for each finger how it is bent and stretched. Scales as
# logarithms; those of phalanges, of thickness and of the palm's sides are over the scale of the whole hand.
TURN, SHIFT, SCALE, PALM = slice(0, 3), slice(3, 6), 6, slice(7, 10)
PER_FINGER = 9
ABDUCTION, FLEXION, LENGTH, THICK = 0, slice(1, 4), slice(4, 7), slice(7, 9)
COUNT = 10 + 5 * PER_FINGER

SPACING_M = 3.5e-3  # between the points of the rigged hand that are matched
NEIGHBOURS = 6  # of a point, among which the nearest with a like normal is taken
ALIKE = 0.6  # cosine between normals
GATES_M = (0.012, 0.008, 0.006, 0.005, 0.004, 0.004, 0.003, 0.003)  # farthest match, round by round
KERNEL_M = 5e-4  # beyond it a match pulls less
LOOSE_RAD = np.radians(10)  # beyond the limits of flexion and abduction
USUAL = 0.02  # spread of the proportions of hands; ties what the points do not tell
WEIGHT_OF_USUAL = 5.0


@dataclass(frozen=True)
class Warp:
    """A rigged hand with its mesh that is moved by the numbers of a warp (COUNT,)."""

    hand: HandModel
    tip_m: Array  # (5, 3) skin at the end of each finger, at the zero pose
    back_turn: Array  # (16, 3, 3) of each link: zero pose from the pose of the mesh
    back_shift: Array  # (16, 3)

    def links(self, numbers: Array) -> tuple[Array, Array, Array, Array]:
        """Affine maps (16, 3, 3), (16, 3) from the mesh to the scan's frame, chains (5, 4, 3) and axes (5, 3, 3)."""
        hand, finger = self.hand, numbers[10:].reshape(5, PER_FINGER)
        size = np.exp(numbers[SCALE])
        palm = size * np.exp(numbers[PALM])
        chain = np.concatenate([hand.joint_m, self.tip_m[:, None]], axis=1)
        bone = np.diff(chain, axis=1)
        stretched = size * np.exp(finger[:, LENGTH])[..., None] * bone
        placed = np.cumsum(np.concatenate([palm * chain[:, :1], stretched], axis=1), axis=1)
        axes = (placed[:, :3], hand.flexion_axis, hand.abduction_axis)
        turn, shift = (part[0] for part in link_motions(*axes, finger[None, :, FLEXION], finger[None, :, ABDUCTION]))
        along = bone / np.linalg.norm(bone, axis=2, keepdims=True)
        thick = size * np.exp(np.stack([finger[:, 7], finger[:, 7:].mean(axis=1), finger[:, 8]], axis=1))
        length = size * np.exp(finger[:, LENGTH])
        stretch = thick[..., None, None] * np.eye(3) + (length - thick)[..., None, None] * (
            along[..., :, None] * along[..., None, :]
        )
        scale = np.concatenate([np.diag(palm)[None], stretch.reshape(15, 3, 3)])
        move = np.concatenate(
            [np.zeros((1, 3)), (placed[:, :3] - np.einsum("fjab,fjb->fja", stretch, chain[:, :3])).reshape(15, 3)]
        )
        world = Rotation.from_rotvec(numbers[TURN]).as_matrix()
        linear = world @ turn
        at = np.einsum("lab,lb->la", linear, move) + shift @ world.T + numbers[SHIFT]
        full = linear @ scale
        owner = 1 + 3 * np.arange(5)[:, None] + np.array([0, 1, 2, 2])
        chains = np.einsum("fjab,fjb->fja", linear[owner], placed) + (shift @ world.T + numbers[SHIFT])[owner]
        flexion = np.einsum("fjab,fjb->fja", linear[owner[:, :3]], hand.flexion_axis)
        maps = full @ self.back_turn
        return maps, np.einsum("lab,lb->la", full, self.back_shift) + at, chains, flexion

    def vertices(self, numbers: Array) -> Array:
        """The mesh's vertices (v, 3) in the scan's frame."""
        assert self.hand.mesh is not None
        turn, shift, _, _ = self.links(numbers)
        mesh = self.hand.mesh
        blended = (mesh.weights @ turn.reshape(LINKS, 9)).reshape(-1, 3, 3)
        return np.einsum("vab,vb->va", blended, mesh.vertices_m) + mesh.weights @ shift


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
    high[SCALE], high[PALM] = 0.4, 0.2
    low, finger = -high, np.full((2, 5, PER_FINGER), 0.3)
    finger[0] *= -1
    for k, sign in ((0, -1), (1, 1)):
        finger[k, :, ABDUCTION] = warp.hand.abduction_limit_rad[:, k] + sign * LOOSE_RAD
        finger[k, :, FLEXION] = warp.hand.flexion_limit_rad[..., k] + sign * LOOSE_RAD
    low[10:], high[10:] = finger.reshape(2, -1)
    return low, high


def warp_to_landmarks(warp: Warp, wrist: Array, tips: Array, knuckles: Array) -> Array:
    """Numbers that bring wrist, fingertips and knuckles (5, 3) there, bent as little as that needs; nan: not given."""
    low, high = bounds_of(warp)
    start = np.zeros(COUNT)
    start.reshape(-1)[10:].reshape(5, PER_FINGER)[:, FLEXION] = np.radians([[15.0, 20.0, 10.0]])
    given = np.isfinite(knuckles[:, 0])
    places = np.vstack([wrist, tips, knuckles[given]])
    chains = warp.links(start)[2]
    own = np.vstack([np.zeros(3), chains[:, 3], chains[given, 0]])
    turn, _ = Rotation.align_vectors(places - places.mean(axis=0), own - own.mean(axis=0))
    start[TURN], start[SHIFT] = turn.as_rotvec(), places.mean(axis=0) - turn.apply(own.mean(axis=0))

    def off(numbers: Array) -> Array:
        finger = numbers[10:].reshape(5, PER_FINGER)
        flexion = finger[:, FLEXION]
        chains = warp.links(numbers)[2]
        ends = np.vstack([numbers[SHIFT], chains[:, 3], chains[given, 0]])
        return np.concatenate(
            [
                ((ends - places) / 3e-3).ravel(),
                (flexion[:, 0] - 0.3) / 0.6,
                (flexion[:, 1] - warp.hand.flexion_coupling[:, 0] * flexion[:, 0]) / 0.3,
                (flexion[:, 2] - warp.hand.flexion_coupling[:, 1] * flexion[:, 1]) / 0.3,
                finger[:, ABDUCTION] / 0.2,
                finger[:, 4:].ravel() / USUAL,
                numbers[PALM] / USUAL,
                [numbers[SCALE] / 0.15],
            ]
        )

    start = np.clip(start, low + 1e-6, high - 1e-6)
    return least_squares(off, start, bounds=(low, high), max_nfev=60).x


def warp_to_points(warp: Warp, numbers: Array, points: Array, normals: Array) -> Array:
    """Iterated closest points, point to plane, from the palm to the fingertips and then everything at once."""
    assert warp.hand.mesh is not None
    mesh = warp.hand.mesh
    face, mix, _ = spread(mesh.vertices_m, mesh.faces, SPACING_M)
    real = ~mesh.is_cap[face]
    corners, mix = mesh.faces[face[real]], mix[real]
    weights = np.einsum("nk,nkl->nl", mix, mesh.weights[corners])
    # What a link's map does to a point is linear in the map: a point is these 16 x 12 shares times all maps.
    own = np.einsum("nk,nka->na", mix, mesh.vertices_m[corners])
    shares = np.einsum("nl,nb->nlb", weights, np.column_stack([own, np.ones(len(own))]))
    joint = np.where(weights.argmax(axis=1) == 0, -1, (weights.argmax(axis=1) - 1) % 3)
    tree = cKDTree(points)
    low, high = bounds_of(warp)
    for reach, gates in ((0, GATES_M[:3]), (1, GATES_M[:3]), (2, GATES_M)):
        of, free = np.flatnonzero(joint <= reach), _free(reach)
        for gate in gates:
            moved, out = _posed(warp, numbers, corners[of], mix[of])
            model, scan = _matches(moved, out, points, normals, tree, gate)
            normal, kernel = normals[scan], max(gate / 6, KERNEL_M)
            off = np.einsum("na,na->n", moved[model] - points[scan], normal)
            pull = 1 / (kernel * (1 + (off / kernel) ** 2))
            rows = np.einsum("n,na,nlb->nlab", pull, normal, shares[of[model]]).reshape(len(model), -1)
            numbers = _step(warp, numbers, free, rows, pull * np.einsum("na,na->n", points[scan], normal), low, high)
    return numbers


def _step(
    warp: Warp, numbers: Array, free: NDArray[np.intp], rows: Array, wanted: Array, low: Array, high: Array
) -> Array:
    """The free numbers at which rows (n, 192) times the links' maps come nearest to what is wanted (n,)."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])
    square, target = root[:, None] * vectors[:, kept].T, vectors[:, kept].T @ (rows.T @ wanted) / root

    def off(some: Array) -> Array:
        now = numbers.copy()
        now[free] = some
        turn, shift, _, _ = warp.links(now)
        maps = np.concatenate([turn, shift[..., None]], axis=2).ravel()
        usual = np.concatenate([now[PALM], now[10:].reshape(5, PER_FINGER)[:, 4:].ravel()])
        return np.concatenate([square @ maps - target, WEIGHT_OF_USUAL * usual / USUAL])

    start = np.clip(numbers[free], low[free] + 1e-6, high[free] - 1e-6)
    found = numbers.copy()
    found[free] = least_squares(off, start, bounds=(low[free], high[free]), x_scale=_steps()[free], max_nfev=4).x
    return found


def _free(reach: int) -> NDArray[np.intp]:
    """Which numbers are fitted when phalanges up to `reach` are."""
    free = np.ones(COUNT, dtype=bool)
    finger = free[10:].reshape(5, PER_FINGER)
    finger[:, 2 + reach : 4] = False
    finger[:, 5 + reach : 7] = False
    if reach < 2:
        finger[:, 4:] = False
    return np.flatnonzero(free)


def _steps() -> Array:
    steps = np.full(COUNT, 0.1)
    steps[SHIFT] = 0.01
    return steps


def _posed(warp: Warp, numbers: Array, corners: NDArray[np.integer], mix: Array) -> tuple[Array, Array]:
    """Points (n, 3) of the moved mesh, and normals."""
    corner = warp.vertices(numbers)[corners]
    out = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.einsum("nk,nka->na", mix, corner), out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)


def _matches(
    own: Array, out: Array, points: Array, normals: Array, tree: cKDTree, gate: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of hand points and scan points: of each its nearest of the other kind with a like normal."""
    one = _nearest(own, out, tree, normals, gate)
    other = _nearest(points, normals, cKDTree(own), out, gate)
    model = np.concatenate([np.flatnonzero(one >= 0), other[other >= 0]])
    return model, np.concatenate([one[one >= 0], np.flatnonzero(other >= 0)])


def _nearest(points: Array, normals: Array, tree: cKDTree, others: Array, gate: float) -> NDArray[np.intp]:
    """Number (n,) of the nearest point in the tree with a like normal, or -1."""
    distance, number = tree.query(points, k=NEIGHBOURS, distance_upper_bound=gate)
    there = np.isfinite(distance)
    number = np.where(there, number, 0)
    good = there & (np.einsum("na,nka->nk", normals, others[number]) > ALIKE)
    first = good.argmax(axis=1)
    return np.where(good.any(axis=1), number[np.arange(len(points)), first], -1)
