"""`palmar report --paper` on one small pack: every figure with its numbers, and its mistakes."""

import csv
import json
from itertools import product

import pytest

from palmar import paper
from palmar.eval import paper_figures
from palmar.records import read_trace


def test_the_papers_figures_of_an_own_object(run, tmp_path, monkeypatch):
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.024, 0.0, 0.024), repeat=3)]
    (tmp_path / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    assert run("build", "shape:cube", "-o", "cube.pack", "--spheres-csv", "cube.csv")[0] == 0
    monkeypatch.setattr(paper, "SIMPLE", {"cylinder": 27})  # of five; what stands in `made` is taken up again
    assert run("build", "shape:cylinder", "-o", "cylinder.pack", "--spheres-csv", "cube.csv")[0] == 0
    (tmp_path / "p" / "made").mkdir(parents=True)
    (tmp_path / "cylinder.pack").rename(tmp_path / "p" / "made" / "cylinder-27-0.pack")
    monkeypatch.setattr(paper_figures, "TILE_PIXELS", 40)
    code, out, errors = run("report", "--paper", "cube.pack", "-o", "p", "--repeats", "1", "--json")
    answer = json.loads(out)
    assert (code, errors) == (0, []) and list(answer["figures"]) == ["fig11", "fig12", "fig13", "fig14", "fig15"]
    names = {path.name for path in (tmp_path / "p" / "figures").iterdir()}
    assert names >= {f"fig{n}.{kind}" for n in range(11, 16) for kind in ("pdf", "svg", "png")}
    assert {"fig13.csv", "fig14-0-cube.csv", "fig15.csv", "table_vd.csv"} <= names
    table = list(csv.DictReader((tmp_path / "p" / "figures" / "table_vd.csv").read_text().splitlines()))
    assert [row["object"] for row in table] == ["the paper", "cube", "cube"]
    # A hold that is still has no variation at all; one that is shaken has some.
    assert table[1]["variation_%"] == "0 (0)" and float(table[2]["variation_%"].split()[0]) > 0
    assert table[1]["penetration_spheres_mm"] == "0"
    page = (tmp_path / "p" / "index.html").read_text()
    for told in ("not measured", "calibration", "settings", "machine", answer["about"]["packs"].split()[1]):
        assert told in page
    tiles = list(csv.DictReader((tmp_path / "p" / "figures" / "fig13.csv").read_text().splitlines()))
    assert [tile["column"] for tile in tiles] == ["squeeze", "hold", "slide"] and float(tiles[1]["contacts"]) > 0
    tiles = list(csv.DictReader((tmp_path / "p" / "figures" / "fig11.csv").read_text().splitlines()))
    assert [tile["row"] for tile in tiles] == ["one finger", "two fingers", "five and palm"]
    assert {tile["object"] for tile in tiles} == {"cylinder"} and all(float(tile["contacts"]) > 0 for tile in tiles)
    # Fingers in turn: a row for each step of the trace, and no force before the first of them closes.
    steps = list(csv.DictReader((tmp_path / "p" / "figures" / "fig12-cylinder.csv").read_text().splitlines()))
    (in_turn,) = (tmp_path / "p" / "made").glob("cylinder-27-0-*-in-turn.mcap")
    trace = read_trace(in_turn)
    assert [float(step["time_s"]) for step in steps] == pytest.approx(trace.time_s, abs=1e-6)
    come = trace.phases[0]["end_s"]
    assert not any(float(step["index_n"]) for step in steps if float(step["time_s"]) < come)


def test_each_mistake_is_one_line_with_exit_code_2(run, tmp_path):
    (tmp_path / "a.txt").write_text("")
    (tmp_path / "a.mcap").write_text("")
    mistakes = {
        ("report", "-o", "r"): "E-USAGE palmar report: no RUN",
        ("report", "--paper", "--pack", "x.pack", "-o", "r"): "E-USAGE --paper: goes without --pack",
        ("report", "--paper", "a.txt", "-o", "r"): "E-USAGE a.txt: is neither a .pack nor a .mcap",
        ("report", "--paper", "a.mcap", "-o", "r"): "E-USAGE a.mcap: a trace without a pack",
        ("report", "--paper", "absent.pack", "-o", "r"): "E-FILE-MISSING absent.pack",
    }
    for arguments, start in mistakes.items():
        code, out, errors = run(*arguments)
        assert (code, out, len(errors)) == (2, "", 1) and errors[0].startswith(start), errors
    assert not (tmp_path / "r").exists()
