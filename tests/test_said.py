"""What verbs print where nobody asked for JSON: the same facts, for a person."""

import re
from itertools import product

import pytest
from made_trace import make_trace

from palmar import load_pack, read_run
from palmar.cli import STOPPED
from palmar.records import read_trace, write_trace


@pytest.fixture
def cube(run, tmp_path):
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (tmp_path / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    write_trace(tmp_path / "down.mcap", make_trace())
    code, out, errors = run("build", "shape:cube", "-o", "cube.pack", "--spheres-csv", "cube.csv")
    assert (code, errors) == (0, [])
    return out


def field(text, name):
    """What stands behind a name at the start of a line."""
    return re.search(rf"^ *{re.escape(name)} +(.*)$", text, re.MULTILINE)[1].strip()


def test_a_pack_a_trace_and_a_run_are_shown_with_their_numbers(run, cube, tmp_path):
    pack = load_pack(tmp_path / "cube.pack")
    assert field(cube, "sha256") == pack.sha256
    code, out, errors = run("show", "cube.pack")
    assert (code, errors) == (0, []) and field(out, "sha256") == pack.sha256
    assert field(out, "hand name") == pack.hand.about["name"]
    assert re.search(r"cube +shape:cube +70\.0 x 70\.0 x 70\.0 +12\b", out)
    for level, spheres in enumerate(pack.objects["cube"].levels):
        row = rf"cube +{level} +{len(spheres)} +\d"  # and its errors
        assert re.search(row, out) and re.search(row, cube)

    assert run("replay", "cube.pack", "down.mcap", "-o", "a.run.mcap")[0] == 0
    trace, answer = read_trace(tmp_path / "down.mcap"), read_run(tmp_path / "a.run.mcap")
    out = run("show", "down.mcap")[1]
    assert field(out, "kind") == "trace" and field(out, "samples") == str(len(trace.time_s))
    assert field(out, "device") == trace.header["device"]
    out = run("show", "a.run.mcap")[1]
    assert field(out, "steps") == str(len(answer.time_s)) and field(out, "contacts_max") == str(answer.contacts.max())
    assert field(out, "ok") == str((answer.status == 0).sum()) and "step CPU time, us" in out


def test_measurements_are_told_finger_by_finger(run):
    flags = ("--hand-length-mm", "175", "--length-mm", "index=38,22,14", "--side", "left")
    code, out, errors = run("calibrate", "-o", "me.toml", *flags)
    assert (code, errors) == (0, [])
    assert field(out, "hand length mm") == "175" and field(out, "index") == "38.00  22.00  14.00"


def test_faults_are_put_in_and_counted(run, cube, tmp_path):
    (tmp_path / "faults.toml").write_text('[[disturbance]]\nkind = "zeros"\nat_s = 0.01\nfor_s = 0.01\n')
    code, out, errors = run("disturb", "down.mcap", "faults.toml", "-o", "bad.mcap")
    assert (code, errors) == (0, []) and "bad.mcap" in out
    before, after = read_trace(tmp_path / "down.mcap"), read_trace(tmp_path / "bad.mcap")
    assert 0 < (before.palm_position_m != after.palm_position_m).any(axis=1).sum() < len(before.time_s) / 2


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (MemoryError(), 2, ["E-MEMORY palmar: the system gives no more memory"]),
        (PermissionError(13, "Permission denied", "a.pack"), 2, ["E-FILE a.pack: Permission denied"]),
        (KeyboardInterrupt(), STOPPED, []),
    ],
)
def test_what_is_no_fault_of_palmars_is_no_bug(run, cube, monkeypatch, raised, code, said):
    def fail(*arguments):
        raise raised

    monkeypatch.setattr("palmar.show.describe", fail)
    assert run("show", "cube.pack") == (code, "", said)
