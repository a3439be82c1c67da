"""The palm of a hand mesh: what stays when fingers and thumb bend, as a closed solid and as spheres."""

from __future__ import annotations

from typing import Any

import numpy as np
from manifold3d import Error, Manifold
from manifold3d import Mesh as ManifoldMesh
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.skin import HandMesh
from palmar.tools.sphere_tree import Progress, build_levels
from palmar.tools.surface import cap, halved, keep_above, largest_part, mixed

Array = NDArray[np.float64]

# Palm is where its share of the skin is above this times the largest share of a phalanx: webs between fingers, which no
# capsule can fill, are palm with it (docs/decisions.md has the figures).
SHARE = 0.1
COARSE = 10_000  # faces
NEEDED_M = 0.0005  # a sphere is needed where the rest of the hand leaves more than this bare


def palm_solid(where: str, mesh: HandMesh) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (v, 3) and faces (f, 3) of the palm without the thumb's metacarpal, closed. Raises BadMesh."""
    # Shares are not linear where three links meet, so the seam is sought on finer triangles.
    values, faces = np.hstack([mesh.vertices_m, mesh.weights]), mesh.faces.astype(np.int64)
    if len(faces) < COARSE:
        values, faces = halved(values, faces)
    palm = values[:, 3] - SHARE * values[:, 4:].max(axis=1)
    mix, faces = keep_above(palm, faces, 0.0)
    vertices = mixed(mix, values[:, :3])
    faces = faces[largest_part(faces)]
    used, number = np.unique(faces, return_inverse=True)
    vertices, faces = cap(vertices[used], number.reshape(-1, 3))
    solid = Manifold(ManifoldMesh(vertices.astype(np.float32), faces.astype(np.uint32)))
    if solid.status() != Error.NoError or solid.volume() <= 0:
        found = f"the palm cannot be closed ({solid.status().name})"
        raise BadMesh("E-RIG-OPEN", where, f"{found}; a closed hand mesh, open at most at the wrist, is needed")
    return vertices, faces


def palm_spheres(
    vertices: Array, faces: NDArray[np.int64], spheres: int, seed: int, progress: Progress
) -> tuple[Array, dict[str, Any]]:
    """At most so many spheres (p, 4) for the palm's solid, and what the builder says of them."""
    levels, _, parameters = build_levels(vertices, faces, error_m=None, spheres=spheres, seed=seed, progress=progress)
    return levels[-1], parameters


def drop_useless(spheres: Array, points: Array, other_gap_m: Array, stands_out_m: Array) -> NDArray[np.bool_]:
    """Which palm spheres (p, 4) to keep: without the dropped ones no skin point (n, 3) is bare that was not.

    other_gap_m: (n,) of the points to the fingers' capsules; stands_out_m: (p,) how far each sphere stands out of the
    skin when the fingers bend. The worst go first.
    """
    gap = np.linalg.norm(points[:, None] - spheres[None, :, :3], axis=2) - spheres[:, 3]
    allowed = np.maximum(NEEDED_M, np.minimum(gap.min(axis=1), other_gap_m))
    # A point that the rest of the hand covers asks nothing of the palm.
    asking = other_gap_m > allowed
    gap, allowed = gap[asking], allowed[asking]
    kept = np.ones(len(spheres), dtype=bool)
    for k in np.argsort(-stands_out_m):
        if stands_out_m[k] <= NEEDED_M:
            break
        kept[k] = False
        mine = gap[:, k] <= allowed
        kept[k] = bool((gap[np.ix_(mine, kept)].min(axis=1) > allowed[mine]).any())
    return kept
