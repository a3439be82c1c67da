import json

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS
from palmar.traces.adroit_door import COLUMNS, pose_in_frame, read_adroit_door
from palmar.traces.adroit_hand import hand_model, load_chain
from palmar.traces.kinematics import multiply, phalanges_in_palm, rotate

NUMBERS = ["00", "01", "03", "04", "06", "07", "08", "10", "12", "14", "15", "16", "18", "19", "22"]


@pytest.fixture(scope="module")
def folder(shared):
    return shared / "traces" / "adroit_door"


@pytest.fixture(scope="module")
def table(folder):
    return np.genfromtxt(folder / "door_06.csv", delimiter=",", names=True)


def world_positions(table, part):
    return np.column_stack([table[f"{part}_p{axis}_m"] for axis in "xyz"])


@pytest.mark.parametrize("number", NUMBERS)
def test_door_demonstration_comes_in(folder, number):
    trace = read_adroit_door(folder / f"door_{number}.csv")
    assert trace.header["hand"] == "adroit" and trace.header["object"] == "latch"
    assert trace.header["rate_hz"] == "100" and trace.time_s[0] == 0.07
    assert not trace.has_object_pose.any() and (trace.object_rotation_wxyz == [1, 0, 0, 0]).all()
    for column in (trace.palm_position_m, trace.palm_rotation_wxyz, trace.flexion_rad, trace.abduction_rad):
        assert np.isfinite(column).all()
    np.testing.assert_allclose(np.linalg.norm(trace.palm_rotation_wxyz, axis=1), 1, rtol=0, atol=1e-15)  # roundings
    # The fastest filtered command turns 0.16 rad a row; the fit may add a tenth.
    assert np.abs(np.diff(trace.flexion_rad, axis=0)).max() < 0.18
    assert np.abs(np.diff(trace.abduction_rad, axis=0)).max() < 0.18
    # The little finger's metacarpal moves its knuckle by up to 12 mm, which no other joint can do.
    sentences = [s for s in json.loads(trace.header["assumptions"]) if "tip error" in s]
    most_mm = [float(s.split(" mm max")[0].split()[-1]) for s in sentences]
    assert len(most_mm) == 2 and most_mm[0] < 1.6 and most_mm[1] < 15


def test_palm_in_the_latch_frame_goes_back_to_the_world(folder, table):
    trace = read_adroit_door(folder / "door_06.csv")
    latch = Rotation.from_quat(np.column_stack([table[f"latch_q{axis}"] for axis in "xyzw"]))[7:]
    back = latch.apply(trace.palm_position_m) + world_positions(table, "latch")[7:]
    # 1e-6: the file has six digits, so the latch's quaternion is of unit length to that only
    np.testing.assert_allclose(back, world_positions(table, "palm")[7:], rtol=0, atol=1e-6)
    palm = latch * Rotation.from_quat(np.roll(trace.palm_rotation_wxyz, -1, axis=1))
    recorded = Rotation.from_quat(np.column_stack([table[f"palm_q{axis}"] for axis in "xyzw"]))[7:]
    assert (palm.inv() * recorded).magnitude().max() < 1e-6


