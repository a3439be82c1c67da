"""`palmar demo` goes the whole way: each stage gets what the one before it left, and all files stay."""

from itertools import product

import palmar.eval.report
import palmar.tools.pack
from palmar import demo, load_pack
from palmar.records import read_run, read_trace
from palmar.reference import same_start
from palmar.tools.pack import build


def test_the_demo_goes_the_whole_way(run, tmp_path, monkeypatch):
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (tmp_path / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    asked, judged = {}, []

    # Spheres are given, and the report, which has tests of its own, is not written: both are half a minute.
    def build_quickly(shapes, pack, *, progress, **options):
        asked.update(options, shapes=shapes)
        return build(shapes, pack, spheres_csv=tmp_path / "cube.csv", progress=progress)

    def judge(pairs, out, *, progress, **options):
        judged.append((pairs, out, options))
        progress(1, 1, "done")
        return {"page": str(out / "index.html"), "runs": [{"run": "cube", "verdict": "PASS"}]}

    monkeypatch.setattr(demo, "OBJECTS", ("cube",))
    monkeypatch.setattr(palmar.tools.pack, "build", build_quickly)
    monkeypatch.setattr(palmar.eval.report, "write_report", judge)
    code, out, errors = run("demo", "-o", "d", "--seed", "3")
    assert (code, errors) == (0, [])
    folder = tmp_path / "d"
    assert asked == {"error_mm": demo.ERROR_MM, "seed": 3, "shapes": ["shape:cube"]}
    assert list(load_pack(folder / "objects.pack").objects) == ["cube"]
    grasp, answer = read_trace(folder / "cube.mcap"), read_run(folder / "cube.run.mcap")
    assert grasp.header["object"] == answer.header["object"] == "cube" and answer.contacts.max() > 0
    pair = (folder / "cube.run.mcap", folder / "objects.pack")
    assert [(list(p), o, x) for p, o, x in judged] == [
        (
            [tuple(path.relative_to(tmp_path) for path in pair)],
            folder.relative_to(tmp_path) / "report",
            {"same_start": same_start},
        )
    ]
    assert [line.split() for line in out.splitlines()] == [
        ["pack", "d/objects.pack"],
        ["trace", "d/cube.mcap"],
        ["run", "d/cube.run.mcap"],
        ["verdict", "cube:", "PASS"],
        ["report", "d/report/index.html"],
    ]
