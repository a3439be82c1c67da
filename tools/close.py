"""Inside and outside: the gate that every object passes, and the making of a solid out of a mesh that does not.

A mesh passes if it bounds a solid: no open edge, one winding, accepted by manifold3d, and a winding number of 1 inside
and 0 outside at the sampled pieces of its skin. Winding numbers: Jacobson et al. 2013, "Robust inside-outside
segmentation using generalized winding numbers"; the fast form: Barill et al. 2018, "Fast winding numbers for soups and
clouds".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.tools.mesh import Mesh, weld
from palmar.tools.moved import distance_between

Progress = Callable[[str, float], None]
Array = NDArray[np.float64]

SAMPLES = 10_000
# Winding numbers are taken this far off the skin: well above their float32 noise, far below anything a finger feels.
OFFSET_OF_SIZE = 1e-4
# Share of the skin (by area) that may read wrong before it is a fault: sharp rims are thinner than the offset.
DOUBLED_SHARE, WRONG_SHARE = 0.001, 0.01
# Grid cells along the side of a block of the coarse grid that closing looks at first.
BLOCK = 4
# A closed mesh farther than this from what it was made of, as a part of its size, is worth a warning.
WARN_OF_SIZE = 0.01
# A body smaller than this part of the whole is debris of the grid.
DEBRIS_SHARE = 1e-4


@dataclass(frozen=True)
class Faults:
    """What keeps a mesh from bounding a solid. All zero (or false): it does."""

    open_edges: int
    crowded_edges: int  # shared by three or more faces
    flipped_edges: int  # whose two faces wind against each other
    refusal: str  # of manifold3d, "" if accepted
    reversed_share: float  # of the skin, with the solid on its outside
    doubled_share: float  # of the skin, inside which space is enclosed twice or more
    buried_share: float  # of the skin, with the solid on both sides
    bare_share: float  # of the skin, with the solid on neither side
    bodies: int
    volume_m3: float


def find_faults(mesh: Mesh, seed: int = 0) -> Faults:
    """Measure what keeps a mesh from bounding a solid."""
    import manifold3d
    import trimesh

    faces = mesh.faces
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, edge, uses = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    turn = np.zeros(len(uses), dtype=np.int64)
    np.add.at(turn, edge.reshape(-1), np.where(directed[:, 0] < directed[:, 1], 1, -1))
    status = _to_manifold(mesh.vertices_m, faces).status()

    skin = trimesh.Trimesh(mesh.vertices_m, faces, process=False)
    points, at = trimesh.sample.sample_surface(skin, SAMPLES, seed=seed)
    offset = OFFSET_OF_SIZE * mesh.size_m * skin.face_normals[at]
    outside = _winding(mesh, points + offset)
    inside = _winding(mesh, points - offset)
    return Faults(
        open_edges=int((uses == 1).sum()),
        crowded_edges=int((uses > 2).sum()),
        flipped_edges=int(((uses == 2) & (turn != 0)).sum()),
        refusal="" if status == manifold3d.Error.NoError else status.name,
        reversed_share=float((np.minimum(inside, outside) < -0.5).mean()),
        doubled_share=float((np.maximum(inside, outside) > 1.5).mean()),
        buried_share=float((np.minimum(inside, outside) > 0.5).mean()),
        bare_share=float((np.maximum(inside, outside) < 0.5).mean()),
        bodies=int(skin.body_count),
        volume_m3=_volume(mesh.vertices_m, faces),
    )


def require_closed(where: str, mesh: Mesh, seed: int = 0) -> None:
    """Raise BadMesh unless the mesh bounds a solid; the message has the numbers and how to mend it."""
    faults = find_faults(mesh, seed)
    found: list[tuple[str, str]] = []
    if faults.open_edges:
        found.append(("E-MESH-OPEN", f"{faults.open_edges} open edges"))
    if faults.flipped_edges:
        found.append(("E-MESH-WINDING", f"{faults.flipped_edges} edges between faces that wind against each other"))
    if faults.refusal:
        crowded = f", {faults.crowded_edges} edges with three or more faces" if faults.crowded_edges else ""
        found.append(("E-MESH-MANIFOLD", f"manifold3d says {faults.refusal}{crowded}"))
    if faults.reversed_share > DOUBLED_SHARE:
        found.append(("E-MESH-INSIDE-OUT", f"{faults.reversed_share:.1%} of its skin is inside out"))
    if faults.doubled_share > DOUBLED_SHARE or faults.buried_share > WRONG_SHARE:
        share = max(faults.doubled_share, faults.buried_share)
        of = f"{faults.bodies} bodies overlap" if faults.bodies > 1 else "it overlaps itself"
        found.append(("E-MESH-OVERLAP", f"{of}: {share:.1%} of its skin lies inside the solid"))
    if not found and (faults.bare_share > WRONG_SHARE or faults.volume_m3 <= 0):
        found.append(
            ("E-MESH-FLAT", f"{faults.bare_share:.1%} of its skin encloses nothing; volume {faults.volume_m3:.3g} m3")
        )
    if found:
        says = "; ".join(text for _, text in found)
        raise BadMesh(
            found[0][0],
            where,
            f"{says}. Inside and outside are not defined; --close makes it solid and says how far it moved",
        )


def close_mesh(
    where: str, mesh: Mesh, *, cells: int = 160, seed: int = 0, progress: Progress | None = None
) -> tuple[Mesh, dict[str, Any] | None]:
    """Make a mesh bound a solid, by the gentlest of three ways that is enough.

    1. repair: drop repeated faces, make the winding one, turn it outward; 2. union of its closed bodies;
    3. remesh: the 0.5 level of the winding number on a grid of `cells` along the longest side.
    Returns the solid, and what was done: "how", how far it is from the mesh ("moved_mm") and "warnings"; None for a
    mesh that was solid already. Raises BadMesh E-MESH-SOUP if no inside exists.
    """
    say = progress or (lambda text, fraction: None)
    if _is_solid(mesh, seed):
        return mesh, None
    say("repairing", 0.0)
    repaired, repairs = _repair(mesh)
    if repairs and _is_solid(repaired, seed):
        return repaired, {"how": "repaired", "repairs": repairs, **_compare(where, repaired, repaired, seed)}
    united = _unite(repaired)
    if united is not None and _is_solid(united, seed):
        repairs = [*repairs, "united its bodies"]
        return united, {"how": "united", "repairs": repairs, **_compare(where, repaired, united, seed)}
    say("winding number on a grid", 0.1)
    cell = repaired.size_m / cells
    built, dropped = _remesh(where, repaired, cell)
    say("measuring how far it moved", 0.9)
    about = {"how": "remeshed", "repairs": repairs, "cell_mm": cell * 1000, "dropped_bodies": dropped}
    return built, {**about, **_compare(where, repaired, built, seed)}


def _is_solid(mesh: Mesh, seed: int) -> bool:
    try:
        require_closed("", mesh, seed)
    except BadMesh:
        return False
    return True


def _volume(vertices: Array, faces: NDArray[Any]) -> float:
    """Signed volume that closed triangles enclose: the sum of their tetrahedra with the first vertex."""
    a, b, c = np.moveaxis(vertices[faces] - vertices[0], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _winding(mesh: Mesh, points: Array) -> Array:
    import igl

    return igl.fast_winding_number(mesh.vertices_m, mesh.faces.astype(np.int64), np.ascontiguousarray(points))


def _to_manifold(vertices: Array, faces: NDArray[Any]) -> Any:
    import manifold3d

    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    )


def _from_manifold(solid: Any, mesh: Mesh) -> Mesh:
    out = solid.to_mesh64()
    vertices, faces = weld(out.vert_properties[:, :3], out.tri_verts.astype(np.int64))
    return replace(mesh, vertices_m=vertices, faces=faces)


def _repair(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """Drop repeated faces, make the winding of each patch one, turn the whole outward."""
    import igl

    repairs = []
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    faces = mesh.faces[np.sort(first)].astype(np.int64)
    if len(faces) < len(mesh.faces):
        repairs.append(f"dropped {len(mesh.faces) - len(faces)} repeated faces")
    oriented, patch = igl.bfs_orient(faces)
    if len(repairs) or (oriented != faces).any():
        # Each patch is turned outward by itself (for a closed one: by the sign of its volume).
        oriented, _ = igl.orient_outward(mesh.vertices_m, oriented, patch.reshape(-1, 1))
    turned = int((oriented != faces).any(axis=1).sum())
    if _volume(mesh.vertices_m, oriented) < 0:
        oriented = oriented[:, ::-1]
        turned = len(faces) - turned
    if turned:
        repairs.append(f"turned {turned} faces")
    vertices, kept = weld(mesh.vertices_m, oriented)
    return replace(mesh, vertices_m=vertices, faces=kept), repairs


def _unite(mesh: Mesh) -> Mesh | None:
    """The union of a mesh's closed bodies; None if one of them is open or a cavity."""
    import manifold3d

    whole = _to_manifold(mesh.vertices_m, mesh.faces)
    bodies = whole.decompose() if whole.status() == manifold3d.Error.NoError else []
    if len(bodies) < 2 or any(body.volume() <= 0 for body in bodies):
        return None
    return _from_manifold(manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add), mesh)


