import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.model import AssetPack, save_pack
from palmar.records import read_trace
from palmar.traces.scripted import SCENES, check_scene, load_scene, min_jerk, script, script_trace

MIN_JERK_SPEED = 1.875  # largest slope of s(u), at u = 1/2
MIN_JERK_ACCELERATION = 5.7736  # largest curvature, 10 / sqrt(3)


@pytest.fixture(scope="module")
def keys():
    return load_scene("grasp")[0]


@pytest.fixture(scope="module")
def grasp(keys, hand, trees):
    return script_trace(keys, hand, trees["ball"], seed=0)


def part(trace, name):
    phase = next(phase for phase in trace.phases if phase["name"] == name)
    return (trace.time_s >= phase["start_s"]) & (trace.time_s < phase["end_s"])


def columns(trace):
    return {
        name: getattr(trace, name)
        for name in ("time_s", "palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad")
    }


def turns(trace):
    """Angle between neighbouring palm rotations, radians."""
    q = trace.palm_rotation_wxyz
    return 2 * np.arcsin(np.minimum(np.linalg.norm(np.diff(q, axis=0), axis=1) / 2, 1))


@pytest.mark.parametrize("name", ["ring", "marble"])
def test_grasp_fits_any_object(keys, hand, trees, name):
    trace = script_trace(keys, hand, trees[name], seed=1)
    assert all(np.isfinite(column).all() for column in columns(trace).values())
    assert (trace.flexion_rad >= hand.flexion_limit_rad[..., 0]).all()
    assert (trace.flexion_rad <= hand.flexion_limit_rad[..., 1]).all()


def test_same_seed_gives_the_same_bytes_and_another_does_not(keys, hand, trees, grasp):
    again, other = (script_trace(keys, hand, trees["ball"], seed=seed) for seed in (0, 1))
    assert all(columns(again)[name].tobytes() == column.tobytes() for name, column in columns(grasp).items())
    assert again.header == grasp.header
    assert not np.array_equal(other.palm_position_m, grasp.palm_position_m)


def test_palm_starts_as_far_from_first_contact_as_the_scene_says(keys, hand, trees, grasp):
    turned = Rotation.from_quat(np.roll(grasp.palm_rotation_wxyz[0], -1))
    balls = turned.apply(hand.palm_spheres_m[:, :3]) + grasp.palm_position_m[0]
    normal = turned.apply([0, 0, -1])
    touch = balls + keys["start_m"] * normal
    apart = np.linalg.norm(touch[:, None] - trees["ball"].leaves[:, :3], axis=2)
    gap = apart - trees["ball"].leaves[:, 3] - hand.palm_spheres_m[:, 3, None]
    assert gap.min() == pytest.approx(0, abs=1e-12)  # roundings


def test_hand_stands_still_to_the_bit_while_it_holds(grasp):
    held = part(grasp, "hold")
    assert 1.0 <= held.sum() / 1000 <= 1.4
    for name, column in columns(grasp).items():
        if name != "time_s":
            assert len(np.unique(column[held].reshape(held.sum(), -1), axis=0)) == 1


def test_phases_follow_each_other_without_a_gap(grasp):
    phases = grasp.phases
    assert [phase["name"] for phase in phases] == ["approach", "close", "slide", "hold", "leave"]
    assert phases[0]["start_s"] == 0.0 and phases[-1]["end_s"] == grasp.time_s[-1]
    assert all(a["end_s"] == b["start_s"] for a, b in pairwise(phases))
    assert 5.0 <= grasp.time_s[-1] <= 6.0


