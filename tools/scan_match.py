"""A warp fitted to landmarks and then to the points of a scan: iterated closest points, coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmar.tools.hand_shape import skin_points
from palmar.tools.scan_warp import (
    ABDUCTION,
    COUNT,
    FLAT,
    FLEXION,
    LENGTH,
    OF_FINGERS,
    PALM,
    PER_FINGER,
    ROOT,
    SCALE,
    SHIFT,
    THICK,
    TURN,
    TWIST,
    Warp,
    bounds_of,
)

Array = NDArray[np.float64]

SPACING_M = 3.5e-3  # between the points of the rigged hand that are matched
LANDMARK_M, JOINT_M = 3e-3, 1.5e-3  # how far off a wrist or fingertip, and a joint, may be
ALIKE = 0.5  # cosine between normals of a match
# Farthest match and, in the same round, what turning a normal round by a radian counts as.
GATES_M = (0.03, 0.025, 0.02, 0.016, 0.013, 0.01, 0.008, 0.007, 0.006, 0.005, 0.004, 0.004)
KERNEL_M = 7e-4  # beyond it a match pulls less
EVIDENCE = 500.0  # so many independent points are all matches together
STEP = 1e-6  # of the numbers, for slopes
FOREARM_M = 0.01  # of it that takes part
WRIST_M = 0.025  # so near the wrist a scan may be closed by anything
SECTORS, OUTERMOST = 24, 0.8


@dataclass(frozen=True)
class Marks:
    """Landmarks in the scan's frame: wrist (3,) and chains (5, 4, 3) of joints and fingertips, nan where not given."""

    wrist: Array
    chains: Array

    @property
    def given(self) -> NDArray[np.bool_]:
        """(5, 4)."""
        return np.isfinite(self.chains[..., 0])

    @property
    def places(self) -> Array:
        """(m, 3) of all that are given, the wrist first."""
        return np.vstack([self.wrist, self.chains[self.given]])

    def off(self, chains: Array, wrist: Array) -> Array:
        """In standard deviations, (k, m): of chains (k, 5, 4, 3) and wrists (k, 3)."""
        ends = np.concatenate([wrist[:, None], chains[:, self.given]], axis=1)
        is_joint = np.append(False, np.argwhere(self.given)[:, 1] < 3)
        return ((ends - self.places) / np.where(is_joint, JOINT_M, LANDMARK_M)[:, None]).reshape(len(ends), -1)


def warp_to_landmarks(warp: Warp, marks: Marks) -> Array:
    """Numbers that bring wrist, fingertips and joints there, bent as little as that needs."""
    start = np.zeros(COUNT)
    start[OF_FINGERS:].reshape(5, PER_FINGER)[:, FLEXION] = np.radians([[15.0, 20.0, 10.0]])
    own = np.vstack([np.zeros(3), warp.links(start[None]).chains[0, marks.given]])
    turn, _ = Rotation.align_vectors(marks.places - marks.places.mean(axis=0), own - own.mean(axis=0))
    start[TURN], start[SHIFT] = turn.as_rotvec(), marks.places.mean(axis=0) - turn.apply(own.mean(axis=0))
    return _solve(warp, marks, start, None, 40)


def warp_to_points(warp: Warp, marks: Marks, numbers: Array, points: Array, normals: Array) -> Array:
    """Point to plane, all phalanges at once, the landmarks held; gates and kernel narrow from round to round."""
    mesh = warp.hand.mesh
    assert mesh is not None
    skin = skin_points(mesh, SPACING_M)
    corners, mix = mesh.faces[skin.face[skin.real]], skin.mix[skin.real]
    weights = np.einsum("nk,nkl->nl", mix, mesh.weights[corners])
    # What a link's map does to a point is linear in the map: a point is these 16 x 4 shares times all maps.
    own = np.einsum("nk,nka->na", mix, mesh.vertices_m[corners])
    shares = np.einsum("nl,nb->nlb", weights, np.column_stack([own, np.ones(len(own))]))
    for gate in GATES_M:
        moved, out = _posed(warp, numbers, corners, mix)
        hand = np.flatnonzero(is_skin(numbers, points))
        model, scan = matches(moved, out, points[hand], normals[hand], gate)
        scan = hand[scan]
        normal, kernel = normals[scan], max(gate / 5, KERNEL_M)
        off = np.einsum("na,na->n", moved[model] - points[scan], normal)
        pull = 1 / (kernel * (1 + (off / kernel) ** 2))
        pull *= np.sqrt(EVIDENCE / max(len(pull), 1))
        rows = np.einsum("n,na,nlb->nlab", pull, normal, shares[model]).reshape(len(model), -1)
        wanted = pull * np.einsum("na,na->n", points[scan], normal)
        numbers = _solve(warp, marks, numbers, _pressed(rows, wanted), 4)
    return numbers


