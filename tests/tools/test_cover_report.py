import json
from dataclasses import replace

import numpy as np
import pytest

from palmar import cli
from palmar.errors import PalmarError
from palmar.model import SphereTree, load_pack
from palmar.tools.cover_report import write_cover
from palmar.tools.cover_tree import check_tree
from palmar.tools.pack import build


def write_csv(path, spheres):
    np.savetxt(path, spheres, delimiter=",", header="x,y,z,radius", comments="")
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A pack of a cube and a ball, and a CSV of another tool's one sphere for the cube, in millimetres."""
    folder = tmp_path_factory.mktemp("cover")
    build(["shape:cube", "shape:sphere"], folder / "two.pack", spheres=30)
    write_csv(folder / "other.csv", [[0, 0, 0, 40.0]])
    return folder


@pytest.fixture(scope="module")
def answer(files):
    options = {"object_name": "cube", "spheres_csv": [files / "other.csv"], "csv_units": "mm"}
    return write_cover(str(files / "two.pack"), files / "out", **options), options


def test_ours_and_another_tools_stand_side_by_side(files, answer):
    found, _ = answer
    assert json.loads((files / "out" / "cover.json").read_text()) == {k: v for k, v in found.items() if k != "page"}
    ours, other = found["covers"]
    assert (ours["name"], other["name"], other["spheres"]) == ("cube", "other", 1)
    # A ball of 40 mm in a cube of 70 sticks out by 5 at the faces and leaves 35 sqrt(3) - 40 at the corners.
    assert other["protrusion_mm"]["max"] == pytest.approx(5.0, abs=0.02)
    assert other["gap_mm"]["max"] == pytest.approx(35 * np.sqrt(3) - 40, abs=1.0)
    assert ours["balanced_p99_mm"] < other["balanced_p99_mm"]
    levels = load_pack(files / "two.pack").objects["cube"].about["levels"]
    assert ours["gap_mm"]["p99"] == pytest.approx(levels[-1]["gap_mm"]["p99"])  # the same samples as in the pack
    assert ours["tree"]["valid"] and "tree" not in other
    page = (files / "out" / "index.html").read_text()
    for cover in found["covers"]:
        assert cover["name"] in page and (files / "out" / cover["map"]).is_file()
        assert (files / "out" / cover["picture"]).read_bytes().startswith(b"\x89PNG")
        places = [place["kind"] for place in cover["worst_places"]]
        assert places == sorted(places) and {"gap", "protrusion"} == set(places)
    assert "http" not in page and page.count("data:image/png") == 2


def test_the_same_input_gives_the_same_bytes_and_replaces_the_earlier_report(files, answer):
    def read():
        return {p.relative_to(files / "out"): p.read_bytes() for p in (files / "out").rglob("*") if p.is_file()}

    before = read()
    write_cover(str(files / "two.pack"), files / "out", **answer[1])
    assert read() == before


def test_levels_and_the_bound_on_request(files, tmp_path):
    found = write_cover(str(files / "two.pack"), tmp_path / "out", object_name="cube", levels=[1, 0], bound=True)
    assert [cover["name"] for cover in found["covers"]] == ["cube level 1", "cube level 0"]
    for cover in found["covers"]:
        bound = cover["dual_bound"]
        assert bound["error_mm"] == cover["balanced_p99_mm"] and bound["ratio"] * bound[
            "least_spheres"
        ] == pytest.approx(cover["spheres"])


