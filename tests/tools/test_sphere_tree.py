import itertools
from pathlib import Path

import numpy as np
import pytest

from palmar._runtime import CoverFit
from palmar.errors import BadMesh
from palmar.tools.cover import level_errors, union_gap
from palmar.tools.dual_bound import least_spheres
from palmar.tools.medial import medial_balls
from palmar.tools.shapes import SHAPES
from palmar.tools.solid import closest_points, make_solid, sample_surface, signed_distance, smooth_normals
from palmar.tools.sphere_tree import build_levels, levels_over

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"


@pytest.fixture(scope="module")
def ears():
    """A tree within 1 mm and one of 60 leaves, of a concave body."""
    mesh = SHAPES["ears"]()
    within = build_levels(*mesh, error_m=1e-3, spheres=None)
    counted = build_levels(*mesh, error_m=None, spheres=60)
    return mesh, within, counted


def test_error_holds_on_samples_of_another_seed(ears):
    mesh, (levels, _, parameters), _ = ears
    leaves = level_errors(levels, *mesh, seed=77)[-1]
    assert leaves["gap_mm"]["p99"] <= 1.0
    # The bound holds everywhere, not only at the samples; 1e-9 mm of rounding.
    assert leaves["protrusion_mm"]["max"] <= parameters["protrusion_bound_mm"] + 1e-9
    assert parameters["protrusion_bound_mm"] <= 1.0
    assert leaves["gap_mm"]["max"] <= 3.0  # corners: 1.6 x 2 - 1, in units of the error, and some sampling
    assert leaves["spheres"] < 60  # what the count costs at most for 1 mm on this body


def test_count_is_kept_and_error_is_shared_evenly(ears):
    mesh, _, (levels, _, _) = ears
    assert 54 <= len(levels[-1]) <= 60
    leaves = level_errors(levels, *mesh, seed=78)[-1]
    assert leaves["gap_mm"]["p99"] == pytest.approx(leaves["protrusion_mm"]["p99"], rel=0.2)
    assert leaves["gap_mm"]["p99"] < 1.0


def test_inside_never_sticks_out():
    mesh = SHAPES["ears"]()
    levels, _, parameters = build_levels(*mesh, error_m=None, spheres=60, mode="inside")
    exact, _, _ = closest_points(make_solid(*mesh), levels[-1][:, :3])
    assert (levels[-1][:, 3] - exact).max() <= 1e-6
    leaves = level_errors(levels[-1:], *mesh, seed=79)[0]
    assert leaves["protrusion_mm"]["max"] <= 1e-3
    assert leaves["gap_mm"]["p99"] == pytest.approx(2 * parameters["balanced_p99_mm"], rel=0.1)  # other samples


def test_outside_leaves_no_point_uncovered():
    mesh = SHAPES["cube"]()
    levels, _, parameters = build_levels(*mesh, error_m=None, spheres=60, mode="outside")
    # Corners and edges too, and far more samples than the balls were fitted to.
    points, _ = sample_surface(make_solid(*mesh), 300_000, 80)
    along = np.linspace(0, 1, 200)[:, None, None]
    edges = mesh[0][mesh[1][:, [0, 1, 2]]] * along[:, None] + mesh[0][mesh[1][:, [1, 2, 0]]] * (1 - along[:, None])
    assert union_gap(levels[-1], np.concatenate([points, edges.reshape(-1, 3)])).max() <= 0
    leaves = level_errors(levels[-1:], *mesh, seed=81)[0]
    assert leaves["protrusion_mm"]["max"] <= parameters["protrusion_bound_mm"] + 1e-9


@pytest.mark.parametrize(("mode", "kind", "share"), [("inside", "gap_mm", "p99"), ("outside", "protrusion_mm", "p99")])
def test_modes_keep_the_error_too(mode, kind, share):
    mesh = SHAPES["ears"]()
    levels, _, _ = build_levels(*mesh, error_m=2e-3, spheres=None, mode=mode)
    assert level_errors(levels[-1:], *mesh, seed=82)[0][kind][share] <= 2.0


def test_no_choice_of_balls_beats_the_bound(ears):
    mesh, (levels, _, _), _ = ears
    least = least_spheres(*mesh, 1e-3, levels[-1])
    # Discs alone cover a plane with 1.21 of theirs; what is far above has balls to spare.
    assert 1.0 <= len(levels[-1]) / least <= 1.6
    assert least_spheres(*mesh, 2e-3, levels[-1]) < least


def test_threads_do_not_change_a_bit():
    solid = make_solid(*SHAPES["ears"]())
    points, face = sample_surface(solid, 4000, 1)
    inward = -smooth_normals(solid, points, face)
    balls = medial_balls(solid, points[:60], face[:60], 1e-5)
    found = []
    for threads in (1, 3):
        fit = CoverFit(solid.triangles, [], points, inward, face, np.zeros_like(face), 5, threads)
        fit.set_budget(1e-3, 2e-3, 0.0)
        fit.set_balls(solid.triangles, balls)
        fit.exchange(100, 4)
        fit.polish(0.3, 4, 0.1)
        fit.remove(5)
        fit.add(3, 4)
        found.append(fit.balls().tobytes())
    assert found[0] == found[1]