def test_pose_in_a_frame_and_back_is_the_pose():
    generator = np.random.default_rng(5)
    pose, frame = (
        (generator.normal(size=(40, 3)), np.roll(Rotation.random(40, generator).as_quat(), 1, axis=1)) for _ in range(2)
    )
    position, rotation = pose_in_frame(pose, frame)
    # 1e-14: roundings at 3 m
    np.testing.assert_allclose(rotate(frame[1], position) + frame[0], pose[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(multiply(frame[1], rotation), pose[1], rtol=0, atol=1e-14)


def test_moving_object_and_latch_frame_are_one_motion(folder):
    still = read_adroit_door(folder / "door_06.csv")
    moving = read_adroit_door(folder / "door_06.csv", object_frame="moving")
    assert moving.has_object_pose.all()
    palm = (moving.palm_position_m, moving.palm_rotation_wxyz)
    position, rotation = pose_in_frame(palm, (moving.object_position_m, moving.object_rotation_wxyz))
    np.testing.assert_array_equal(position, still.palm_position_m)
    np.testing.assert_array_equal(rotation, still.palm_rotation_wxyz)


def test_filter_takes_the_noise_and_leaves_the_motion(folder):
    raw, smooth = (read_adroit_door(folder / "door_06.csv", filter_hz=hz, lead_ms=0).flexion_rad for hz in (0, None))
    noise = [np.std(np.diff(flexion[:, 1:4], n=2, axis=0)) for flexion in (raw, smooth)]
    # White noise passes 6 Hz of 50 and its second difference far less; a factor of 20 is half of what theory gives.
    assert noise[1] < noise[0] / 20
    # Clipping at zero hides part of the noise; what is left has the stated size of 0.058 rad.
    assert 0.03 < np.std((raw - smooth)[:, 1:4]) < 0.06


def test_lead_moves_commands_later_by_whole_rows(folder):
    plain, later = (read_adroit_door(folder / "door_06.csv", lead_ms=ms) for ms in (0, 70))
    assert len(plain.time_s) == len(later.time_s) + 7
    np.testing.assert_array_equal(later.palm_position_m, plain.palm_position_m[7:])
    # 1e-12 rad: times such as 0.08 - 0.07 are not exactly a row's
    np.testing.assert_allclose(later.flexion_rad[:, 1:4], plain.flexion_rad[:-7, 1:4], rtol=0, atol=1e-12)


def test_default_lead_brings_commands_nearest_to_the_hand_in_free_motion(folder):
    recorded = read_adroit_door(folder / "door_06.csv", angles="recorded").flexion_rad[:, 1:4]
    rms = {}
    for lead_ms in (0, 70, 140):
        trace = read_adroit_door(folder / "door_06.csv", lead_ms=lead_ms)
        # Rows 20 to 70: the start from zero angles is over, the door is not yet touched.
        first = len(recorded) - len(trace.time_s)
        rms[lead_ms] = np.sqrt(np.mean((trace.flexion_rad[20 - first : 70 - first, 1:4] - recorded[20:70]) ** 2))
    assert rms[70] < rms[0] and rms[70] < rms[140]


def test_recorded_angles_come_as_they_are(folder, table):
    trace = read_adroit_door(folder / "door_06.csv", angles="recorded")
    assert len(trace.time_s) == len(table)
    expected = np.maximum(
        table["q_index_pip_flex"], 0
    )  # the simulated joint overshoots its limit of 0 by some milliradians
    np.testing.assert_array_equal(trace.flexion_rad[:, 1, 1], np.minimum(expected, 1.571))


@pytest.mark.parametrize("finger", [1, 2, 3])
def test_recorded_hand_is_as_far_from_the_latch_as_its_simulator_says(folder, table, finger):
    """The file's gap columns are MuJoCo's: they judge palm pose, latch frame, hand model and angles at once."""
    trace = read_adroit_door(folder / "door_06.csv", angles="recorded")
    hand = hand_model(*load_chain(folder / "adroit_hand.json"))
    gap_m = table[f"gap_{FINGERS[finger]}_m"]
    near = np.flatnonzero(gap_m < 0.045)[::3]  # farther ones are clipped at 0.05
    phalanges = phalanges_in_palm(hand, trace.flexion_rad[near], trace.abduction_rad[near])[:, finger]
    ends = rotate(trace.palm_rotation_wxyz[near, None, None], phalanges) + trace.palm_position_m[near, None, None]
    points = ends[:, :, None, 0] + np.linspace(0, 1, 49)[:, None] * (ends[:, :, None, 1] - ends[:, :, None, 0])
    latch = trimesh.load(folder / "latch.obj")
    distance = igl.signed_distance(points.reshape(-1, 3), np.array(latch.vertices), np.array(latch.faces))[0]
    ours_m = (distance.reshape(points.shape[:-1]) - hand.phalanx_radius_m[finger, :, :1]).min((1, 2))
    # The mesh lies up to 0.04 mm inside the simulator's round handle; where the door is nearer, theirs is less.
    assert (ours_m - gap_m[near]).min() > -1e-5
    assert 0 < np.median(ours_m - gap_m[near]) < 4e-5


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"angles": "both"}, "E-CONF angles: 'both'; allowed are command, recorded"),
        ({"object_frame": "world"}, "E-CONF object_frame: 'world'; allowed are latch, moving"),
        ({"filter_hz": -1}, "E-CONF filter_hz: -1; allowed is 0 to 40"),
        ({"filter_hz": "six"}, "E-CONF filter_hz: 'six'; allowed is 0 to 40"),
        ({"lead_ms": float("nan")}, "E-CONF lead_ms: nan; allowed is 0 to 500"),
        (
            {"angles": "recorded", "filter_hz": 6},
            "E-CONF filter_hz: applies to commands; recorded angles are taken as they are",
        ),
    ],
)
def test_wrong_option_is_refused(options, said):
    with pytest.raises(PalmarError) as caught:
        read_adroit_door("never_read.csv", **options)
    assert str(caught.value) == said


def write_rows(path, rows, step_s=0.01):
    lines = [",".join(COLUMNS)]
    for i in range(rows):
        row = dict.fromkeys(COLUMNS, "0") | {"t_s": f"{i * step_s:g}", "palm_qw": "1", "latch_qw": "1"}
        lines.append(",".join(row.values()))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_missing_hand_is_refused(tmp_path):
    with pytest.raises(BadTrace, match=r"E-TRACE-MISSING .*adroit_hand.json"):
        read_adroit_door(write_rows(tmp_path / "door.csv", 20))


def test_too_short_a_log_is_refused(tmp_path, folder):
    hand_json = folder / "adroit_hand.json"
    with pytest.raises(BadTrace, match=r"E-TRACE-EMPTY .*9 rows; the filter needs 10"):
        read_adroit_door(write_rows(tmp_path / "door.csv", 9), hand_json=hand_json)
    with pytest.raises(BadTrace, match=r"E-TRACE-EMPTY .*shorter than the lead of 500 ms"):
        read_adroit_door(write_rows(tmp_path / "door.csv", 20), hand_json=hand_json, lead_ms=500)


def test_uneven_steps_are_not_filtered(tmp_path, folder):
    path = write_rows(tmp_path / "door.csv", 20)
    path.write_text(path.read_text().replace("\n0.05,", "\n0.053,"))
    with pytest.raises(BadTrace, match=r"E-TRACE-TIME .*line 7: step of 0.013 s"):
        read_adroit_door(path, hand_json=folder / "adroit_hand.json")


def test_cut_recording_is_refused_in_one_line(tmp_path, folder):
    content = (folder / "door_06.csv").read_text()
    path = tmp_path / "door.csv"
    path.write_text(content[: len(content) // 2])
    with pytest.raises(BadTrace, match=r"E-TRACE-VALUE .*: the last line does not end"):
        read_adroit_door(path, hand_json=folder / "adroit_hand.json")
