"""A warped hand's surface moved onto a scan: neighbours go alike, first far and stiff, then near and soft."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import cg

from palmar.tools.scan_match import matches
from palmar.tools.scan_warp import Warp

Array = NDArray[np.float64]

PATCH_M2 = 1e-5  # of skin whose distance to the scan counts once
# Round by round: farthest match, and what a difference between neighbours costs beside that.
GATES_M = (0.012, 0.01, 0.008, 0.006, 0.006)
STIFF = (30.0, 10.0, 3.0, 1.0, 0.3)
NEAR_M = 0.01  # skin so near a joint carries it along
HOLD = 1e-3  # of a vertex without a match or neighbours with one


def move_onto(warp: Warp, numbers: Array, points: Array, normals: Array) -> tuple[Array, Array]:
    """Vertices (v, 3) of the warped mesh on the scan, and the chains (5, 4, 3) that went with them.

    Each vertex is drawn onto the plane of the scan's point that is nearest to it with a like normal; where the scan has
    holes it follows its neighbours (non-rigid closest points, a sparse linear system for each round).
    """
    mesh = warp.hand.mesh
    assert mesh is not None
    start = warp.vertices(numbers)
    stiff, area = _laplacian(mesh.faces, len(start)), _areas(start, mesh.faces) / PATCH_M2
    inner = np.setdiff1d(mesh.faces[mesh.is_cap], mesh.faces[~mesh.is_cap])  # of the cap
    move = np.zeros_like(start)
    for gate, cost in zip(GATES_M, STIFF, strict=True):
        now = start + move
        own, scan = matches(now, _out(now, mesh.faces), points, normals, gate)
        of_skin = ~np.isin(own, inner)
        own, scan = own[of_skin], scan[of_skin]
        normal = normals[scan]
        share = (area / np.maximum(np.bincount(own, minlength=len(start)), 1))[own]
        wanted = np.einsum("na,na->n", points[scan] - start[own], normal)
        off = wanted - np.einsum("na,na->n", move[own], normal)
        pull = share / (1 + (off / (gate / 2)) ** 2)
        move = _solve(move, own, normal, pull, wanted, cost * stiff)
    chains = warp.links(numbers[None]).chains[0]
    return start + move, chains + _carried(chains, start, move, mesh.weights)


def _solve(start: Array, own: NDArray[np.intp], normal: Array, pull: Array, wanted: Array, stiff: csc_array) -> Array:
    """Moves (v, 3) that least pull (normal . move - wanted)^2 + move . stiff move leaves, searched from `start`."""
    row = (3 * own[:, None] + np.arange(3)).ravel()
    each = np.repeat(np.arange(len(own)), 3)
    plane = coo_array((normal.ravel(), (each, row)), shape=(len(own), start.size)).tocsr()
    equations = (plane.T @ diags_array(pull) @ plane + stiff).tocsr()
    found, _ = cg(
        equations,
        plane.T @ (pull * wanted),
        start.ravel(),
        rtol=1e-3,
        maxiter=300,
        M=diags_array(1 / equations.diagonal()),
    )
    return found.reshape(start.shape)


def _laplacian(faces: NDArray[np.integer], count: int) -> csc_array:
    """Of the edges, for the three coordinates (3 count, 3 count), with a little of 1."""
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    a, b = (np.concatenate([3 * side + k for k in range(3)]) for side in edges.T.astype(np.int64))
    both = (np.concatenate([a, b]), np.concatenate([b, a]))
    graph = coo_array((np.ones(2 * len(a)), both), shape=(3 * count, 3 * count))
    return (diags_array(graph.sum(axis=1) + HOLD) - graph).tocsc()


def _areas(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """A third of the triangles at each vertex (v,)."""
    corner = vertices[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 6
    shared = np.zeros(len(vertices))
    np.add.at(shared, faces, area[:, None])
    return shared


def _out(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Unit normals (v, 3)."""
    corner = vertices[faces]
    out = np.zeros_like(vertices)
    np.add.at(out, faces, np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, None])
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)


def _carried(chains: Array, vertices: Array, move: Array, weights: Array) -> Array:
    """How the skin around each joint (5, 4, 3) moves, that of the links which meet there."""
    carried = np.zeros_like(chains)
    for f in range(5):
        for j in range(4):
            links = [0 if j == 0 else 3 * f + j, 3 * f + min(j, 2) + 1]
            distance = np.linalg.norm(vertices - chains[f, j], axis=1)
            share = weights[:, links].sum(axis=1) * np.exp(-0.5 * (distance / NEAR_M) ** 2)
            carried[f, j] = share @ move / max(share.sum(), 1e-12)
    return carried
