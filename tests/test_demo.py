"""`palmar demo` on one coarse object: every stage leaves its file, and what it says is what the files say."""

from palmar import demo, load_pack, reference
from palmar.records import read_run, read_trace


def test_the_demo_goes_the_whole_way(run, tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "OBJECTS", ("cylinder",))
    monkeypatch.setattr(demo, "ERROR_MM", 2.0)
    monkeypatch.setattr(reference, "MOST_STEPS", 5)
    code, out, errors = run("demo", "-o", "d")
    assert (code, errors) == (0, [])
    folder = tmp_path / "d"
    said = [line.split(maxsplit=1) for line in out.splitlines()]
    assert [kind for kind, _ in said] == ["pack", "trace", "run", "verdict", "report"]
    assert {path.name for path in folder.iterdir()} == {
        *("objects.pack", "cylinder.mcap", "cylinder.run.mcap", "report")
    }
    grasp, answer = read_trace(folder / "cylinder.mcap"), read_run(folder / "cylinder.run.mcap")
    assert list(load_pack(folder / "objects.pack").objects) == ["cylinder"]
    assert grasp.header["object"] == answer.header["object"] == "cylinder"
    assert answer.contacts.max() > 5  # it took hold
    verdict = said[3][1].split(": ", 1)[1]
    assert verdict in (folder / "report" / "index.html").read_text()
