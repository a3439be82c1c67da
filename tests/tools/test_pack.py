"""Packs: what goes in comes out, the same bytes each time, and nothing at all when the input is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from palmar.errors import PalmarError
from palmar.model import load_pack
from palmar.tools.close import require_closed
from palmar.tools.hand_file import default_hand, read_hand
from palmar.tools.hierarchy import bounds_over
from palmar.tools.mesh import Mesh
from palmar.tools.pack import build
from palmar.tools.shapes import SHAPES
from palmar.tools.spheres_csv import read_spheres_csv

REFERENCE_HAND = Path(__file__).resolve().parents[1] / "data" / "reference_hand.toml"
BOX = trimesh.creation.box((0.04, 0.06, 0.1))
# Two rows of balls inside the box, in an order that no sorting gives.
LEAVES = np.array(
    [[0.01, 0.02, 0.03, 0.009], [-0.01, 0.0, -0.02, 0.01], [0.0, -0.015, 0.04, 0.0095], [0.0, 0.01, 0.0, 0.0125]]
)


def write_csv(path: Path, spheres, header: str = "x,y,z,r") -> Path:
    path.write_text("\n".join([header, *(",".join(repr(float(v)) for v in row) for row in spheres)]) + "\n")
    return path


@pytest.fixture
def box(tmp_path) -> Path:
    path = tmp_path / "box.obj"
    BOX.export(path)
    return path


def refused(folder: Path, meshes, **options) -> PalmarError:
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(PalmarError) as caught:
        build(meshes, folder / "out.pack", **options)
    assert sorted(path.name for path in folder.iterdir()) == before, "something was written"
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path, dict, list[tuple[str, float]]]:
    """The same build twice: two packs, the answer, and the progress that was told."""
    folder = tmp_path_factory.mktemp("built")
    BOX.export(folder / "box.obj")
    told: list[tuple[str, float]] = []
    # 3 mm on a box of 100 mm: a tree of three levels in the least time.
    wants = {"error_mm": 3.0, "close": True, "seed": 3}
    answer = build([folder / "box.obj"], folder / "a.pack", progress=lambda *now: told.append(now), **wants)
    build([folder / "box.obj"], folder / "b.pack", **wants)
    return folder / "a.pack", folder / "b.pack", answer, told


def test_the_same_input_gives_the_same_bytes(built):
    first, second, _, _ = built
    assert first.read_bytes() == second.read_bytes()


def test_a_pack_holds_what_was_built(built):
    path, _, answer, _ = built
    pack = load_pack(path)
    assert list(answer["objects"]) == list(pack.objects) == ["box"]
    assert answer["sha256"] == pack.sha256 and answer["bytes"] == path.stat().st_size
    assert json.loads(json.dumps(answer)) == answer
    assert pack.manifest["objects"] == answer["objects"] and pack.manifest["seed"] == 3
    for name, value in vars(default_hand()).items():
        same = value == getattr(pack.hand, name) if name == "about" else np.array_equal(value, getattr(pack.hand, name))
        assert same, name
    tree = pack.objects["box"]
    assert tree.about["closed"] is None and tree.about["units"] == "m"
    assert trimesh.Trimesh(tree.vertices_m, tree.faces, process=False).volume == pytest.approx(
        0.04 * 0.06 * 0.1, rel=1e-9
    )


def test_levels_in_the_pack_have_bounds(built):
    tree = load_pack(built[0]).objects["box"]
    assert [level["spheres"] for level in tree.about["levels"]] == [len(level) for level in tree.levels]
    assert len(tree.levels) > 1
    for spheres, bounds in zip(tree.levels, tree.bounds, strict=True):
        holder = bounds.balls_m[bounds.sphere_parent]
        assert (np.linalg.norm(spheres[:, :3] - holder[:, :3], axis=1) + spheres[:, 3] <= holder[:, 3]).all()


def test_progress_only_grows(built):
    shares = [fraction for _, fraction in built[3]]
    assert shares == sorted(shares) and min(shares) >= 0 and max(shares) <= 1


def test_leaves_from_a_csv_are_kept_as_they_are(box, tmp_path):
    for header, spheres, units in (
        ("x,y,z,r", LEAVES, "m"),
        ("x_m,y_m,z_m,radius_m", LEAVES, "m"),
        ("x,y,z,radius", LEAVES * 1000, "mm"),
    ):
        csv = write_csv(tmp_path / "leaves.csv", spheres, header)
        build([box], tmp_path / "out.pack", hand_path=REFERENCE_HAND, spheres_csv=csv, csv_units=units)
        pack = load_pack(tmp_path / "out.pack")
        tree = pack.objects["box"]
        np.testing.assert_allclose(tree.leaves, LEAVES, rtol=1e-15, atol=0)  # times 0.001 rounds once
        assert tree.about["method"] == "leaves as given"
        assert np.array_equal(pack.hand.palm_spheres_m, read_hand(REFERENCE_HAND).palm_spheres_m)


def test_csv_columns_may_stand_in_any_order(tmp_path):
    csv = write_csv(tmp_path / "leaves.csv", LEAVES[:, [3, 0, 2, 1]], "radius_mm,x_mm,z_mm,y_mm")
    np.testing.assert_allclose(read_spheres_csv(csv)[0], LEAVES / 1000, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "code", "place"),
    [
        ("", "E-CSV", "line 1"),
        ("x,y,z\n1,2,3\n", "E-CSV", "line 1"),
        ("0.0,0.0,0.0,0.01\n0.0,0.01,0.0,0.01\n", "E-CSV", "line 1"),
        ("x,y,z,r\n", "E-CSV", "leaves.csv"),
        ("x,y,z,r\n0,0,0,0.01\n0,0,one,0.01\n", "E-CSV", "line 3, column z"),
        ("x,y,z,r\n0,0,0,0.01\n0,0,0,0\n", "E-CSV", "line 3, column r"),
        ("x,y,z,r\n0,0,0,0.01\n0,nan,0,0.01\n", "E-CSV", "line 3, column y"),
        ("x,y,z,r\n0,0,0,0.01\n0,0,0\n", "E-CSV", "line 3"),
        ("x_mm,y_mm,z_mm,r_mm\n0,0,0,10\n", "E-CSV-UNITS", "line 1"),
    ],
)
def test_a_broken_csv_is_refused_by_line_and_column(box, tmp_path, text, code, place):
    csv = tmp_path / "leaves.csv"
    csv.write_text(text)
    units = "cm" if code == "E-CSV-UNITS" else "m"
    error = refused(tmp_path, [box], spheres_csv=csv, csv_units=units)
    assert error.code == code and error.where.endswith(place)


def test_spheres_of_another_unit_are_refused(box, tmp_path):
    csv = write_csv(tmp_path / "leaves.csv", LEAVES * 1000)
    assert refused(tmp_path, [box], spheres_csv=csv).code == "E-CSV-UNITS"
    csv = write_csv(tmp_path / "leaves.csv", LEAVES)
    assert refused(tmp_path, [box], spheres_csv=csv, csv_units="mm").code == "E-CSV-UNITS"


def test_bad_requests_write_nothing(box, tmp_path):
    opened = tmp_path / "opened.obj"
    BOX.submesh([np.arange(10)], append=True).export(opened)
    bad_hand = tmp_path / "hand.toml"
    bad_hand.write_text("name = 3\n")
    csv = write_csv(tmp_path / "leaves.csv", LEAVES)
    cases = [
        ([], {}, "E-CONF"),
        ([tmp_path / "none.stl"], {}, "E-MESH-MISSING"),
        ([opened], {}, "E-MESH-OPEN"),
        ([box], {"units": "mm"}, "E-MESH-UNITS"),
        ([box], {"error_mm": 0.5, "spheres": 20}, "E-CONF"),
        ([box], {"spheres": 20, "spheres_csv": csv}, "E-CONF"),
        ([box], {"mode": "round"}, "E-CONF"),
        ([box], {"error_mm": -1.0}, "E-CONF"),
        ([box], {"error_mm": float("nan")}, "E-CONF"),
        ([box], {"spheres": 0}, "E-CONF"),
        ([box, "shape:cube"], {"spheres_csv": csv}, "E-CONF"),
        ([box, box], {"spheres": 20}, "E-CONF"),
        ([box], {"hand_path": bad_hand}, "E-CONF"),
        (["shape:cupp"], {}, "E-MESH-SHAPE"),
    ]
    for meshes, options, code in cases:
        assert refused(tmp_path, meshes, **options).code == code, (meshes, options)
    assert "nearest: cup" in refused(tmp_path, ["shape:cupp"]).message


def test_a_place_that_cannot_be_written_is_refused_before_the_work(box, tmp_path):
    for out in (tmp_path, tmp_path / "none" / "a.pack", box):
        with pytest.raises(PalmarError) as caught:
            build([box], out, spheres=20)
        assert caught.value.code == "E-FILE-PLACE"
    assert box.read_bytes().startswith(b"#") or box.read_bytes().startswith(b"v")


def test_closing_is_written_down_with_its_figures(tmp_path):
    flipped = tmp_path / "flipped.stl"
    trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False).export(flipped)
    csv = write_csv(tmp_path / "leaves.csv", LEAVES)
    assert refused(tmp_path, [flipped], spheres_csv=csv).code == "E-MESH-INSIDE-OUT"
    answer = build([flipped], tmp_path / "out.pack", spheres_csv=csv, close=True)
    about = answer["objects"]["flipped"]
    assert about["closed"].startswith("repaired, turned 12 faces")
    assert about["parameters"]["closing"]["moved_mm"]["mesh_to_solid"]["max"] < 1e-6 and answer["warnings"] == []


def test_a_toml_list_names_objects_hand_and_what_each_wants(box, tmp_path, monkeypatch):
    wanted = []

    def record(vertices, faces, **wants):
        wanted.append((wants["error_m"], wants["spheres"], wants["seed"]))
        return [LEAVES], [bounds_over(LEAVES)], {}

    monkeypatch.setattr("palmar.tools.pack.build_levels", record)
    write_csv(tmp_path / "leaves.csv", LEAVES)
    (tmp_path / "hand.toml").write_text(REFERENCE_HAND.read_text())
    assets = tmp_path / "assets.toml"
    assets.write_text(
        'hand = "hand.toml"\n'
        '[[object]]\nname = "big"\nmesh = "box.obj"\nsize_mm = 200\nspheres = 12\n'
        '[[object]]\nmesh = "box.obj"\nspheres_csv = "leaves.csv"\n'
        '[[object]]\nmesh = "shape:cube"\n'
    )
    answer = build([assets], tmp_path / "out.pack", error_mm=2.0, seed=5)
    pack = load_pack(tmp_path / "out.pack")
    assert wanted == [(None, 12, 5), (0.002, None, 5)]
    assert answer["hand"]["name"] == "reference" and list(answer["objects"]) == ["big", "box", "cube"]
    assert np.ptp(pack.objects["big"].vertices_m, axis=0).max() == pytest.approx(0.2, rel=1e-12)
    assert np.array_equal(pack.objects["box"].leaves, LEAVES)
    assert answer["objects"]["cube"]["source"] == "shape:cube"
    build([box], tmp_path / "out.pack")
    assert wanted[-1] == (0.0005, None, 0), "half a millimetre where nothing is asked for"


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "assets.toml:object"),
        ("object = 3\n", "assets.toml:object"),
        ("[[object]]\nmesh = 3\n", "object[0].mesh"),
        ('[[object]]\nname = "a"\n', "object[0].mesh"),
        ('[[object]]\nmesh = "box.obj"\nerrormm = 1\n', "object[0].errormm"),
        ('[[object]]\nmesh = "box.obj"\nclose = 1\n', "object[0].close"),
        ('[[object]]\nmesh = "box.obj"\nerror_mm = "fine"\n', "object[0].error_mm"),
    ],
)
def test_a_broken_toml_list_is_refused_by_key(box, tmp_path, text, place):
    assets = tmp_path / "assets.toml"
    assets.write_text(text)
    error = refused(tmp_path, [assets])
    assert error.code == "E-CONF" and error.where.endswith(place)


@pytest.mark.parametrize("name", SHAPES)
def test_every_built_in_shape_passes_the_gate(name):
    vertices, faces = SHAPES[name]()
    require_closed(name, Mesh(vertices, faces, name, "", "m", 1.0))