def _remesh(where: str, mesh: Mesh, cell: float) -> tuple[Mesh, int]:
    """The winding number's 0.5 level as a solid, and how many bits of debris were dropped."""
    import igl
    import manifold3d

    low = mesh.vertices_m.min(axis=0) - 2.5 * cell
    blocks = np.ceil((mesh.vertices_m.max(axis=0) + 2.5 * cell - low) / (BLOCK * cell)).astype(int)
    counts = BLOCK * blocks + 1
    # marching_cubes wants x fastest: arrays are indexed z, y, x.
    points = low + cell * np.moveaxis(np.indices(counts[::-1])[::-1], 0, -1).reshape(-1, 3)
    winding = _winding_on_grid(where, mesh, points.reshape(*counts[::-1], 3), cell).reshape(-1)
    gap = _gap_near_skin(mesh, points, winding, counts, cell)
    vertices, faces, vertex_of_edge = igl.marching_cubes(gap, points, *(int(n) for n in counts), 0.0)
    if len(faces) == 0:
        raise BadMesh("E-MESH-SOUP", where, "nothing is enclosed: no inside exists, so it cannot be made solid")
    _place_on_edges(vertices, vertex_of_edge, points, gap, winding, cell)
    solid = _to_manifold(vertices, faces)
    if solid.status() == manifold3d.Error.NoError and solid.volume() < 0:
        solid = _to_manifold(vertices, faces[:, ::-1])
    if solid.status() != manifold3d.Error.NoError:
        raise BadMesh("E-MESH-SOUP", where, f"its 0.5 level of the winding number is no solid ({solid.status().name})")
    # Flat pieces need few triangles; a twentieth of a cell is below what the grid resolves.
    bodies = solid.simplify(0.05 * cell).decompose()
    least = max(DEBRIS_SHARE * max((abs(body.volume()) for body in bodies), default=0.0), (2 * cell) ** 3)
    kept = [body for body in bodies if abs(body.volume()) >= least]
    if not kept:
        raise BadMesh("E-MESH-SOUP", where, "nothing larger than the grid is enclosed: no inside exists")
    return _from_manifold(manifold3d.Manifold.compose(kept), mesh), len(bodies) - len(kept)