def test_steps_are_never_larger_than_minimum_jerk_allows(keys, grasp):
    step = np.linalg.norm(np.diff(grasp.palm_position_m, axis=0), axis=1)
    flexion_step = np.abs(np.diff(grasp.flexion_rad, axis=0)).max((1, 2))
    way = np.abs(np.ptp(grasp.flexion_rad, axis=0)).max()
    speed = MIN_JERK_SPEED / 1000  # of a way that takes a second, in a step of 1 ms
    at = {name: np.flatnonzero(part(grasp, name)[:-1]) for name in ("approach", "close", "slide", "hold", "leave")}
    palm_m = keys["start_m"] + keys["press_m"]
    assert step[at["approach"]].max() <= speed * palm_m / keys["approach_s"] * (1 + 1e-9)
    assert step[at["leave"]].max() <= speed * palm_m / keys["leave_s"] * (1 + 1e-9)
    assert flexion_step[at["close"]].max() <= speed * way / keys["close_s"] * (1 + 1e-9)
    assert flexion_step[at["leave"]].max() <= speed * way / keys["leave_s"] * (1 + 1e-9)
    # The slide: a sine of 2 pi s along one way, of 4 pi s along the other, and a turn about the palm's middle.
    arm_m = 0.06
    round_m = np.hypot(2 * np.pi * keys["slide_radial_m"], 4 * np.pi * keys["slide_distal_m"])
    round_m += 2 * np.pi * keys["slide_turn_rad"] * arm_m
    assert step[at["slide"]].max() <= speed * round_m / keys["slide_s"]
    assert turns(grasp)[at["slide"]].max() <= speed * 2 * np.pi * keys["slide_turn_rad"] / keys["slide_s"] * (1 + 1e-9)
    assert step[at["hold"][:-1]].max() == 0


def test_motion_has_no_corner_anywhere(keys, grasp):
    """Second differences, across the phases' borders too, stay below those of the moves that meet there."""
    bend = np.abs(np.diff(grasp.palm_position_m, n=2, axis=0)).max()
    # Along u the slide bends by at most (4 pi)^2 1.875^2 A + 4 pi 5.7736 A for each of its two ways.
    slide = sum(
        (k**2 * MIN_JERK_SPEED**2 + k * MIN_JERK_ACCELERATION) * amplitude_m
        for k, amplitude_m in (
            (2 * np.pi, keys["slide_radial_m"] + 0.06 * keys["slide_turn_rad"]),
            (4 * np.pi, keys["slide_distal_m"]),
        )
    )
    slide += 0.06 * (2 * np.pi * MIN_JERK_SPEED * keys["slide_turn_rad"]) ** 2  # towards the middle that it turns about
    reach = MIN_JERK_ACCELERATION * (keys["start_m"] + keys["press_m"])
    assert bend <= 1e-6 * max(slide / keys["slide_s"] ** 2, reach / keys["approach_s"] ** 2)
    way = np.abs(np.ptp(grasp.flexion_rad, axis=0)).max()
    bend = np.abs(np.diff(grasp.flexion_rad, n=2, axis=0)).max()
    assert bend <= 1e-6 * MIN_JERK_ACCELERATION * way / min(keys["close_s"], keys["leave_s"]) ** 2 * (1 + 1e-6)


def test_min_jerk_starts_and_ends_at_rest():
    u = np.linspace(0, 1, 100001)
    s = min_jerk(u)
    assert s[0] == 0 and s[-1] == 1
    slope = np.diff(s) * 1e5
    assert slope[0] < 1e-7 and slope[-1] < 1e-7
    assert slope.max() == pytest.approx(MIN_JERK_SPEED, abs=1e-8)
    assert (np.diff(slope) * 1e5).max() == pytest.approx(MIN_JERK_ACCELERATION, abs=2e-4)


def test_slide_goes_to_both_sides_as_far_as_the_scene_says(keys, hand, grasp):
    turned = Rotation.from_quat(np.roll(grasp.palm_rotation_wxyz, -1, axis=1))
    middle = turned.apply(hand.palm_spheres_m[:, :3].mean(axis=0)) + grasp.palm_position_m
    away = middle[part(grasp, "slide")] - middle[part(grasp, "hold")][0]
    along = turned[-1].inv().apply(away)  # the reference palm: x across it, y along the fingers
    for axis, key in ((0, "slide_radial_m"), (1, "slide_distal_m")):
        # 1e-7 m: the samples may miss the very peak
        np.testing.assert_allclose([along[:, axis].min(), along[:, axis].max()], [-keys[key], keys[key]], atol=1e-7)
    assert np.abs(along[:, 2]).max() < 1e-15  # roundings: no way along the normal
    most = 2 * np.arccos(np.clip(np.abs(grasp.palm_rotation_wxyz @ grasp.palm_rotation_wxyz[0]), 0, 1)).max()
    assert most == pytest.approx(keys["slide_turn_rad"], abs=1e-4)  # the samples may miss the very peak


