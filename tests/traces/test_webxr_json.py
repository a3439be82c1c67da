"""Captures of WebXR input as JSON, against the CSV of the same motion."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace, PalmarError
from palmar.records import read_trace
from palmar.tools.hand_file import default_hand
from palmar.traces.device import import_file, read_device
from palmar.traces.kinematics import conjugate, multiply, rotate
from palmar.traces.webxr import JOINTS, POSITION, ROTATION

from .made_logs import made_angles, webxr_log

COUNT = 40
SEQUENCE = list(reversed(JOINTS))  # names order the joints, not their places


@pytest.fixture
def capture(tmp_path):
    """The CSV and the same motion as a capture with full decimals, seen from a target ray that moves."""
    log = webxr_log(tmp_path / "webxr.csv", default_hand(), made_angles(COUNT))
    table = np.genfromtxt(log, delimiter=",", names=True, deletechars="")
    position = np.stack([np.column_stack([table[name] for name in POSITION[joint]]) for joint in SEQUENCE], axis=1)
    rotation = np.stack([np.column_stack([table[name] for name in ROTATION[joint]]) for joint in SEQUENCE], axis=1)
    ray = Rotation.from_rotvec(np.linspace([0.1, 0.2, 0.3], [1.0, -0.5, 0.2], COUNT)).as_quat(scalar_first=True)
    origin = np.linspace([0.0, 1.0, 0.0], [0.3, 1.2, -0.4], COUNT)
    back = conjugate(ray)[:, None]
    joints = np.concatenate(
        [
            rotate(back, position - origin[:, None]),
            np.roll(multiply(back, rotation), -1, axis=-1),
            np.full((COUNT, 25, 1), 0.01),
        ],
        axis=-1,
    )
    about = {"handedness": "right", "hasGrip": True, "hasHand": True, "hasGamepad": False, "jointSequence": SEQUENCE}
    other = {"handedness": "left", "hasGrip": False, "hasHand": False, "hasGamepad": True}
    frames = [
        [
            1e3 * table["t_s"][k] + 5000.0,
            *[0.0] * 7,
            [0, *[0.0] * 7, []],
            [1, *origin[k], *np.roll(ray[k], -1), [0.0] * 7, joints[k].ravel().tolist()],
        ]
        for k in range(COUNT)
    ]
    return log, {"schema": [[0, other], [1, about]], "frames": frames}


def test_the_hand_of_a_capture_is_that_of_the_csv(capture, tmp_path):
    log, said = capture
    (tmp_path / "cap.json").write_text(json.dumps(said))
    answer = import_file(tmp_path / "cap.json", tmp_path / "a.mcap", hand=default_hand())
    import_file(log, tmp_path / "b.mcap", hand=default_hand())
    got, expected = read_trace(tmp_path / "a.mcap"), read_trace(tmp_path / "b.mcap")
    assert answer["format"] == "webxr-json" and answer["samples"] == COUNT
    # The CSV has nine decimals: 1e-9 m, and angles from points 2 cm apart, amplified by the solve.
    np.testing.assert_allclose(got.flexion_rad, expected.flexion_rad, rtol=0, atol=1e-5)
    np.testing.assert_allclose(got.palm_position_m, expected.palm_position_m, rtol=0, atol=1e-7)
    np.testing.assert_allclose(got.time_s, expected.time_s, rtol=0, atol=2e-9)


def test_a_frame_without_the_hand_is_not_tracked(capture, tmp_path):
    _, said = capture
    del said["frames"][4][-1]
    said["frames"][7][-1][4:8] = [0.0, 0.0, 0.0, 0.0]  # a ray that was not known
    (tmp_path / "cap.json").write_text(json.dumps(said))
    recording = read_device(tmp_path / "cap.json")
    assert np.flatnonzero(~recording.palm_seen).tolist() == [4, 7]
    assert np.isnan(recording.points_m[[4, 7]]).all() and np.isfinite(recording.palm_position_m).all()


def test_mistakes_are_named(capture, tmp_path):
    _, said = capture
    path = tmp_path / "cap.json"
    text = json.dumps(said)
    missing = text.replace('"wrist"', '"elbow"')
    short = json.loads(text)
    short["frames"][3][-1][-1].pop()
    still = json.loads(text)
    still["frames"][3][0] = still["frames"][2][0]
    for content, what in (
        (text[:-40], "E-TRACE-FORMAT"),
        (missing, "wrist"),
        (json.dumps(short), "206 numbers; 207 are needed"),
        (json.dumps(still), "frame 3: its time does not increase"),
        (text.replace('"handedness": "right"', '"handedness": "none"'), "has no right hand"),
        ('{"schema": [[', "E-TRACE-FORMAT"),
    ):
        path.write_text(content)
        with pytest.raises(BadTrace) as caught:
            read_device(path)
        assert what in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(PalmarError, match="allowed are right, left"):
        read_device(path, side="both")
