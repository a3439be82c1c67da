"""Every mesh, every mode: the guarantee, or the one line that says why not. python tests/tools/mesh_figures.py --help

One row a mesh and mode. What is promised is measured by other code than the builder's: distances and winding numbers
triangle by triangle, gaps sphere by sphere (see `independent.py`). A mesh that bounds no solid is tried again closed.
Each row runs in a process of its own, so that its peak memory is its own. Exit code 1 if a promise is broken, or
anything but one line of PalmarError comes out.
"""

import argparse
import multiprocessing
import resource
import sys
import time
from pathlib import Path

import numpy as np
from independent import (
    distance_to_spheres,
    distance_to_triangles,
    edge_points,
    random_surface,
    solid_angle_winding,
)

from palmar.errors import PalmarError
from palmar.tools.close import close_mesh, require_closed
from palmar.tools.mesh import Mesh, read_mesh
from palmar.tools.sphere_tree import MODES, build_levels

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
MICRON = 1e-6
SAMPLES = 100_000


def made_meshes():
    """Name -> function that makes a mesh that the shared ones lack, in metres."""
    return {"made:plate": plate_of_1_mm, "made:two": two_bodies, "made:half_million": half_a_million}


def plate_of_1_mm():
    import trimesh

    box = trimesh.creation.box((0.08, 0.06, 0.001))
    return np.asarray(box.vertices), np.asarray(box.faces)


def two_bodies():
    import trimesh

    balls = [trimesh.creation.icosphere(3, radius) for radius in (0.02, 0.001)]
    balls[1].apply_translation((0.03, 0, 0))
    both = trimesh.util.concatenate(balls)
    return np.asarray(both.vertices), np.asarray(both.faces)


def half_a_million(target=500_000):
    """A rock: a ball cut finer until there are enough triangles, with bumps down to a millimetre."""
    import trimesh

    ball = trimesh.creation.icosphere(7)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    while len(faces) < target:
        # Only as many of the faces as are missing, a third each: a centre for each cuts one in three.
        extra = faces[: (target - len(faces) + 1) // 2]
        middle = vertices[extra].mean(axis=1)
        middle /= np.linalg.norm(middle, axis=1)[:, None]
        new = len(vertices) + np.arange(len(extra))
        cut = [np.column_stack([extra[:, k], extra[:, (k + 1) % 3], new]) for k in range(3)]
        vertices, faces = np.concatenate([vertices, middle]), np.concatenate([*cut, faces[len(extra) :]])
    rng = np.random.default_rng(3)
    height = np.zeros(len(vertices))
    for size in (2, 4, 8, 16, 32, 64):
        for wave in rng.normal(size=(4, 3)) * size / 2:
            height += 0.1 / size * np.sin(vertices @ wave + rng.uniform(0, 6))
    return 0.04 * vertices * (1 + height[:, None]), faces


def get_mesh(name):
    if name in made_meshes():
        vertices, faces = made_meshes()[name]()
        return Mesh(vertices, faces.astype(np.int32), name, "", "m", 1.0)
    path = Path(name)
    return read_mesh(path, **({"units": "mm"} if path.parent.name == "spheres_objects" else {"size_mm": 90.0}))


def measure(mesh, mode, leaves, parameters, error_m, seed):
    """(what is promised, its measure in mm, its limit in mm, whether it holds)."""
    vertices, faces = mesh.vertices_m, mesh.faces
    some = leaves[:: max(1, len(leaves) * len(faces) // 20_000_000), :3]  # every pair costs
    inside = solid_angle_winding(some, vertices, faces) > 0.5
    depth = distance_to_triangles(leaves[:, :3], vertices, faces)
    out = 1e3 * float((leaves[:, 3] - depth).max())
    points = random_surface(vertices, faces, SAMPLES, seed + 1000)
    gap = 1e3 * distance_to_spheres(points, leaves)
    rounding = 1e-9 * 1e3 * mesh.size_m
    if mode == "inside":
        promises = [("protrusion", out, MICRON * 1e3, out <= MICRON * 1e3), ("gap p99", np.quantile(gap, 0.99))]
    elif mode == "outside":
        edges = 1e3 * distance_to_spheres(edge_points(vertices, faces, SAMPLES, seed + 1001), leaves).max()
        worst = max(float(gap.max()), float(edges))
        promises = [("gap max", worst, 0.0, worst <= rounding)]
    else:
        limit = parameters["protrusion_bound_mm"]
        promises = [("protrusion", out, limit, out <= limit + rounding), ("gap p99", np.quantile(gap, 0.99))]
    rows = [(*p, 1e3 * error_m, p[1] <= 1e3 * error_m) if len(p) == 2 else p for p in promises]
    return [*rows, ("centres inside", float(inside.mean()), 1.0, bool(inside.all()))]


def row(name, mode, error_mm, seed):
    started = time.process_time()
    how = "as it is"
    try:
        mesh = get_mesh(name)
        try:
            require_closed(name, mesh)
        except PalmarError as refusal:
            mesh, about = close_mesh(name, mesh)
            how = f"{refusal.code}, closed: {about['how']}" if about else refusal.code
            require_closed(name, mesh)
        levels, _, parameters = build_levels(
            mesh.vertices_m, mesh.faces, error_m=error_mm * 1e-3, spheres=None, mode=mode, seed=seed
        )
    except PalmarError as error:
        return error.code != "E-MESH-MISSING", f"{how}; {error}"
    seconds = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    found = measure(mesh, mode, levels[-1], parameters, error_mm * 1e-3, seed)
    said = ", ".join(
        f"{what} {value:.4g} of {limit:.4g}{'' if holds else ' BROKEN'}" for what, value, limit, holds in found
    )
    cost = f"{len(levels[-1])} leaves, {seconds:.0f} CPU s, {peak:.0f} MB"
    return all(holds for *_, holds in found), f"{how}, {len(mesh.faces)} triangles: {cost}; {said}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", help=f"mesh files or {', '.join(made_meshes())}; all there are if none")
    parser.add_argument("--error-mm", type=float, default=1.0)
    parser.add_argument("--mode", choices=list(MODES), help="one of them; all if left out")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    shared = sorted([*(DATA / "spheres_objects").glob("*.obj"), *(DATA / "meshes").glob("*.*")])
    shared = [path for path in shared if path.suffix != ".json"]
    names = given.meshes or [*map(str, shared), *made_meshes()]
    context = multiprocessing.get_context("spawn")
    failed = 0
    for name in names:
        for mode in [given.mode] if given.mode else MODES:
            try:
                with context.Pool(1) as pool:
                    holds, line = pool.apply(row, (name, mode, given.error_mm, given.seed))
            except Exception as error:  # whatever else comes out is what this script looks for
                holds, line = False, f"CRASHED: {type(error).__name__}: {error}"
            failed += not holds
            print(f"{'ok' if holds else 'FAILED':<7}{Path(name).name:<24}{mode:<9} {line}", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