def test_a_mesh_alone_is_measured_against_csvs_and_says_how_it_was_closed(files, tmp_path):
    import trimesh

    box = trimesh.creation.box((70, 70, 70))
    box.faces = box.faces[:, ::-1]
    box.export(tmp_path / "box.stl")
    csvs = [files / "other.csv", files / "other.csv"]
    with pytest.raises(PalmarError, match="E-MESH-INSIDE-OUT"):
        write_cover(str(tmp_path / "box.stl"), tmp_path / "out", units="mm", spheres_csv=csvs, csv_units="mm")
    assert not (tmp_path / "out").exists()
    found = write_cover(
        str(tmp_path / "box.stl"), tmp_path / "out", units="mm", close=True, spheres_csv=csvs, csv_units="mm"
    )
    assert [cover["name"] for cover in found["covers"]] == ["other", "other-2"]
    assert found["mesh"]["closing"]["hausdorff_mm"] < 1e-6
    assert "The mesh was closed" in (tmp_path / "out" / "index.html").read_text()


def test_what_is_wrong_with_a_tree_is_counted(files):
    tree = load_pack(files / "two.pack").objects["cube"]
    assert check_tree(tree)["valid"]
    levels, bounds = [level.copy() for level in tree.levels], list(tree.bounds)
    levels[-1][3, 3] += 1.0
    parent = bounds[-1].sphere_parent.copy()
    parent[5] = 9999
    bounds[-1] = replace(bounds[-1], sphere_parent=parent)
    found = check_tree(SphereTree(levels, bounds, tree.vertices_m, tree.faces))
    assert (found["not_contained"], found["not_contained_float32"], found["without_parent"]) == (1, 1, 1)
    assert 900 < found["farthest_out_mm"] <= 1000 and not found["valid"]


def test_each_mistake_is_one_line_and_nothing_is_written(files, tmp_path, capsys):
    pack, csv = files / "two.pack", files / "other.csv"
    many = write_csv(tmp_path / "many.csv", np.tile([0, 0, 0, 30.0], (3001, 1)))
    busy = tmp_path / "busy"
    busy.mkdir()
    (busy / "mine.txt").write_text("kept")
    before = sorted(tmp_path.rglob("*"))
    out = tmp_path / "out"
    for arguments, start, word in (
        ((pack, "-o", out), "E-OBJECT", "cube, sphere; --object"),
        ((pack, "-o", out, "--object", "cub"), "E-OBJECT", "nearest: cube"),
        ((pack, "-o", out, "--object", "cube", "--level", "9"), "E-LEVEL", "levels 0 to"),
        ((pack, "-o", out, "--object", "cube", "--units", "mm"), "E-USAGE --units", "mesh"),
        ((pack, "-o", busy, "--object", "cube"), "E-FILE-PLACE", "mine.txt"),
        ((pack, "-o", csv, "--object", "cube"), "E-FILE-PLACE", "folder"),
        ((pack, "-o", out, "--object", "cube", "--spheres-csv", csv), "E-CSV-UNITS", "--csv-units"),
        ((pack, "-o", out, "--object", "cube", "--spheres-csv", "absent.csv"), "E-CSV-MISSING", "absent.csv"),
        (("shape:cube", "-o", out), "E-USAGE --spheres-csv", "spheres to measure"),
        (("shape:cub", "-o", out), "E-MESH-SHAPE", "cube"),
        (("shape:cube", "-o", out, "--bound", "--spheres-csv", many, "--csv-units", "mm"), "E-CONF --bound", "3,000"),
        ((tmp_path / "absent.pack", "-o", out), "E-FILE-MISSING", "absent.pack"),
    ):
        code = cli.run(["cover", *map(str, arguments)])
        captured = capsys.readouterr()
        assert code == 2 and captured.out == "", arguments
        (line,) = captured.err.splitlines()
        assert line.startswith(start) and word in line, line
        assert sorted(tmp_path.rglob("*")) == before, arguments


def test_the_command_prints_one_json_object_or_tables(files, tmp_path, capsys):
    line = ["cover", "shape:cube", "--spheres-csv", str(files / "other.csv"), "--csv-units", "mm", "-o"]
    assert cli.run([*line, str(tmp_path / "a"), "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["covers"][0]["name"] == "other" and captured.err == ""
    assert cli.run([*line, str(tmp_path / "b")]) == 0
    assert "balanced p99 mm" in capsys.readouterr().out
