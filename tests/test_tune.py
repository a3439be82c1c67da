"""The verb `tune` on a bar that a hand presses in its middle: what it keeps, what it promises, and its mistakes."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from made_trace import make_trace

from palmar import cli, load_pack, read_run, tune_cells
from palmar.eval.metrics import measure
from palmar.records import write_trace
from palmar.tools.cover import protrusion, union_gap
from palmar.tools.solid import make_solid, sample_surface

LENGTH, WIDTH = 0.3, 0.03  # metres
HAND = 0.08  # no part of the hand is farther from the bar's middle along it, and a guard beyond
FAR = 0.09  # a hand so far along touches where none did
# The full pack is within 0.7 mm, to be quick: its hover is beyond the default limit.
LINE = ("--jobs", "1", "--repeats", "1", "--tries", "3", "--guard-mm", "8", "--limit", "hover=0.9", "--json")


def write_bar(path):
    x, y, z = LENGTH / 2, WIDTH / 2, WIDTH / 2
    corners = [(a, b, c) for a in (-x, x) for b in (-y, y) for c in (-z, z)]
    faces = "1 2 4 3,5 7 8 6,1 5 6 2,3 4 8 7,1 3 7 5,2 6 8 4"
    lines = [f"v {a} {b} {c}" for a, b, c in corners]
    lines += [f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in (face.split() for face in faces.split(","))]
    path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """A folder with bar.pack, down.mcap, far.mcap, and the tuning in `t`; and its answer."""
    folder = tmp_path_factory.mktemp("tune")
    write_bar(folder / "bar.obj")
    down = make_trace(120)
    # So that fingers close on the bar, and the palm stays off it.
    place = down.palm_position_m - np.array([0, 0.1, 0])
    down = replace(down, flexion_rad=2 * down.flexion_rad, palm_position_m=place)
    write_trace(folder / "down.mcap", down)
    write_trace(folder / "far.mcap", replace(down, palm_position_m=down.palm_position_m + np.array([FAR, 0, 0])))
    line = ["build", folder / "bar.obj", "--units", "m", "--error-mm", "0.7", "-o", folder / "bar.pack"]
    assert cli.run([str(argument) for argument in line]) == 0
    inputs = [str(folder / name) for name in ("bar.pack", "down.mcap")]
    code = cli.run(["tune", *inputs, "--holdout", str(folder / "far.mcap"), "-o", str(folder / "t"), *LINE])
    assert code == 0
    return folder, json.loads((folder / "t" / "tune.json").read_text())


def test_spheres_are_fine_where_the_hand_came_and_coarse_elsewhere(tuned):
    folder, answer = tuned
    full, lean = (load_pack(folder / name).objects["bar"] for name in ("bar.pack", "t/lean.pack"))
    about = lean.about["tuned"]
    assert len(lean.leaves) < 0.6 * len(full.leaves)
    seen = np.array(about["seen"]).reshape(-1, 4) * 1e-4
    assert (np.abs(seen[:, 0]) + seen[:, 3]).max() < HAND + 0.008
    assert answer["share_seen"] < 0.5

    # Each part of the surface keeps what the manifest says of it, on samples that no fit has seen.
    solid = make_solid(lean.vertices_m, lean.faces)
    points, _ = sample_surface(solid, 20_000, 77)
    near = (np.linalg.norm(points[:, None] - seen[:, :3], axis=2) <= seen[:, 3]).any(axis=1)
    gap_mm = 1e3 * np.maximum(union_gap(lean.leaves, points), 0)
    assert np.quantile(gap_mm[near], 0.99) <= 1.05 * about["fine_mm"]  # 5 %: other samples than those of the fit
    assert np.quantile(gap_mm[~near], 0.99) <= 1.05 * about["rest_mm"]
    out, _ = protrusion(solid, lean.leaves, 5_000, 78)
    assert 1e3 * out.max() <= about["rest_mm"] + 1e-3


def test_the_lean_pack_keeps_every_limit_when_it_is_replayed_and_judged_once_more(tuned, tmp_path, capsys):
    folder, answer = tuned
    line = ["replay", folder / "t/lean.pack", folder / "down.mcap", "-o", tmp_path / "a.run.mcap"]
    assert cli.run([str(argument) for argument in line]) == 0
    assert capsys.readouterr().err == ""
    run, pack = read_run(tmp_path / "a.run.mcap"), load_pack(folder / "t/lean.pack")
    settings = json.loads(run.header["settings"])
    assert settings.items() >= pack.objects["bar"].about["tuned"]["settings"].items()
    rows, _ = measure(run, pack, "bar")
    value = {f"{row['metric']} {row['stat']}": row["value"] for row in rows}
    held = [row for row in answer["limits"] if row["allowed"] is not None]
    names = {row["metric"] for row in held}
    assert {"penetration_spheres max", "penetration_mesh max", "hover p99", "wrong_side sum"} <= names
    for row in held:
        assert row["value"] <= row["allowed"] <= row["limit"], row
        if row["metric"] in value:
            assert value[row["metric"]] == pytest.approx(row["value"], abs=1e-12), row


def test_no_promise_is_made_beyond_what_was_seen(tuned, tmp_path, capsys):
    folder, answer = tuned
    row = next(row for row in answer["outside"] if row["name"] == "far")
    assert row["beyond_mm"] > 10
    said = [line for line in answer["promise"] if line.startswith("No promise for far: ")]
    assert len(said) == 1
    assert re.search(r"from \d\.\d\d s on, \d+\.\d mm outside of what was seen at \d\.\d\d s", said[0])
    arguments = ["replay", str(folder / "t/lean.pack"), str(folder / "far.mcap"), "-o", str(tmp_path / "b.run.mcap")]
    assert cli.run(arguments) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("warning: the hand touches what no trace of the tuning came near: from ")
    page = (folder / "t" / "index.html").read_text()
    assert said[0] in page and not re.search(r'(?:src|href)="(?!data:)|@import|fetch\(', page)


def test_a_tuning_goes_on_from_its_cells_and_comes_out_the_same(tuned, monkeypatch, capsys):
    folder, answer = tuned
    before = (folder / "t/lean.pack").read_bytes()
    for name in ("lean.pack", "index.html", "tune.json"):
        (folder / "t" / name).unlink()
    judged = []
    monkeypatch.setattr(tune_cells, "judge_place", lambda *a: judged.append(a))
    monkeypatch.setattr(tune_cells, "judge_answer", lambda *a: judged.append(a))
    inputs = [str(folder / name) for name in ("bar.pack", "down.mcap")]
    assert cli.run(["tune", *inputs, "--holdout", str(folder / "far.mcap"), "-o", str(folder / "t"), *LINE]) == 0
    assert judged == []
    assert (folder / "t/lean.pack").read_bytes() == before
    assert json.loads((folder / "t/tune.json").read_text()) == answer


def test_each_mistake_is_one_line_with_exit_code_2_and_no_result(tuned, tmp_path, capsys, monkeypatch):
    folder, _ = tuned
    monkeypatch.chdir(folder)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("kept")
    off = replace(make_trace(20), palm_position_m=np.tile([0.0, 0, 1], (20, 1)))
    write_trace(tmp_path / "off.mcap", off)
    write_trace(tmp_path / "left.mcap", replace(off, header=off.header | {"side": "left"}))
    out = str(tmp_path / "t")
    mistakes = {
        ("bar.pack", "-o", out): "E-USAGE palmar tune: missing argument",
        ("bar.pack", "absent.mcap", "-o", out): "E-FILE-MISSING absent.mcap",
        ("absent.pack", "down.mcap", "-o", out): "E-FILE-MISSING absent.pack",
        ("bar.pack", "down.mcap", "--holdout", "down.mcap", "-o", out): "E-USAGE down.mcap: holds the same as",
        ("bar.pack", tmp_path / "left.mcap", "-o", out): f"E-TRACE-SIDE {tmp_path / 'left.mcap'}",
        ("bar.pack", tmp_path / "off.mcap", "-o", out): f"E-TUNE-CONTACT {tmp_path / 'off.mcap'}: no hand touches bar",
        ("bar.pack", "down.mcap", "-o", out, "--limit", "hovr=1"): "E-CONF --limit hovr: no such limit; nearest: hover",
        ("bar.pack", "down.mcap", "-o", out, "--limit", "hover=-1"): "E-CONF --limit hover: -1; a number from 0",
        ("bar.pack", "down.mcap", "-o", out, "--limit", "hover"): "E-USAGE --limit: 'hover'; key=value",
        ("bar.pack", "down.mcap", "-o", out, "--rest-mm", "9"): "E-CONF --rest-mm: 9; up to the guard distance of 5",
        ("bar.pack", "down.mcap", "-o", out, "--object", "cup"): "E-PACK-OBJECT cup: no such object",
        ("t/lean.pack", "down.mcap", "-o", out): "E-TUNE-LEAN t/lean.pack: is a lean pack already",
        ("bar.pack", "down.mcap", "-o", tmp_path / "other"): f"E-FILE-PLACE {tmp_path / 'other'}: holds 'mine.txt'",
    }
    for arguments, start in mistakes.items():
        code = cli.run(["tune", *map(str, arguments), "--jobs", "1"])
        said = capsys.readouterr()
        assert (code, said.out) == (2, ""), (arguments, said)
        assert len(said.err.splitlines()) == 1 and said.err.startswith(start), (arguments, said.err)
        assert not (tmp_path / "t" / "lean.pack").exists() and not (tmp_path / "t" / "index.html").exists()
