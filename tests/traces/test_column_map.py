"""Logs of any device by a map of their columns: the numbers that come out, and every mistake in map or log by name."""

import json
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS
from palmar.records import read_trace
from palmar.tools.hand_file import default_hand
from palmar.traces.column_map import read_column_map
from palmar.traces.device import import_file

ROWS = 20
MAP = """
device = "my glove"
hand = "median adult"
side = "right"
delimiter = ";"
time = { column = "ms", unit = "ms", from_zero = true }
palm_position = { columns = ["X", "Y", "Z"], unit = "mm", sign = [1, 1, -1] }
palm_rotation = { columns = ["rx", "ry", "rz"], form = "vector", unit = "deg" }
tracked = "ok"

[flexion]
thumb = { columns = ["t1", "t2", "t3"], unit = "deg", sign = -1 }
index = { columns = ["i2", "i1", "i3"], joints = ["PIP", "MCP", "DIP"], unit = "deg", zero = [1.0, 2.0, 3.0] }
middle = { columns = ["m1", "m2", "m3"] }
ring = { columns = ["r1", "r2", "r3"] }
little = { columns = ["l1", "l2", "l3"] }

[abduction]
index = { column = "ia", unit = "deg" }
"""


def made_log():
    """A log as the map has it: names to text columns."""
    part = np.arange(ROWS) / ROWS
    log = {"ms": 5000.0 + 10.0 * np.arange(ROWS), "X": 100 * part, "Y": 5 + part, "Z": 300 + 40 * part}
    log |= {"rx": 90 * part, "ry": 3 + 0 * part, "rz": -2 * part, "ok": np.ones(ROWS)}
    for k, name in enumerate(f"{finger}{joint}" for finger in "timrl" for joint in "123"):
        log[name] = (part + 0.01 * k) * (-40 if name[0] == "t" else 40 if name[0] == "i" else 0.7)
    log["ia"] = 10 * part
    columns = {name: [repr(float(value)) for value in values] for name, values in log.items()}
    return log, columns | {"battery": ["good, still"] * ROWS}


