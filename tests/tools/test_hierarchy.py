import numpy as np
import pytest

from palmar.tools.cover import exposed_skin
from palmar.tools.hierarchy import bounds_over, in_tree_order, search

FINGERTIP_M = 0.007


def assert_contained(spheres, bounds):
    """Every ball contains what stands below it, in both precisions, and has at most 8 children."""
    assert bounds.parent[0] == -1 and (bounds.parent[1:] >= 0).all()
    assert (bounds.parent < np.arange(len(bounds.parent))).all()  # parents first: no ring
    assert (np.diff(bounds.parent) >= 0).all()  # siblings side by side
    children = np.bincount(np.concatenate([bounds.parent[1:], bounds.sphere_parent]), minlength=len(bounds.balls_m))
    assert children.min() >= 1 and children.max() <= 8
    for kind in (np.float64, np.float32):
        balls = bounds.balls_m.astype(kind)
        for child, parent in ((balls[1:], bounds.parent[1:]), (spheres.astype(kind), bounds.sphere_parent)):
            reach = np.linalg.norm(child[:, :3] - balls[parent, :3], axis=1) + child[:, 3]
            assert (reach <= balls[parent, 3]).all()


@pytest.mark.parametrize("count", [1, 2, 8, 9, 65, 700, 25_000])
def test_bounds_contain_any_spheres(count):
    rng = np.random.default_rng(count)
    spheres = np.column_stack([rng.normal(size=(count, 3)), rng.uniform(1e-4, 0.5, count)])
    ordered, bounds = in_tree_order(spheres)
    assert sorted(map(tuple, ordered)) == sorted(map(tuple, spheres))
    assert_contained(ordered, bounds)
    assert_contained(spheres, bounds_over(spheres))


def test_bounds_contain_equal_and_nested_spheres():
    spheres = np.array([[0.1, 0.2, 0.3, 0.05]] * 20 + [[0.1, 0.2, 0.31, 0.01]] * 5)
    bounds = bounds_over(spheres)
    assert_contained(spheres, bounds)
    assert bounds.balls_m[0, 3] < 0.0501  # nothing sticks out of the largest


def test_bound_of_two_balls_spans_them():
    bounds = bounds_over(np.array([[0, 0, 0, 0.01], [0.1, 0, 0, 0.02]]))
    # From -0.01 to 0.12 along x; rounded out by a few 2^-24 of 0.1 m.
    assert bounds.balls_m[0] == pytest.approx([0.055, 0, 0, 0.065], abs=5e-7)


def test_search_loses_no_contact_and_tests_few():
    # Leaves over a sheet of 100 mm, as close as a cover has them: 4 or so can touch a fingertip.
    grid = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 22), np.linspace(-0.05, 0.05, 22)), axis=-1).reshape(-1, 2)
    spheres = np.column_stack([grid, 0.01 * np.sin(60 * grid[:, 0]), np.full(len(grid), 0.004)])
    spheres, bounds = in_tree_order(spheres)
    owner, direction, _ = exposed_skin(spheres, FINGERTIP_M, 0.002, 1)
    centres = spheres[owner, :3] + (spheres[owner, 3:] + FINGERTIP_M - 1e-4) * direction
    query, sphere, visits = search(spheres, bounds, centres, FINGERTIP_M)
    found = np.zeros((len(centres), len(spheres)), dtype=bool)
    found[query, sphere] = True
    near = np.linalg.norm(centres[:, None] - spheres[None, :, :3], axis=2)
    assert found[near <= spheres[:, 3] + FINGERTIP_M - 1e-7].all()  # 1e-7 m: floats of some centimetres
    assert not found[near > spheres[:, 3] + FINGERTIP_M + 1e-7].any()
    assert visits.mean() < 60  # of 484; even groups of eight, without a choice of groups, test 90


def test_rows_of_the_tree_order_are_neighbours():
    rng = np.random.default_rng(3)
    spheres = np.column_stack([rng.uniform(0, 1, (4096, 3)), np.full(4096, 0.01)])
    ordered, _ = in_tree_order(spheres)
    runs = ordered[:, :3].reshape(-1, 16, 3)
    spread = np.linalg.norm(runs - runs.mean(axis=1, keepdims=True), axis=2).max(axis=1).mean()
    assert spread < 0.2  # sixteen of 4096 in a cube fill one of side 0.16, 0.14 to its corner; at random 0.8


def test_bounds_repeat():
    rng = np.random.default_rng(5)
    spheres = np.column_stack([rng.normal(size=(500, 3)), rng.uniform(0.01, 0.1, 500)])
    first, second = bounds_over(spheres), bounds_over(spheres)
    assert first.balls_m.tobytes() == second.balls_m.tobytes()
    assert first.sphere_parent.tobytes() == second.sphere_parent.tobytes()
