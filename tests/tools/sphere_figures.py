"""The figures of the sphere trees, in one command: python tests/tools/sphere_figures.py --help

One row an object: balanced p99 = (gap p99 + protrusion p99) / 2 on samples that the choice has not seen, beside
what is aimed at, and what the tree cost. Each row runs in a process of its own, so that its peak memory is its own.
"""

import argparse
import multiprocessing
import resource
import time
from pathlib import Path

import numpy as np

from palmar.tools.cover import exposed_skin, level_errors
from palmar.tools.dual_bound import MOST_BALLS, least_spheres
from palmar.tools.hierarchy import search
from palmar.tools.mesh import read_mesh
from palmar.tools.sphere_tree import MODES, build_levels

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
FINGERTIP_M, PROBES = 0.007, 10_000
# Object: aimed at with 500 leaves in mm, leaves of the finer level, aimed at there.
AIMS = {
    "bunny": (0.21, 2896, 0.062),
    "teapot": (0.22, 1792, 0.087),
    "shamrock": (0.27, 3511, 0.080),
    "rock": (0.28, 3089, 0.068),
    "cup": (1.35, 4047, 0.31),
    "cube": (0.50, 2000, 0.19),
    "triprism": (0.45, 2000, 0.17),
    "hexprism": (0.39, 2000, 0.15),
    "cylinder": (0.25, 2000, 0.09),
}


def fingertip_search(spheres, bounds, seed):
    """Mean visits (see `search`) of a fingertip that touches somewhere, by area; and contacts lost of 10,000 probes.

    A probe: a fingertip that rests on the union, up to 2 mm deep; asked for what lies within 0.5 mm.
    """
    area = 4 * np.pi * (np.ptp(spheres[:, :3], axis=0).max() / 2 + FINGERTIP_M) ** 2
    owner, direction, angle = exposed_skin(spheres, FINGERTIP_M, np.sqrt(area / 40_000), seed)
    rng = np.random.default_rng(seed)
    weight = angle * (spheres[owner, 3] + FINGERTIP_M) ** 2
    probe = rng.choice(len(owner), PROBES, p=weight / weight.sum())
    owner, direction = owner[probe], direction[probe]
    rest = spheres[owner, :3] + (spheres[owner, 3:] + FINGERTIP_M) * direction
    _, _, visits = search(spheres, bounds, rest, FINGERTIP_M + 5e-4)
    deep = rest - rng.uniform(0, 2e-3, PROBES)[:, None] * direction
    query, sphere, _ = search(spheres, bounds, deep, FINGERTIP_M + 5e-4)
    found = np.zeros(len(spheres), dtype=bool)
    order = np.argsort(query, kind="stable")
    parts = np.split(sphere[order], np.cumsum(np.bincount(query, minlength=PROBES))[:-1])
    lost = 0
    for centre, part in zip(deep, parts, strict=True):
        offset = spheres[:, :3] - centre
        touched = np.sqrt((offset * offset).sum(axis=1)) <= spheres[:, 3] + FINGERTIP_M
        found[:] = False
        found[part] = True
        lost += int((touched & ~found).sum())
    return float(visits.mean()), lost


def print_levels(name, errors):
    for error in errors:
        gap, out = error["gap_mm"], error["protrusion_mm"]
        balanced, felt = (gap["p99"] + out["p99"]) / 2, error["normal_error_deg"]["p95"]
        print(
            f"{name}: {error['spheres']:>6} spheres, balanced {balanced:.4g}, out max {out['max']:.4g}, felt {felt:.3g}"
        )


def row(path, wanted, mode, seed, bound, each_level):
    mesh = read_mesh(path, **({"units": "mm"} if path.parent.name == "spheres_objects" else {"size_mm": 90.0}))
    wall, cpu = time.perf_counter(), time.process_time()
    levels, bounds, parameters = build_levels(mesh.vertices_m, mesh.faces, mode=mode, seed=seed, **wanted)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    leaves = levels[-1]
    visits, lost = fingertip_search(leaves, bounds[-1], seed)
    (error,) = level_errors([leaves], mesh.vertices_m, mesh.faces, seed + 90)
    gap, out = error["gap_mm"], error["protrusion_mm"]
    figures = {
        "leaves": len(leaves),
        "balanced": (gap["p99"] + out["p99"]) / 2,
        "gap p99": gap["p99"],
        "max": gap["max"],
        "out p99": out["p99"],
        "out max": out["max"],
        "bound": parameters["protrusion_bound_mm"],
        "felt p95": error["normal_error_deg"]["p95"],
        "visits": visits,
        "lost": lost,
        "cpu s": cpu,
        "wall s": wall,
        "peak MB": peak,
    }
    if each_level:
        print_levels(path.stem, level_errors(levels, mesh.vertices_m, mesh.faces, seed + 90))
    if bound and wanted["error_m"]:
        few = len(leaves) <= MOST_BALLS
        least = least_spheres(mesh.vertices_m, mesh.faces, wanted["error_m"], leaves, seed) if few else float("nan")
        figures["/ bound"] = len(leaves) / least
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", nargs="*", help="names or mesh files; all nine objects if none")
    parser.add_argument("--spheres", type=int, help="leaves; 500 if neither this nor another is given")
    parser.add_argument("--fine", action="store_true", help="the leaves of the finer level of each object")
    parser.add_argument("--error-mm", type=float)
    parser.add_argument("--bound", action="store_true", help="with --error-mm: leaves against the dual bound")
    parser.add_argument("--levels", action="store_true", help="a line for each level too")
    parser.add_argument("--mode", default="balanced", choices=list(MODES))
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    head = None
    for name in given.objects or AIMS:
        places = (Path(name), DATA / "spheres_objects" / f"{name}.obj", DATA / "meshes" / f"{name}.obj")
        path = next((place for place in places if place.is_file()), None)
        if path is None:
            parser.error(f"{name}: no mesh file of that name, nor in {DATA}")
        aims = AIMS.get(name)
        count = aims[1] if given.fine else given.spheres or 500
        aim = None if aims is None or given.mode != "balanced" else aims[2] if given.fine else aims[0]
        wanted = {"error_m": None, "spheres": count}
        if given.error_mm:
            wanted, aim = {"error_m": given.error_mm * 1e-3, "spheres": None}, None
        with context.Pool(1) as pool:
            figures = pool.apply(row, (path, wanted, given.mode, given.seed, given.bound, given.levels))
        if head is None:
            head = list(figures)
            print(f"{'object':<18}{'aim':>8}" + "".join(f"{title:>10}" for title in head))
        aimed = f"{aim:g}" if aim and (given.fine or count == 500) else "-"
        print(f"{path.stem:<18}{aimed:>8}" + "".join(f"{figures[title]:>10.4g}" for title in head), flush=True)


if __name__ == "__main__":
    main()
