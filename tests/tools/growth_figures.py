"""What a tree costs against triangles and leaves: python tests/tools/growth_figures.py [--plot growth.svg]

One row a tree of a lumpy ball of 90 mm, each in a process of its own: CPU seconds, wall seconds and peak memory.
`power` is the slope of CPU seconds between this row and the one before on logarithmic scales: 1 is linear.
"""

import argparse
import multiprocessing
import resource
import time

import numpy as np

from palmar.tools.sphere_tree import build_levels

TRIANGLES = (1_000, 4_000, 16_000, 64_000, 250_000, 500_000)
LEAVES = (500, 2_000, 8_000, 32_000, 100_000)


def lumpy_ball(triangles):
    """Vertices (v, 3) and faces (f, 3), about so many, of a ball of 45 mm with waves of up to 5 mm."""
    rings = max(int(np.sqrt(triangles / 4)), 4)
    around = 2 * rings
    polar = np.pi * (np.arange(1, rings) / rings)
    turn = 2 * np.pi * np.arange(around) / around
    polar, turn = (values.ravel() for values in np.meshgrid(polar, turn, indexing="ij"))
    unit = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    unit = np.concatenate([unit, [[0, 0, 1], [0, 0, -1]]])
    wave = np.sin(4 * unit[:, 0] + 1) * np.sin(5 * unit[:, 1]) + np.sin(6 * unit[:, 2] + 2 * unit[:, 0])
    vertices = unit * (0.0425 + 0.00125 * wave)[:, None]
    place = np.arange((rings - 1) * around).reshape(rings - 1, around)
    here, there = place, np.roll(place, -1, axis=1)
    top, bottom = len(unit) - 2, len(unit) - 1
    faces = [
        np.stack([here[:-1], here[1:], there[1:]], axis=-1).reshape(-1, 3),
        np.stack([here[:-1], there[1:], there[:-1]], axis=-1).reshape(-1, 3),
        np.column_stack([np.full(around, top), here[0], there[0]]),
        np.column_stack([np.full(around, bottom), there[-1], here[-1]]),
    ]
    return vertices, np.concatenate(faces)


def cost(triangles, leaves):
    vertices, faces = lumpy_ball(triangles)
    wall, cpu = time.perf_counter(), time.process_time()
    levels, _, parameters = build_levels(vertices, faces, error_m=None, spheres=leaves)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return len(faces), len(levels[-1]), parameters["balanced_p99_mm"], cpu, wall, peak


def series(pairs, changes):
    rows = []
    context = multiprocessing.get_context("spawn")
    print(f"{'triangles':>10}{'leaves':>8}{'balanced mm':>13}{'cpu s':>8}{'power':>7}{'wall s':>8}{'peak MB':>9}")
    for triangles, leaves in pairs:
        with context.Pool(1) as pool:
            rows.append(pool.apply(cost, (triangles, leaves)))
        faces, count, error, seconds, wall, peak = rows[-1]
        power = "-"
        if len(rows) > 1:
            before = rows[-2]
            power = f"{np.log(seconds / before[3]) / np.log(rows[-1][changes] / before[changes]):.2f}"
        print(f"{faces:>10}{count:>8}{error:>13.4g}{seconds:>8.1f}{power:>7}{wall:>8.1f}{peak:>9.0f}", flush=True)
    return np.array(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", help="write both curves to this SVG or PNG")
    given = parser.parse_args()
    of_triangles = series([(triangles, 500) for triangles in TRIANGLES], 0)
    of_leaves = series([(16_000, leaves) for leaves in LEAVES], 1)
    if given.plot:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot

        figure, both = pyplot.subplots(1, 2, figsize=(9, 4), layout="constrained")
        for axes, rows, column, name in zip(
            both, (of_triangles, of_leaves), (0, 1), ("triangles", "leaves"), strict=True
        ):
            axes.loglog(rows[:, column], rows[:, 3], "o-", label="measured")
            axes.loglog(rows[:, column], rows[-1, 3] * rows[:, column] / rows[-1, column], "--", label="linear")
            axes.set(xlabel=name, ylabel="CPU seconds", ylim=(1, None))
            axes.legend()
        figure.savefig(given.plot, dpi=110)


if __name__ == "__main__":
    main()