def _winding_on_grid(where: str, mesh: Mesh, points: Array, cell: float) -> Array:
    """Winding number less 0.5 at grid points (nz, ny, nx, 3): exact in blocks that skin or the 0.5 level can cross.

    Away from skin the winding number is smooth; in blocks that lie on one side of 0.5 it is given as -0.5 or 0.5.
    Raises BadMesh if the inside reaches the grid's rim.
    """
    import igl
    from scipy.ndimage import binary_dilation

    coarse = np.ascontiguousarray(points[::BLOCK, ::BLOCK, ::BLOCK])
    flat = coarse.reshape(-1, 3)
    inside = (_winding(mesh, flat) > 0.5).reshape(coarse.shape[:3])
    _require_bounds(where, inside)
    squared, _, _ = igl.point_mesh_squared_distance(flat, mesh.vertices_m, mesh.faces.astype(np.int64))
    # No point of a block is farther from its nearest corner than half its diagonal.
    close = (np.sqrt(squared) <= 0.5 * np.sqrt(3) * BLOCK * cell * (1 + 1e-6)).reshape(inside.shape)
    some, every = _of_corners(inside, np.logical_or), _of_corners(inside, np.logical_and)
    unsure = binary_dilation(some & ~every, np.ones((3, 3, 3))) | _of_corners(close, np.logical_or)

    winding = np.full(points.shape[:3], -0.5)
    exact = np.zeros(points.shape[:3], dtype=bool)
    for block, array, value in ((every, winding, 0.5), (unsure, exact, True)):
        inner = block.repeat(BLOCK, 0).repeat(BLOCK, 1).repeat(BLOCK, 2)
        # A block owns the points on all of its sides.
        for z, y, x in np.ndindex(2, 2, 2):
            part = array[z : z + inner.shape[0], y : y + inner.shape[1], x : x + inner.shape[2]]
            part[inner] = value
    winding[exact] = _winding(mesh, points[exact]) - 0.5
    _require_bounds(where, winding > 0)
    return winding


