"""A hand from key to key: where it is and when, what noise and faults do to it, and mistakes by name."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.records import read_trace, write_trace
from palmar.traces.keyframes import extreme_point, key_trace, place_keys
from palmar.traces.kinematics import phalanges_in_palm
from palmar.traces.scene_file import cases_of, check_scene
from palmar.traces.scripted import SCENES, load_scene, script_trace

KEYS = {
    "kind": "keys",
    "id": "P1",
    "why": "a scene of the tests " * 5,
    "object": {"kind": "plate"},
    "key": [
        {"position_m": [0.0, 0.0, 0.1], "flexion_rad": {"all": [0.1, 0.2, 0.3], "index": [0.5, 0.5, 0.5]}},
        {"move_m": [0.0, 0.0, -0.1], "speed_m_per_s": 0.5, "phase": "approach"},
        {"after_s": 0.1, "turn_rad": [0.0, 0.0, 1.0], "phase": "hold"},
    ],
}


def scene_of(**changes):
    return check_scene(KEYS | changes, "test")


def test_positions_speeds_and_postures_are_those_of_the_keys(hand):
    trace = key_trace(scene_of(), hand)
    assert len(trace.time_s) == 301
    np.testing.assert_allclose(np.diff(trace.palm_position_m[:201, 2]), -0.0005, atol=1e-15)
    np.testing.assert_array_equal(trace.palm_position_m[200:], 0.0)
    np.testing.assert_array_equal(trace.flexion_rad[:, 1], 0.5)
    np.testing.assert_array_equal(trace.flexion_rad[:, [0, 2, 3, 4]], np.tile([0.1, 0.2, 0.3], (301, 4, 1)))
    turned = Rotation.from_quat(np.roll(trace.palm_rotation_wxyz, -1, axis=1)).as_rotvec()[:, 2]
    np.testing.assert_allclose(turned[200:], np.linspace(0, 1, 101), atol=1e-12)
    names = [(phase["name"], phase["start_s"], phase["end_s"]) for phase in trace.phases]
    assert names == [("approach", 0.0, 0.2), ("hold", 0.2, pytest.approx(0.3))]


def test_a_hand_that_is_told_to_stay_stays_to_the_last_bit(hand):
    keys = [KEYS["key"][0] | {"turn_rad": [0.3, 0.2, 0.1]}, {"after_s": 0.2, "move": "min_jerk"}]
    trace = key_trace(scene_of(key=keys), hand)
    for name in ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad"):
        column = getattr(trace, name)
        assert np.array_equal(column, np.broadcast_to(column[0], column.shape)), name


def test_a_jump_is_one_step(hand):
    jump = {"move_m": [0.06, 0.0, 0.0], "after_s": 0.05, "move": "hold"}
    trace = key_trace(scene_of(key=[KEYS["key"][0], jump, {"after_s": 0.05}]), hand)
    steps = np.diff(trace.palm_position_m[:, 0])
    assert np.count_nonzero(steps) == 1 and steps.max() == pytest.approx(0.06)


@pytest.mark.parametrize("hold_hz", [60.0, 90.0, 200.0])
def test_a_held_sample_is_kept_until_the_device_speaks_again(hand, hold_hz):
    for start in range(5):
        trace = key_trace(scene_of(hold_hz=hold_hz, starts=5), hand, start)
        z = trace.palm_position_m[:201, 2]
        jumps = np.flatnonzero(np.diff(z))
        assert set(np.diff(jumps)) <= {int(1000 / hold_hz), int(np.ceil(1000 / hold_hz))}
        np.testing.assert_allclose(np.diff(z)[jumps][:-1], -0.5 / hold_hz, rtol=1e-9)


def test_starts_cover_the_time_of_one_sample(hand):
    firsts = np.array([key_trace(scene_of(hold_hz=60.0, starts=60), hand, k).palm_position_m[0, 2] for k in range(60)])
    late = (0.1 - firsts) / 0.5 * 60.0  # in samples
    # One start in each of sixty equal parts.
    np.testing.assert_array_equal(np.floor(late * 60 + 1e-9), np.arange(60))


def test_the_named_point_of_the_hand_is_where_the_first_key_says(hand):
    for part in ("palm", "index", "hand"):
        scene = scene_of(point=part, towards=[0.0, 0.3, -1.0], key=[{"position_m": [0.1, 0.2, 0.3]}, {"after_s": 0.1}])
        place = place_keys(scene.key, hand, scene)
        towards = np.array([0.0, 0.3, -1.0]) / np.linalg.norm([0.0, 0.3, -1.0])
        point = place.position_m[0] + extreme_point(hand, place[0:1], part, towards)
        np.testing.assert_allclose(point, [0.1, 0.2, 0.3], atol=1e-15)
        balls = {
            "palm": hand.palm_spheres_m,
            # This hand's phalanges are capsules: both ends are the centres of their spheres.
            "index": np.concatenate(
                [
                    phalanges_in_palm(hand, np.zeros((1, 5, 3)), np.zeros((1, 5)))[0, 1].reshape(-1, 3),
                    hand.phalanx_radius_m[1].reshape(-1, 1),
                ],
                axis=1,
            ),
        }.get(part)
        if balls is not None:
            reach = (place.position_m[0] + balls[:, :3]) @ towards + balls[:, 3]
            assert reach.max() == pytest.approx(point @ towards, abs=1e-15)


def test_noise_has_the_size_and_the_band_that_are_asked_for(hand):
    still = [KEYS["key"][0], {"after_s": 8.0}]
    white = key_trace(scene_of(key=still, noise={"position_m": 1e-4, "joint_rad": 1e-3}), hand)
    assert white.palm_position_m.std(axis=0) == pytest.approx([1e-4] * 3, rel=0.05)  # 8001 samples: 1 % is one sigma
    assert white.flexion_rad.std(axis=0).mean() == pytest.approx(1e-3, rel=0.02)
    tremor = key_trace(scene_of(key=still, noise={"position_m": 1e-4, "band_hz": [8.0, 12.0]}), hand)
    power = np.abs(np.fft.rfft(tremor.palm_position_m[:, 0] - tremor.palm_position_m[:, 0].mean())) ** 2
    frequency = np.fft.rfftfreq(8001, 1e-3)
    assert power[(frequency < 7.9) | (frequency > 12.1)].sum() < 1e-20 * power.sum() + 1e-20
    coarse = key_trace(scene_of(noise={"joint_rad": 1e-3, "quantum_rad": 0.0061}), hand)
    np.testing.assert_allclose(coarse.flexion_rad / 0.0061, np.round(coarse.flexion_rad / 0.0061), atol=1e-9)


def test_faults_come_when_they_are_asked_for_and_are_named(hand):
    faults = [
        {"kind": "spike", "at_s": 0.05, "for_s": 0.001, "move_m": [0.07, 0.0, 0.0]},
        {"kind": "frozen", "at_s": 0.1, "for_s": 0.02},
        {"kind": "untracked", "at_s": 0.15, "for_s": 0.02},
        {"kind": "zeros", "at_s": 0.18, "for_s": 0.002},
    ]
    trace, sound = key_trace(scene_of(disturbance=faults), hand), key_trace(scene_of(), hand)
    assert np.flatnonzero(trace.palm_position_m[:, 0]).tolist() == [50]
    np.testing.assert_array_equal(trace.palm_position_m[100:120, 2], sound.palm_position_m[99, 2])
    # Zeros that a failed read delivers are no pose.
    np.testing.assert_array_equal(np.flatnonzero(~trace.tracked), [*range(150, 170), 180, 181])
    np.testing.assert_array_equal(trace.flexion_rad[180:182], sound.flexion_rad[[179, 179]])
    changed = (trace.palm_position_m != sound.palm_position_m).any(axis=1)
    assert set(np.flatnonzero(changed)) <= {50, *range(100, 120), *range(150, 170), 180, 181}
    assert [phase["start_s"] for phase in trace.phases if phase["name"] == "disturbance"] == [0.05, 0.1, 0.15, 0.18]


def test_the_object_moves_by_its_own_keys(hand):
    keys = [{"object_position_m": [0.0, 0.0, 0.0]}, {"object_position_m": [0.0, 0.0, 0.1], "after_s": 0.1}]
    trace = key_trace(scene_of(key=keys), hand)
    assert trace.has_object_pose.all()
    np.testing.assert_allclose(trace.object_position_m[:, 2], np.linspace(0, 0.1, 101), atol=1e-15)
    assert not key_trace(scene_of(), hand).has_object_pose.any()


def test_random_targets_stay_in_their_box_and_come_from_the_seed(hand):
    keys, where, _ = load_scene("random_targets")
    scene = check_scene(cases_of(keys, where.name)[0][1], where.name)
    a, b, other = (key_trace(scene, hand, start) for start in (0, 0, 1))
    np.testing.assert_array_equal(a.palm_position_m, b.palm_position_m)
    assert not np.array_equal(a.palm_position_m, other.palm_position_m)
    later = a.palm_position_m[a.time_s > scene.every_s[1]]
    assert (later >= np.array(scene.low_m) - 1e-12).all() and (later <= np.array(scene.high_m) + 1e-12).all()
    assert a.flexion_rad.min() >= scene.flexion_rad[0] and a.flexion_rad.max() <= scene.flexion_rad[1]


def test_sweeps_multiply_and_what_stands_in_one_table_goes_together():
    sweep = [
        {"hold_hz": [60.0, 90.0]},
        {
            "key.1.speed_m_per_s": [0.1, 0.2, 0.4],
            "limits.hover p99": [{"limit": x, "reason": "ten letters"} for x in (1, 2, 3)],
        },
    ]
    cases = cases_of(KEYS | {"sweep": sweep}, "test")
    assert [name for name, _ in cases][:2] == ["hold_hz 60, speed_m_per_s 0.1", "hold_hz 60, speed_m_per_s 0.2"]
    found = [(c["hold_hz"], c["key"][1]["speed_m_per_s"], c["limits"]["hover p99"]["limit"]) for _, c in cases]
    assert found == [(h, s, k) for h in (60.0, 90.0) for s, k in ((0.1, 1), (0.2, 2), (0.4, 3))]


def test_what_eval_is_to_know_stands_in_the_header_and_survives_the_file(hand, tmp_path):
    region = {"half_spaces": [[0.0, 0.0, -1.0, 0.006]], "links": [4]}
    limit = {"hover p99": {"reason": "a row with dents"}}
    write_trace(tmp_path / "a.mcap", key_trace(scene_of(far_side=[region], limits=limit), hand))
    header = read_trace(tmp_path / "a.mcap").header
    assert json.loads(header["far_side"]) == [region]
    assert json.loads(header["limits"]) == {"hover p99": {"limit": None, "reason": "a row with dents"}}


OWN_OBJECT = [path.stem for path in sorted(SCENES.glob("*.toml")) if load_scene(path.stem)[0]["kind"] != "grasp"]


@pytest.mark.parametrize("name", OWN_OBJECT)
def test_every_case_of_a_scene_makes_samples_inside_the_time_it_says(name, hand):
    keys, where, _ = load_scene(name)
    for _, table in cases_of(keys, where.name):
        trace = key_trace(check_scene(table, where.name), hand)
        assert 0.05 < trace.time_s[-1] < 60 and np.isfinite(trace.palm_position_m).all()
    assert script_trace(keys, hand, None, 0).header["device"] == "script"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"key": [{}]}, "E-CONF my.toml:key: "),
        (
            {"key": [{}, {"afer_s": 1}]},
            "E-CONF my.toml:key.1.afer_s: unknown key (nearest: after_s); known are after_s, ",
        ),
        ({"key": [{}, {"after_s": 1, "speed_m_per_s": 1}]}, "E-CONF my.toml:key.1: "),
        ({"id": "first"}, "E-CONF my.toml:id: found 'first'; allowed is "),
        ({"limits": {"hover p99": {"limit": 1}}}, "E-CONF my.toml:limits.hover p99.reason: key is missing"),
        ({"noise": {"position_mm": 1}}, "E-CONF my.toml:noise.position_mm: unknown key (nearest: position_m)"),
    ],
)
def test_a_wrong_key_is_refused_by_name(change, said):
    with pytest.raises(PalmarError) as caught:
        check_scene(KEYS | change, "my.toml")
    assert str(caught.value).startswith(said)


def test_a_sweep_of_no_place_or_of_uneven_lists_and_a_key_without_time_are_refused(hand):
    with pytest.raises(PalmarError, match=r"E-CONF my.toml:sweep: 'key.9.after_s' is no place"):
        cases_of(KEYS | {"sweep": [{"key.9.after_s": [1]}]}, "my.toml")
    with pytest.raises(PalmarError, match=r"E-CONF my.toml:sweep.0: lists"):
        cases_of(KEYS | {"sweep": [{"hold_hz": [60], "starts": [1, 2]}]}, "my.toml")
    with pytest.raises(PalmarError, match=r"E-CONF key.1: no after_s"):
        key_trace(scene_of(key=[{}, {"speed_m_per_s": 1.0}]), hand)