def test_header_names_scene_seed_hand_and_what_was_assumed(grasp):
    assert grasp.header["scene"] == "grasp" and grasp.header["seed"] == "0"
    assert grasp.header["hand"] == "reference" and grasp.header["rate_hz"] == "1000"
    assert any("5 of 5 fingers" in sentence for sentence in json.loads(grasp.header["assumptions"]))


def test_every_scene_in_the_folder_loads_and_says_why_it_is_hard():
    scenes = sorted(SCENES.glob("*.toml"))
    assert scenes
    for path in scenes:
        keys, where, sha256 = load_scene(path.stem)
        assert where == path and len(sha256) == 64 and len(keys["why"]) > 80


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"squeze_m": 0.01}, "E-CONF my.toml:squeze_m: unknown key (nearest: squeeze_m); known are kind, "),
        ({"press_m": 0.5}, "E-CONF my.toml:press_m: found 0.5; allowed is less than or equal to 0.02"),
        ({"hold_s": float("nan")}, "E-CONF my.toml:hold_s: found nan; allowed is "),
        ({"rate_hz": "fast"}, "E-CONF my.toml:rate_hz: found 'fast'; allowed is a valid number"),
        ({"kind": "punch"}, "E-CONF my.toml:kind: found 'punch'; allowed is 'grasp' or 'keys' or 'random'"),
        ({"fist_rad": [1.0, 1.0]}, "E-CONF my.toml:fist_rad.2: key is missing"),
        ({"start_m": None}, "E-CONF my.toml:start_m: key is missing"),
    ],
)
def test_wrong_key_is_refused_by_name(keys, change, said):
    changed = {key: value for key, value in (keys | change).items() if value is not None}
    with pytest.raises(PalmarError) as caught:
        check_scene(changed, "my.toml")
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_unknown_scene_and_broken_file_are_refused(tmp_path):
    with pytest.raises(PalmarError, match=r"E-CONF graps: no such scene \(nearest: grasp\); known are .*, grasp, "):
        load_scene("graps")
    path = tmp_path / "twice.toml"
    path.write_text("kind = 'grasp'\nkind = 'grasp'\n")
    with pytest.raises(PalmarError, match=r"E-CONF .*twice.toml: not TOML"):
        load_scene(path)


@pytest.fixture
def pack(tmp_path, hand, trees):
    path = tmp_path / "two.pack"
    about = {"levels": [{}]}
    objects = {name: replace(trees[name], about=about) for name in ("ball", "rod")}
    save_pack(path, AssetPack(hand, objects, {}))
    return path


def test_script_writes_the_trace_of_one_object_of_a_pack(tmp_path, keys, hand, trees, pack):
    out = tmp_path / "rod.mcap"
    summary = script("grasp", pack, out, object="rod", seed=3)
    trace = read_trace(out)
    assert summary["object"] == "rod" and summary["seed"] == 3 and summary["samples"] == len(trace.time_s)
    assert trace.header["object"] == "rod" and trace.header["source"] == "grasp.toml"
    made = script_trace(keys, hand, trees["rod"], seed=3)
    assert trace.phases == made.phases
    np.testing.assert_array_equal(trace.flexion_rad, made.flexion_rad)


def test_object_that_is_not_named_or_not_there_is_refused(tmp_path, pack):
    out = tmp_path / "out.mcap"
    with pytest.raises(PalmarError, match=r"E-CONF object: .* holds 2 objects; name one of ball, rod"):
        script("grasp", pack, out)
    with pytest.raises(PalmarError, match=r"E-CONF object: 'rood' is not in .*two.pack \(nearest: rod\)"):
        script("grasp", pack, out, object="rood")
    assert not out.exists()
