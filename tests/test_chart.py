"""The verb `chart` on one small object: what it writes, that it takes up what is there, and its mistakes."""

import json
import re
from itertools import product

import numpy as np
from made_trace import make_trace

from palmar import chart
from palmar.noise import noise_note
from palmar.records import write_trace
from palmar.traces.fingers import IN_USE, with_fingers


def test_a_chart_writes_page_table_and_figures_and_takes_up_its_cells(run, tmp_path, monkeypatch):
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (tmp_path / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    assert run("build", "shape:cube", "-o", "cube.pack", "--spheres-csv", "cube.csv")[0] == 0
    write_trace(tmp_path / "down.mcap", make_trace())
    line = ("chart", "cube.pack", "down.mcap", "-o", "c", "--spheres", "27", "--jobs", "1", "--quality", "none")
    line = (*line, "--solver", "progressive", "--solver", "paper", "--json")
    code, out, errors = run(*line, "--repeats", "2")
    answer = json.loads(out)
    assert (code, errors, answer["cells"]) == (0, [], 2)
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == [
        *("cells", "chart.csv", "chart.json", "figures", "index.html", "made")
    ]
    names = {path.name for path in (tmp_path / "c" / "figures").iterdir()}
    assert names == {f"{name}.{kind}" for name in ("chart", "cost") for kind in ("pdf", "svg", "png")}
    ours = answer["dots"][0]
    assert (ours["solver"], ours["spheres"], ours["failed"]) == ("progressive", 27, 0)
    assert ours["numbers"]["penetration_spheres_mm"] == 0 and ours["cost_us"]["p99"] > 0
    assert not re.search(r'(?:src|href)="(?!data:)|@import|fetch\(', (tmp_path / "c" / "index.html").read_text())

    # Nothing is left to do: no replay, the same answer. With one repeat more each cell is replayed once.
    replayed = []
    monkeypatch.setattr(chart, "replay_file", lambda *a, **k: replayed.append(a) or replay_file(*a, **k))
    from palmar.replay import replay_file

    assert json.loads(run(*line, "--repeats", "2")[1])["dots"] == answer["dots"] and replayed == []
    run(*line, "--repeats", "3")
    assert len(replayed) == 2


def test_levels_are_the_nearest_by_ratio_and_none_stands_for_two_counts():
    assert chart.levels_for([1, 4, 16, 63, 250, 1000, 4000], [500, 3000, 30_000]) == {500: 4, 3000: 6}
    assert chart.levels_for([400, 600], [500, 3000]) == {500: 1}
    assert chart.levels_for([30], [500, 3000]) == {500: 0}


def test_each_mistake_is_one_line_with_exit_code_2_and_no_result(run, tmp_path):
    write_trace(tmp_path / "down.mcap", make_trace(20))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("kept")
    mistakes = {
        ("chart", "-o", "c", "--solver", "papper"): "E-CONF solver papper: no such solver; nearest: paper",
        ("chart", "-o", "c", "--quality", "iterations=1"): "E-USAGE --quality: ",
        ("chart", "-o", "c", "--quality", "progressive:iterations"): "E-USAGE --quality: 'iterations'; key=value",
        ("chart", "-o", "c", "--shape", "cubes"): "E-MESH-SHAPE cubes: no such shape; nearest: cube",
        ("chart", "down.mcap", "-o", "c"): "E-USAGE down.mcap: a trace without a pack",
        ("chart", "other/mine.txt", "-o", "c"): "E-USAGE other/mine.txt: is neither",
        ("chart", "absent.pack", "-o", "c"): "E-FILE-MISSING absent.pack",
        ("chart", "-o", "other"): "E-FILE-PLACE other: holds 'mine.txt'",
    }
    for arguments, start in mistakes.items():
        code, out, errors = run(*arguments)
        assert (code, out, len(errors)) == (2, "", 1), (arguments, errors)
        assert errors[0].startswith(start), errors
        assert not (tmp_path / "c" / "index.html").exists()


def test_a_hand_with_fewer_fingers_keeps_the_others_open_and_the_palm_off():
    trace = make_trace()
    one = with_fingers(trace, *IN_USE["one finger"])
    assert np.array_equal(one.flexion_rad[:, 1], trace.flexion_rad[:, 1])
    assert np.ptp(one.flexion_rad[:, [0, 2, 3, 4]], axis=0).max() == 0
    assert np.allclose(one.palm_position_m - trace.palm_position_m, [0, 0, 0.006], rtol=0, atol=1e-12)
    whole = with_fingers(trace, *IN_USE["whole hand"])
    assert np.array_equal(whole.flexion_rad, trace.flexion_rad)
    assert np.array_equal(whole.palm_position_m, trace.palm_position_m)


def test_a_noisy_machine_is_said_and_a_quiet_one_is_not():
    quiet = {"least_us": 500.0, "median_us": 510.0, "wall_by_cpu": 1.01}
    assert noise_note([quiet, quiet]) == ""
    assert "took 20% longer" in noise_note([quiet, quiet | {"least_us": 600.0, "median_us": 610.0}])
    assert "waited for the processor 100%" in noise_note([quiet | {"wall_by_cpu": 2.0}])
    assert "median was 30% above" in noise_note([quiet | {"median_us": 650.0}])