def test_medial_balls_touch_and_are_empty_of_surface():
    solid = make_solid(*SHAPES["shamrock"]())
    points, face = sample_surface(solid, 500, 2)
    balls = medial_balls(solid, points, face, 1e-5)
    assert len(balls) > 450  # a few points at sharp rims have no ball
    signed, _, _ = signed_distance(solid, balls[:, :3])
    np.testing.assert_allclose(balls[:, 3], -signed, atol=1e-12)  # metres; rounding


def test_each_level_is_a_shape_of_its_own(ears):
    mesh, _, (levels, _, _) = ears
    counts = [len(level) for level in levels]
    assert counts[0] == 1 and all(4 * few >= many > few for few, many in itertools.pairwise(counts))
    errors = level_errors(levels, *mesh, seed=83)
    balanced = [(row["gap_mm"]["p99"] + row["protrusion_mm"]["p99"]) / 2 for row in errors]
    assert all(coarse > fine for coarse, fine in itertools.pairwise(balanced))
    # As good as leaves of that count, which more rounds went into; balls that only contain their children are 5 x off.
    for count, reached in zip(counts[-3:-1], balanced[-3:-1], strict=True):
        (leaves,) = build_levels(*mesh, error_m=None, spheres=count)[0][-1:]
        (own,) = level_errors([leaves], *mesh, seed=83)
        assert reached <= 1.25 * (own["gap_mm"]["p99"] + own["protrusion_mm"]["p99"]) / 2


@pytest.mark.parametrize("mode", ["inside", "outside"])
def test_what_a_mode_promises_holds_for_each_level(mode):
    mesh = SHAPES["ears"]()
    levels, _, _ = build_levels(*mesh, error_m=None, spheres=60, mode=mode)
    solid = make_solid(*mesh)
    points, _ = sample_surface(solid, 100_000, 84)
    for level in levels:
        if mode == "inside":
            assert (level[:, 3] - closest_points(solid, level[:, :3])[0]).max() <= 1e-6
        else:
            assert union_gap(level, points).max() <= 0


def test_given_leaves_stay_and_get_levels():
    mesh = SHAPES["cube"]()
    leaves = build_levels(*mesh, error_m=None, spheres=40)[0][-1][::-1]
    levels, bounds = levels_over(*mesh, leaves)
    assert levels[-1].tobytes() == leaves.tobytes() and [len(level) for level in levels] == [1, 3, 10, 40]
    assert len(bounds[-1].sphere_parent) == 40


def test_same_seed_same_bytes(ears):
    mesh, _, (levels, bounds, parameters) = ears
    again = build_levels(*mesh, error_m=None, spheres=60)
    assert [level.tobytes() for level in again[0]] == [level.tobytes() for level in levels]
    assert [each.balls_m.tobytes() for each in again[1]] == [each.balls_m.tobytes() for each in bounds]
    assert again[2] == parameters


def test_sphere_becomes_one_ball():
    mesh = SHAPES["sphere"]()
    levels, _, _ = build_levels(*mesh, error_m=1e-4, spheres=None)
    assert [len(level) for level in levels] == [1]
    assert levels[0][0] == pytest.approx([0, 0, 0, 0.04], abs=2e-5)  # metres; its facets


def test_cup_stays_hollow():
    levels, _, _ = build_levels(*SHAPES["cup"](), error_m=3e-3, spheres=None)
    axis = np.column_stack([np.full(30, -0.012), np.zeros(30), np.linspace(-0.034, 0.04, 30)])
    # The axis, at x = -12 mm, is 32.5 mm from the wall and 1 mm and more above the floor; balls protrude by 3 mm.
    free = np.minimum(0.0325 * np.cos(np.pi / 96), axis[:, 2] + 0.035)
    assert (union_gap(levels[-1], axis) >= free - 3e-3 - 1e-9).all()


def test_one_ball_is_a_tree():
    levels, _, _ = build_levels(*SHAPES["cube"](), error_m=None, spheres=1)
    assert [len(level) for level in levels] == [1]
    # Half of the corner's gap at least, and never past the corner.
    assert 0.035 < levels[0][0, 3] < 0.035 * np.sqrt(3)


def test_progress_ends_at_one():
    told = []
    build_levels(
        *SHAPES["cylinder"](), error_m=3e-3, spheres=None, progress=lambda text, part: told.append((text, part))
    )
    parts = [part for _, part in told]
    assert parts == sorted(parts) and parts[-1] == 1.0


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"error_m": 1e-7, "spheres": None}, "ask for a larger error"),
        ({"error_m": 0.0, "spheres": None}, "above 0"),
        ({"error_m": None, "spheres": 0}, "1 to 200000"),
    ],
)
def test_what_cannot_be_built_is_refused(wanted, words):
    with pytest.raises(BadMesh, match=words):
        build_levels(*SHAPES["cube"](), **wanted)


@pytest.mark.skipif(not (SHARED / "spheres_objects").is_dir(), reason="the shared objects are not on this machine")
def test_plate_of_1_mm_and_two_bodies_stay_within_the_error():
    trimesh = pytest.importorskip("trimesh")
    for name, error in (("twobody", 5e-4), ("plate", 5e-3)):
        mesh = trimesh.load(SHARED / "spheres_objects" / f"{name}.obj", process=False)
        vertices, faces = np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.faces)
        levels, _, _ = build_levels(vertices, faces, error_m=error, spheres=None)
        leaves = level_errors(levels, vertices, faces, seed=5)[-1]
        assert leaves["gap_mm"]["p99"] <= error * 1e3
        assert leaves["protrusion_mm"]["max"] <= error * 1e3 + 1e-9
