"""What verbs print where nobody asked for JSON: the same facts, for a person."""

import io
import re
from itertools import product

import pytest
from made_trace import make_trace

from palmar import load_pack, read_run
from palmar.cli import STOPPED
from palmar.cli_judge import _recomputed
from palmar.records import read_trace, write_trace
from palmar.show import print_fit, print_residuals
from palmar.terminal import progress_bar


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


def test_a_bar_is_for_a_terminal_alone(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for there, wanted, told in ((Terminal(), True, True), (Terminal(), False, False), (io.StringIO(), True, False)):
        monkeypatch.setattr("sys.stderr", there)
        with progress_bar(wanted) as progress:
            progress("fitting", 0.5)
        assert ("fitting" in there.getvalue()) == told


def test_a_fitted_hand_is_told_part_by_part(capsys):
    stats = {"max": 3.5, "p99": 2.5, "mean": 0.5}
    error = {part: {"protrusion_mm": stats, "gap_mm": {**stats, "max": 4.5}} for part in ("palm", "phalanges")}
    residual = {"index": {"p50": 0.25, "p99": 1.25, "max": 7.75}}
    hand = {"error": {"rest": error, "sweep": error, "volume_ratio": 1.01}, "scan": {"residual_mm": residual}}
    hand |= {"side": "left", "palm": {"kept": 94}, "axes": "skin"}
    print_fit({"hand": hand, "out": "h.safetensors", "sha256": "abc"})
    out = capsys.readouterr().out
    for part in error:
        assert field(out, part).split() == ["3.5", "2.5", "0.5", "4.5", "2.5", "0.5", "2.5", "2.5"]
    assert field(out, "index").split() == ["0.25", "1.25", "7.75"]
    assert (field(out, "hand"), field(out, "palm spheres"), field(out, "sha256")) == ("h.safetensors", "94", "abc")


def test_residuals_are_told_point_by_point(capsys):
    print_residuals({"index": {"tip": {"p50": 1.5, "p99": 2.5, "max": 3.5}}, "fingertips": {"p50": 4.5, "max": 5.5}})
    out = capsys.readouterr().out
    assert field(out, "index").split() == ["tip", "1.5", "2.5", "3.5"]
    assert field(out, "fingertips").split() == ["all", "4.5", "5.5"]


def test_what_the_judge_found_again_is_told():
    found = {"contacts": 2500, "steps": 1000, "same": False, "gap_mm": 0.25, "tolerance_mm": 1e-6}
    said = "recomputed: 2,500 contacts of 1,000 random steps, gaps NOT equal to 0.25 mm (allowed 1e-06)"
    assert _recomputed(found) == [said]
    assert _recomputed(None) == _recomputed({**found, "contacts": 0}) == []
