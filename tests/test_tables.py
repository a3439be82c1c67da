"""Tables that go out and come back in: the same numbers, in every form."""

import json

import numpy as np
import pytest

from palmar import cli
from palmar.errors import BadTrace, PalmarError
from palmar.export import export_file, trace_of, trace_table
from palmar.records import Trace, read_trace, write_trace
from palmar.tables import FORMS, Table, read_table, write_table
from palmar.traces.device import import_file


@pytest.fixture
def trace_path(tmp_path):
    random = np.random.default_rng(2)
    rotation = random.normal(size=(2, 40, 4))
    rotation /= np.linalg.norm(rotation, axis=2, keepdims=True)
    trace = Trace(
        header={"schema": "palmar.trace/1", "device": "glove é", "hand": "default", "side": "left", "rate_hz": "90"},
        time_s=np.cumsum(random.uniform(0.001, 0.1, 40)),
        palm_position_m=random.normal(size=(40, 3)),
        palm_rotation_wxyz=rotation[0],
        flexion_rad=random.normal(size=(40, 5, 3)) * 10.0 ** random.integers(-300, 1, (40, 5, 3)),
        abduction_rad=random.normal(size=(40, 5)),
        tracked=random.random(40) > 0.2,
        has_object_pose=random.random(40) > 0.5,
        object_position_m=random.normal(size=(40, 3)),
        object_rotation_wxyz=rotation[1],
    )
    write_trace(tmp_path / "t.mcap", trace)
    return tmp_path / "t.mcap"


def assert_same(got, expected, header=True):
    for name in Trace.__dataclass_fields__:
        if name not in ("header", "lost"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    assert not header or got.header == expected.header


@pytest.mark.parametrize("form", FORMS)
def test_an_exported_trace_is_imported_as_what_it_was_bit_for_bit(trace_path, tmp_path, form, capsys):
    out = tmp_path / "back.mcap"
    assert cli.run(["export", str(trace_path), "-o", str(tmp_path), "--format", form]) == 0
    options = ["--option", "hand_name=default", "--option", "side=left"] if form == "csv" else []
    assert cli.run(["import", str(tmp_path / f"t.samples.{form}"), "-o", str(out), *options]) == 0
    assert_same(read_trace(out), read_trace(trace_path), header=form != "csv")
    assert "samples" in capsys.readouterr().out
    if form == "csv":
        assert {read_trace(out).header[key] for key in ("hand", "side")} == {"default", "left"}


@pytest.mark.parametrize("form", ["json", "parquet"])
def test_numbers_keep_their_type_and_their_bits(form, tmp_path):
    columns = {
        "a": np.array([0.1 + 0.2, 5e-324, -0.0, 1.7976931348623157e308]),
        "b": np.array([0, 2**32 - 1, 3, 4], dtype=np.uint32),
    }
    path = tmp_path / f"x.{form}"
    write_table(path, Table(columns, {"k": "vé"}))
    back = read_table(path)
    assert back.about == {"k": "vé"} and list(back.columns) == ["a", "b"]
    assert back.columns["a"].tobytes() == columns["a"].tobytes()
    np.testing.assert_array_equal(back.columns["b"], columns["b"])


def test_a_table_of_a_trace_is_that_trace(trace_path):
    assert_same(trace_of(trace_table(read_trace(trace_path))), read_trace(trace_path))


def test_mistakes_are_one_line_and_nothing_is_written(trace_path, tmp_path):
    export_file(read_trace(trace_path), trace_path, tmp_path, form="json")
    export_file(read_trace(trace_path), trace_path, tmp_path, form="csv")
    said = json.loads((tmp_path / "t.samples.json").read_text())
    without = {name: values for name, values in said["columns"].items() if name != "tracked"}
    files = {
        "half.json": (tmp_path / "t.samples.json").read_text()[:-30],
        "less.json": json.dumps({**said, "columns": without}),
        "more.json": json.dumps({**said, "columns": said["columns"] | {"more": [0.0] * 40}}),
        "words.json": json.dumps({**said, "columns": said["columns"] | {"palm_x_m": ["a"] * 40}}),
        "short.json": json.dumps({**said, "columns": said["columns"] | {"palm_x_m": [0.0] * 39}}),
        "turned.json": json.dumps({**said, "columns": said["columns"] | {"palm_qw": [2.0] * 40}}),
        "half.parquet": "PAR1 and no more",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(BadTrace) as caught:
            import_file(tmp_path / name, tmp_path / "no.mcap", format="samples")
        assert "\n" not in str(caught.value), name
    with pytest.raises(PalmarError, match="--option hand_name"):
        import_file(tmp_path / "t.samples.csv", tmp_path / "no.mcap")
    with pytest.raises(PalmarError, match="leave it out"):
        import_file(tmp_path / "t.samples.json", tmp_path / "no.mcap", side="left")
    with pytest.raises(PalmarError, match="nearest: parquet"):
        export_file(read_trace(trace_path), trace_path, tmp_path, form="parquett")
    assert not (tmp_path / "no.mcap").exists()