def _require_bounds(where: str, inside: NDArray[np.bool_]) -> None:
    rim = inside.copy()
    rim[1:-1, 1:-1, 1:-1] = False
    if rim.any():
        found = "its faces do not agree what is inside: by their winding, its inside has no bounds"
        raise BadMesh("E-MESH-SOUP", where, found)


def _of_corners(flags: NDArray[np.bool_], join: Any) -> NDArray[np.bool_]:
    """Flags of points (nz, ny, nx) joined over the eight corners of each block."""
    for axis in range(3):
        flags = join(np.delete(flags, -1, axis), np.delete(flags, 0, axis))
    return flags


def _gap_near_skin(mesh: Mesh, points: Array, winding: Array, counts: NDArray[Any], cell: float) -> Array:
    """Gap at the grid points (negative inside): sign from the winding number, size where the sign changes nearby."""
    import igl
    from scipy.ndimage import binary_dilation

    inside = (winding > 0).reshape(counts[::-1])
    near = (binary_dilation(inside) & binary_dilation(~inside)).reshape(-1)
    size = np.full(len(points), cell)
    squared, _, _ = igl.point_mesh_squared_distance(points[near], mesh.vertices_m, mesh.faces.astype(np.int64))
    # A gap of exactly 0 makes marching cubes put several vertices on one grid point.
    size[near] = np.maximum(np.sqrt(squared), 1e-6 * cell)
    return np.where(winding > 0, -size, size)


def _place_on_edges(
    vertices: Array, vertex_of_edge: dict[int, int], points: Array, gap: Array, winding: Array, cell: float
) -> None:
    """Where no skin crosses a grid edge (a hole is spanned), move its vertex to the winding's 0.5 level. In place."""
    key = np.fromiter(vertex_of_edge.keys(), dtype=np.int64, count=len(vertex_of_edge))
    vertex = np.fromiter(vertex_of_edge.values(), dtype=np.int64, count=len(vertex_of_edge))
    a, b = key & 0xFFFFFFFF, key >> 32
    # A surface that crosses the edge is at most one cell away from both ends together.
    hole = np.abs(gap[a]) + np.abs(gap[b]) > cell * (1 + 1e-6)
    a, b, vertex = a[hole], b[hole], vertex[hole]
    share = np.clip(winding[a] / (winding[a] - winding[b]), 1e-3, 1 - 1e-3)
    vertices[vertex] = points[a] + share[:, None] * (points[b] - points[a])


def _compare(where: str, before: Mesh, after: Mesh, seed: int) -> dict[str, Any]:
    """Two-sided distance between a mesh and the solid made of it, in mm (see `distance_between`), and warnings.

    Skin with the mesh's own inside on both its sides (an overlap, a spout that goes on in the body) bounds nothing and
    is left out; its share is given. hausdorff_mm: the larger of both maxima.
    """
    import trimesh

    def is_buried(points: Array, normals: Array) -> NDArray[np.bool_]:
        offset = OFFSET_OF_SIZE * before.size_m * normals
        return (_winding(before, points + offset) > 0.5) & (_winding(before, points - offset) > 0.5)

    def is_none(points: Array, normals: Array) -> NDArray[np.bool_]:
        return np.zeros(len(points), dtype=bool)

    skin = trimesh.Trimesh(before.vertices_m, before.faces, process=False)
    points, at = trimesh.sample.sample_surface(skin, SAMPLES, seed=seed)
    lost = distance_between(before.vertices_m, before.faces, after.vertices_m, after.faces, seed, is_buried)
    new = distance_between(after.vertices_m, after.faces, before.vertices_m, before.faces, seed, is_none)
    allowed = WARN_OF_SIZE * 1000 * before.size_m
    warnings = []
    if lost["max"] > allowed:
        warnings.append(
            f"{where}: parts of the mesh are up to {_tell(lost)}, away from the solid made of it: "
            "what encloses nothing is lost"
        )
    if new["max"] > allowed:
        warnings.append(
            f"{where}: the solid has new surface up to {_tell(new)}, away from the mesh: it spans the holes"
        )
    return {
        "moved_mm": {"mesh_to_solid": lost, "solid_to_mesh": new},
        "hausdorff_mm": max(lost["max"], new["max"]),
        "buried_share": float(is_buried(points, skin.face_normals[at]).mean()),
        "warnings": warnings,
    }


def _tell(moved: dict[str, Any]) -> str:
    at = ", ".join(f"{x:.1f}" for x in moved["at_mm"])
    return f"{moved['max']:.2f} mm at {at} (p99 {moved['p99']:.2f}, mean {moved['mean']:.2f} mm)"