def write_log(path, columns):
    lines = [";".join(columns), *(";".join(row) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def imported(tmp_path):
    """Import a log by a map; the trace and what was said."""

    def run(columns=None, text=MAP, **given):
        (tmp_path / "glove.toml").write_text(text)
        log = write_log(tmp_path / "log.csv", columns or made_log()[1])
        answer = import_file(log, tmp_path / "out.mcap", format=str(tmp_path / "glove.toml"), **given)
        return read_trace(tmp_path / "out.mcap"), answer

    return run


def test_units_signs_zeros_and_orders_are_those_of_the_map(imported):
    log, _ = made_log()
    trace, answer = imported()
    np.testing.assert_allclose(trace.time_s, 0.01 * np.arange(ROWS), rtol=0, atol=1e-12)
    expected = np.column_stack([log["X"], log["Y"], -log["Z"]]) * 1e-3
    np.testing.assert_allclose(trace.palm_position_m, expected, rtol=0, atol=1e-15)
    turn = Rotation.from_rotvec(np.column_stack([log["rx"], log["ry"], log["rz"]]), degrees=True)
    apart = turn.inv() * Rotation.from_quat(trace.palm_rotation_wxyz, scalar_first=True)
    assert apart.magnitude().max() < 1e-12
    np.testing.assert_allclose(trace.flexion_rad[:, 0, 1], -np.radians(log["t2"]), rtol=0, atol=1e-15)
    for joint, name, zero in ((0, "i1", 2.0), (1, "i2", 1.0), (2, "i3", 3.0)):
        np.testing.assert_allclose(trace.flexion_rad[:, 1, joint], np.radians(log[name] - zero), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(trace.flexion_rad[:, 3, 2], log["r3"])
    np.testing.assert_allclose(trace.abduction_rad[:, 1], np.radians(log["ia"]), rtol=0, atol=1e-15)
    assert (trace.abduction_rad[:, [0, 2, 3, 4]] == 0).all() and trace.tracked.all()
    assert (trace.header["device"], trace.header["hand"], trace.header["side"]) == ("my glove", "median adult", "right")
    assert answer["rate_hz"] == pytest.approx(100.0)
    assert answer["assumptions"] == [
        "Columns are what the map says; not used: battery; times are less 5 s; abduction 0 of thumb, middle, ring, "
        "little."
    ]
    assert answer["changed"] == {}


def test_joints_without_a_column_follow_the_hand_that_is_named(imported):
    columns = {name: values for name, values in made_log()[1].items() if name not in ("m3", "r2", "r3", "l1")}
    text = MAP.replace('"m1", "m2", "m3"', '"m1", "m2"').replace('"r1", "r2", "r3"', '"r1"')
    text = text.replace('columns = ["l1", "l2", "l3"]', 'columns = ["l2", "l3"], joints = ["PIP", "DIP"]')
    with pytest.raises(PalmarError, match="--hand"):
        imported(columns, text)
    hand = default_hand()
    trace, answer = imported(columns, text, hand=hand)
    ratio = hand.flexion_coupling
    middle, ring, little = (trace.flexion_rad[:, FINGERS.index(name)] for name in ("middle", "ring", "little"))
    np.testing.assert_allclose(middle[:, 2], middle[:, 1] * ratio[2, 1])
    np.testing.assert_allclose(ring[:, 2], ring[:, 0] * ratio[3, 0] * ratio[3, 1])
    np.testing.assert_allclose(little[:, 0], little[:, 1] / ratio[4, 0])
    assert "follow the coupling" in answer["assumptions"][-1] and trace.header["hand"] == hand.about["name"]


def test_rows_that_the_device_does_not_track_may_hold_anything(imported):
    columns = made_log()[1]
    for name in columns:
        if name not in ("ms", "battery"):
            columns[name][7] = ""
    columns["ok"][7] = "0"
    trace, _ = imported(columns)
    assert np.flatnonzero(~trace.tracked).tolist() == [7]
    np.testing.assert_array_equal(trace.flexion_rad[7], trace.flexion_rad[6])


def test_a_log_is_repaired_only_when_the_map_says_so_and_every_change_is_counted(imported):
    columns = made_log()[1]
    columns["i1"][3] = "nan"
    columns["X"][5] = "1e30"
    columns["Y"][6] = "broken"
    columns["ms"][9], columns["ms"][10] = columns["ms"][10], columns["ms"][9]
    columns["ms"][15] = columns["ms"][14]
    with pytest.raises(BadTrace, match=r"line 8, column Y: 'broken'"):
        imported(columns)
    trace, answer = imported(columns, "repair = true\n" + MAP)
    assert answer["changed"] == {"late or double": 2, "not a pose": 3}
    assert len(trace.time_s) == ROWS - 2 and np.flatnonzero(~trace.tracked).tolist() == [3, 5, 6]
    assert json.loads(trace.header["changed"]) == answer["changed"]


def test_the_map_of_the_document_is_one(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "traces.md").read_text()
    block = re.search(r"a map of its columns\n((?:    [^\n]*\n|\n)+)", text)
    (tmp_path / "glove.toml").write_text(textwrap.dedent(block[1]))
    columns = read_column_map(tmp_path / "glove.toml")
    assert columns.columns[:2] == ["ms", "valid"] and columns.flexion["middle"].joints == ["PIP", "MCP"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('column = "ms"', 'column = "sec"'), "column sec is missing; unknown here: "),
        (('unit = "mm"', 'unit = "ft"'), "palm_position.unit"),
        (('device = "my glove"', 'devise = "my glove"'), "unknown key (nearest: device)"),
        (('"i2", "i1", "i3"', '"i2", "i1"'), "flexion.index"),
        (('columns = ["r1", "r2", "r3"]', 'columns = ["r1", "r2", "r1"]'), "'r1' stands for two things"),
        (('form = "vector"', 'form = "quaternion"'), "4 columns"),
        (("ring = ", "fourth = "), "flexion"),
        (("[flexion]", "[flexion"), "not a TOML file"),
    ],
)
def test_a_mistake_in_the_map_is_named(imported, tmp_path, change, said):
    assert change[0] in MAP
    with pytest.raises(PalmarError) as caught:
        imported(text=MAP.replace(*change))
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "out.mcap").exists()


def test_swapped_names_and_no_rotations_are_refused_where_they_stand(imported):
    columns = made_log()[1]
    text = MAP.replace(
        '{ columns = ["rx", "ry", "rz"], form = "vector", unit = "deg" }', '{ columns = ["rx", "ry", "rz", "ok"] }'
    ).replace('tracked = "ok"\n', "")
    with pytest.raises(BadTrace, match=r"line 2.*quaternion that is no rotation"):
        imported(columns, text)
    # A thumb where the index should be is another name, not another order.
    renamed = {("T1" if name == "t1" else name): values for name, values in columns.items()}
    with pytest.raises(BadTrace, match="column t1 is missing; unknown here: T1, battery"):
        imported(renamed)
