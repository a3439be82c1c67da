import json

import numpy as np
import pytest

from palmar.errors import BadTrace
from palmar.traces.scenario_csv import COLUMNS, read_scenario_csv


@pytest.mark.parametrize("name", ["scenario_grasp.csv", "scenario_grasp_noise.csv"])
def test_reference_scenario_comes_in_value_by_value(shared, name):
    path = shared / "scenarios" / name
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    trace = read_scenario_csv(path)
    np.testing.assert_array_equal(trace.time_s, table[:, 0])
    np.testing.assert_array_equal(trace.palm_position_m, table[:, 1:4])
    # The file has nine digits, so its quaternions are of unit length to 1e-9 only.
    np.testing.assert_allclose(trace.palm_rotation_wxyz, table[:, 4:8], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(trace.flexion_rad.reshape(-1, 15), table[:, 8:23])
    assert not trace.abduction_rad.any() and not trace.has_object_pose.any() and trace.tracked.all()
    assert trace.header["hand"] == "reference" and trace.header["side"] == "left" and trace.header["rate_hz"] == "1000"


def test_reference_scenario_keeps_its_phases(shared):
    phases = read_scenario_csv(shared / "scenarios" / "scenario_grasp.csv").phases
    assert [phase["name"] for phase in phases] == ["approach", "close", "slide", "hold", "leave"]
    assert [phase["start_s"] for phase in phases] == [0.0, 0.6, 1.6, 3.6, 5.0]
    assert [phase["end_s"] for phase in phases] == [0.6, 1.6, 3.6, 5.0, 5.999]


def test_hold_of_the_reference_scenario_is_constant_to_the_bit(shared):
    trace = read_scenario_csv(shared / "scenarios" / "scenario_grasp.csv")
    held = (trace.time_s >= 3.6) & (trace.time_s < 5.0)
    for column in (trace.palm_position_m, trace.palm_rotation_wxyz, trace.flexion_rad):
        assert (column[held] == column[held][0]).all()


def test_header_says_what_was_assumed(tmp_path):
    path = tmp_path / "one.csv"
    row = dict.fromkeys(COLUMNS, "0") | {"qw": "1"}
    path.write_text(",".join(row) + "\n" + ",".join(row.values()) + "\n")
    trace = read_scenario_csv(path)
    sentences = json.loads(trace.header["assumptions"])
    assert all(sentence.endswith(".") for sentence in sentences)
    assert any("abduction" in sentence for sentence in sentences)


def test_unknown_phase_is_refused(tmp_path):
    path = tmp_path / "one.csv"
    row = dict.fromkeys(COLUMNS, "0") | {"qw": "1", "phase": "5"}
    path.write_text(",".join(row) + "\n" + ",".join(row.values()) + "\n")
    with pytest.raises(BadTrace, match=r"E-TRACE-VALUE .*line 2, column phase: 5; phases are 0 approach"):
        read_scenario_csv(path)