def is_skin(numbers: Array, points: Array) -> NDArray[np.bool_]:
    """Which points (n,) are a hand's: not the forearm's, and not on what closes the scan at its wrist."""
    turn = Rotation.from_rotvec(numbers[TURN]).as_matrix()
    along, across = beyond_wrist(numbers, points), (points - numbers[SHIFT]) @ turn[:, [0, 2]]
    # Skin is what lies farthest out all round the arm.
    far, sector = np.hypot(*across.T), (SECTORS * (0.5 + np.arctan2(*across.T) / (2 * np.pi))).astype(int) % SECTORS
    near = np.abs(along) < WRIST_M
    reach = np.zeros(SECTORS)
    for k in range(SECTORS):
        here = far[near & (sector == k)]
        reach[k] = np.quantile(here, 0.9) if len(here) else 0
    return (along > -FOREARM_M) & (~near | (far > OUTERMOST * reach[sector]))


def beyond_wrist(numbers: Array, points: Array) -> Array:
    """How far (n,) points are from the wrist towards the fingers, in metres of the hand that is warped."""
    return (points - numbers[SHIFT]) @ Rotation.from_rotvec(numbers[TURN]).as_matrix()[:, 1] / np.exp(numbers[SCALE])


def _pressed(rows: Array, wanted: Array) -> tuple[Array, Array]:
    """As few equations (r, 192), (r,) as say the same as all."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])
    return root[:, None] * vectors[:, kept].T, vectors[:, kept].T @ (rows.T @ wanted) / root


def _solve(warp: Warp, marks: Marks, start: Array, equations: tuple[Array, Array] | None, turns: int) -> Array:
    """Numbers that agree best with landmarks, with what is usual, and with equations for the maps."""

    def off(rows: Array) -> Array:
        links = warp.links(rows)
        parts = [marks.off(links.chains, rows[:, SHIFT]), _unusual(warp, rows)]
        if equations is not None:
            parts.append(links.maps.reshape(len(rows), -1) @ equations[0].T - equations[1])
        return np.concatenate(parts, axis=1)

    def slope(numbers: Array) -> Array:
        values = off(np.vstack([numbers, numbers + STEP * np.eye(COUNT)]))
        return (values[1:] - values[0]).T / STEP

    low, high = bounds_of(warp)
    found = least_squares(
        lambda numbers: off(numbers[None])[0],
        np.clip(start, low + 1e-5, high - 1e-5),
        jac=slope,
        bounds=(low, high),
        x_scale=_scale(),
        max_nfev=turns,
    )
    return found.x


def _scale() -> Array:
    """Typical sizes of the numbers."""
    scale = np.full(COUNT, 0.1)
    scale[SHIFT] = 0.01
    scale[OF_FINGERS:].reshape(5, PER_FINGER)[:, ROOT] = 0.004
    return scale


def _unusual(warp: Warp, rows: Array) -> Array:
    """How far rows of numbers are from what hands are like, in standard deviations (k, m)."""
    finger = rows[:, OF_FINGERS:].reshape(len(rows), 5, PER_FINGER)
    bend, coupling = finger[..., FLEXION], warp.hand.flexion_coupling
    parts = [
        rows[:, SCALE, None] / 0.2,
        rows[:, PALM] / 0.06,
        finger[..., ROOT] / 4e-3,
        finger[..., ABDUCTION] / 0.25,
        finger[..., TWIST] / np.array([0.3, 0.08, 0.08, 0.08, 0.08]),
        (bend[..., 0] - 0.2) / 0.6,
        (bend[..., 1] - coupling[:, 0] * bend[..., 0]) / 0.5,
        (bend[..., 2] - coupling[:, 1] * bend[..., 1]) / 0.4,
        finger[..., LENGTH] / 0.08,
        finger[..., THICK] / 0.1,
        finger[..., FLAT] / 0.08,
    ]
    return np.concatenate([part.reshape(len(rows), -1) for part in parts], axis=1)


def _posed(warp: Warp, numbers: Array, corners: NDArray[np.integer], mix: Array) -> tuple[Array, Array]:
    """Points (n, 3) of the moved mesh, and normals."""
    corner = warp.vertices(numbers)[corners]
    out = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.einsum("nk,nka->na", mix, corner), out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)


def matches(
    own: Array, out: Array, points: Array, normals: Array, gate: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of hand points and scan points: of each the nearest of the other kind, a turned normal counting as far."""
    mine, theirs = np.hstack([own, gate * out]), np.hstack([points, gate * normals])
    one, two = cKDTree(theirs).query(mine)[1], cKDTree(mine).query(theirs)[1]
    model, scan = np.concatenate([np.arange(len(own)), two]), np.concatenate([one, np.arange(len(points))])
    near = np.linalg.norm(own[model] - points[scan], axis=1) < gate
    near &= np.einsum("na,na->n", out[model], normals[scan]) > ALIKE
    return model[near], scan[near]
