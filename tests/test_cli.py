"""What a user sees of a mistake: one line, the right exit code, nothing written."""

import csv
import json
import subprocess
import sys
from itertools import product

import numpy as np
import pytest

from palmar import _runtime
from palmar.files import sha256_of
from palmar.model import load_pack
from palmar.records import Trace, read_run, read_trace, write_trace


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A pack of one cube, a sound trace above it, and the trace cut after 60 % of its bytes."""
    from palmar.tools.pack import build

    folder = tmp_path_factory.mktemp("files")
    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (folder / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    build(["shape:cube"], folder / "cube.pack", spheres_csv=folder / "cube.csv")
    n = 3000
    position = np.zeros((n, 3))
    position[:, 2] = np.linspace(0.3, 0.2, n)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    trace = Trace(
        header={"device": "test", "hand": "test", "side": "right"},
        time_s=np.arange(n) * 1e-3,
        palm_position_m=position,
        palm_rotation_wxyz=turn,
        flexion_rad=np.full((n, 5, 3), 0.1 + 0.2),
        abduction_rad=np.zeros((n, 5)),
        tracked=np.ones(n, bool),
        has_object_pose=np.zeros(n, bool),
        object_position_m=np.zeros((n, 3)),
        object_rotation_wxyz=turn,
    )
    write_trace(folder / "whole.mcap", trace)
    content = (folder / "whole.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(content[: len(content) * 6 // 10])
    return folder


def test_each_mistake_is_one_line_with_exit_code_2_and_nothing_written(run, files, tmp_path):
    pack, trace = files / "cube.pack", files / "whole.mcap"
    cut_mesh = tmp_path.with_name(f"{tmp_path.name}-cut.stl")
    cut_mesh.write_bytes(bytes(80) + (12).to_bytes(4, "little") + bytes(50 * 7))
    cut_pack = tmp_path.with_name(f"{tmp_path.name}-cut.pack")
    cut_pack.write_bytes(pack.read_bytes()[:-100])
    mistakes = {
        ("replay", pack, trace, "-o", "x.run.mcap", "--solvr", "progressive"): ("E-USAGE palmar replay", "--solver"),
        ("repaly", pack, trace): ("E-USAGE palmar", "'replay'"),
        ("replay", pack, trace): ("E-USAGE palmar replay", "--out"),
        ("build", "cube.stl", "-o", "x.pack", "--error-mm", "fine"): ("E-USAGE palmar build", "--error-mm"),
        ("replay", pack, trace, "-o", "x.run.mcap", "--set", "rate_hz"): ("E-USAGE --set", "key=value"),
        ("replay", pack, trace, "-o", "x.run.mcap", "--set", "rate_herz=5"): ("E-CONF-KEY", "rate_hz"),
        ("replay", pack, trace, "-o", "x.run.mcap", "--solver", "progresive"): ("E-CONF", "progressive"),
        ("replay", pack, trace, "-o", "x.run.mcap", "--level", "99"): ("E-", "99"),
        ("replay", pack, trace, "-o", "x.run.mcap", "--object", "cubes"): ("E-", "cube"),
        ("replay", pack, trace, "-o", "absent/x.run.mcap"): ("E-FILE-PLACE", "absent"),
        ("replay", files / "cub.pack", trace, "-o", "x.run.mcap"): ("E-FILE-MISSING", "nearest: cube.pack"),
        ("replay", cut_pack, trace, "-o", "x.run.mcap"): ("E-PACK-", "cut.pack"),
        ("replay", pack, pack, "-o", "x.run.mcap"): ("E-TRACE-FORMAT", "MCAP"),
        ("build", cut_mesh, "-o", "x.pack"): ("E-MESH-", "cut.stl"),
        ("build", "absent.obj", "-o", "x.pack"): ("E-", "absent.obj"),
        ("import", "absent.csv", "-o", "x.mcap"): ("E-FILE-MISSING", "absent.csv"),
        ("script", "grap", pack, "-o", "x.mcap"): ("E-CONF", "grasp"),
        ("report", trace, "-o", "x"): ("E-TRACE-SCHEMA", "palmar.run/1"),
        ("show", "absent.pack"): ("E-FILE-MISSING", "absent.pack"),
        ("show", cut_mesh): ("E-PACK-FORMAT", "cut.stl"),
        ("export", pack, "-o", "x", "--level", "99"): ("E-LEVEL", "99"),
        ("export", pack, "-o", "x", "--object", "cub"): ("E-OBJECT", "nearest: cube"),
        ("export", trace, "-o", "x", "--level", "0"): ("E-USAGE", "pack"),
    }
    for arguments, (start, word) in mistakes.items():
        code, out, errors = run(*arguments)
        line = " ".join(map(str, arguments))
        assert code == 2, line
        assert out == "", line
        assert len(errors) == 1 and errors[0].startswith(start) and word in errors[0], (line, errors)
        assert list(tmp_path.iterdir()) == [], line


def test_a_damaged_trace_is_replayed_only_when_its_loss_is_accepted(run, files, tmp_path):
    pack, cut = files / "cube.pack", files / "cut.mcap"
    left = len(read_trace(cut).time_s)
    assert 0 < left < 3000

    code, out, errors = run("replay", pack, cut, "-o", "x.run.mcap")
    assert (code, out, len(errors)) == (3, "", 1)
    assert errors[0].startswith("E-TRACE-LOSS") and "--accept-loss" in errors[0]
    assert list(tmp_path.iterdir()) == []

    code, _, errors = run("replay", pack, cut, "-o", "x.run.mcap", "--accept-loss")
    assert (code, len(errors)) == (3, 1)
    assert len(read_run(tmp_path / "x.run.mcap").time_s) == left  # the samples are 1 ms apart, as the steps are

    assert run("show", cut)[0] == 3
    assert run("export", cut, "-o", "x")[0] == 3
    assert len((tmp_path / "x" / "cut.samples.csv").read_text().splitlines()) == left + 1


def test_a_run_is_verified_step_by_step(run, files, tmp_path):
    pack, trace = files / "cube.pack", files / "whole.mcap"
    assert run("replay", pack, trace, "-o", "x.run.mcap", "--set", "rate_hz=500", "--set", "fade_s=0.2")[0] == 0
    verify = ("replay", pack, trace, "--verify", "x.run.mcap")
    code, out, errors = run(*verify)
    assert (code, out, errors) == (0, "x.run.mcap: all 1500 steps are the same, bit for bit\n", [])
    assert [path.name for path in tmp_path.iterdir()] == ["x.run.mcap"]

    # A run of another hand that claims to be of this trace: 1 nm higher from sample 1000 on, which is step 500.
    samples = read_trace(trace)
    samples.palm_position_m[1000:, 2] += 1e-9
    write_trace(tmp_path / "other.mcap", samples)
    claims = {"pack_sha256": sha256_of(pack), "trace_sha256": sha256_of(trace)}
    arguments = [str(pack), *(str(tmp_path / name) for name in ("other.mcap", "x.run.mcap"))]
    _runtime.replay(*arguments, "", {"rate_hz": 500.0, "fade_s": 0.2}, claims)
    code, out, (line,) = run(*verify)
    assert (code, out) == (1, "")
    assert line.startswith("E-VERIFY x.run.mcap:step 500: at 1 s the first that differs, in palm_position_m, ")
    assert "1000 of 1500 steps differ, palms by 1e-06 mm at most" in line
    code, out, _ = run(*verify, "--json")
    assert code == 1 and json.loads(out)["first"]["step"] == 500

    code, _, (line,) = run("replay", pack, tmp_path / "other.mcap", "--verify", "x.run.mcap")
    assert code == 2 and line.startswith("E-TRACE-HASH")
    assert run(*verify, "--set", "rate_hz=90")[0] == 2


def test_the_other_hands_trace_is_refused_by_name(run, files, tmp_path):
    trace = read_trace(files / "whole.mcap")
    write_trace(tmp_path / "left.mcap", Trace(**{**vars(trace), "header": trace.header | {"side": "left"}}))
    code, _, errors = run("replay", files / "cube.pack", "left.mcap", "-o", "x.run.mcap")
    assert code == 2 and errors[0].startswith("E-TRACE-SIDE left.mcap") and "right one" in errors[0]
    assert not (tmp_path / "x.run.mcap").exists()


def test_json_is_one_object_on_stdout_and_stderr_stays_empty(run, files, tmp_path):
    pack, trace = files / "cube.pack", files / "whole.mcap"
    lines = [
        ("build", "shape:sphere", "-o", "s.pack", "--spheres-csv", files / "cube.csv"),
        ("script", "grasp", pack, "-o", "s.mcap"),
        ("replay", pack, trace, "-o", "s.run.mcap"),
        ("show", pack),
        ("show", trace),
        ("show", tmp_path / "s.run.mcap"),
        ("export", pack, "-o", "x"),
        ("export", tmp_path / "s.run.mcap", "-o", "x"),
        ("report", tmp_path / "s.run.mcap", "--pack", pack, "-o", "r"),
    ]
    for line in lines:
        code, out, errors = run(*line, "--json")
        assert (code, errors) == (0, []), line
        assert isinstance(json.loads(out), dict), line


def test_exported_numbers_read_back_as_the_same_numbers(run, files, tmp_path):
    pack, trace = files / "cube.pack", files / "whole.mcap"
    run("replay", pack, trace, "-o", "a.run.mcap")
    for path in (pack, trace, tmp_path / "a.run.mcap"):
        assert run("export", path, "-o", ".")[0] == 0

    def columns(name):
        with (tmp_path / name).open(newline="") as stream:
            rows = list(csv.reader(stream))
        return {title: np.array([float(row[k]) for row in rows[1:]]) for k, title in enumerate(rows[0])}

    spheres = columns("cube.spheres.csv")
    assert list(spheres) == ["x_m", "y_m", "z_m", "radius_m"]
    np.testing.assert_array_equal(np.stack(list(spheres.values()), axis=1), load_pack(pack).objects["cube"].leaves)

    samples = columns("whole.samples.csv")
    np.testing.assert_array_equal(samples["palm_z_m"], read_trace(trace).palm_position_m[:, 2])
    np.testing.assert_array_equal(samples["little_DIP_rad"], 0.1 + 0.2)

    poses, answer = columns("a.poses.csv"), read_run(tmp_path / "a.run.mcap")
    np.testing.assert_array_equal(poses["graphic_palm_qw"], answer.palm_rotation_wxyz[:, 0])
    np.testing.assert_array_equal(poses["graphic_index_PIP_rad"], answer.flexion_rad[:, 1, 1])
    np.testing.assert_array_equal(poses["haptic_thumb_abduction_rad"], answer.haptic_abduction_rad[:, 0])
    np.testing.assert_array_equal(poses["step_cpu_us"], answer.cpu_us)
    np.testing.assert_array_equal(poses["contacts"], answer.contacts)


def test_a_run_names_its_pack_its_trace_and_the_machine(run, files, tmp_path):
    from palmar.files import sha256_of

    run("replay", files / "cube.pack", files / "whole.mcap", "-o", "a.run.mcap")
    header = read_run(tmp_path / "a.run.mcap").header
    assert header["pack_sha256"] == sha256_of(files / "cube.pack") == load_pack(files / "cube.pack").sha256
    assert header["trace_sha256"] == sha256_of(files / "whole.mcap")
    assert json.loads(header["machine"]).keys() == {"cpu", "cores", "os", "python"}


def test_a_run_without_its_pack_is_not_reported(run, files, tmp_path):
    run("build", "shape:sphere", "-o", "other.pack", "--spheres-csv", files / "cube.csv")
    run("replay", files / "cube.pack", files / "whole.mcap", "-o", "a.run.mcap")
    code, _, errors = run("report", "a.run.mcap", "-o", "r")
    assert (code, len(errors)) == (2, 1)
    assert errors[0].startswith("E-PACK-HASH a.run.mcap") and "other.pack" in errors[0]
    assert not (tmp_path / "r").exists()


def test_a_reference_of_another_trace_is_not_taken(run, files, tmp_path):
    shorter = read_trace(files / "whole.mcap")
    columns = {
        name: getattr(shorter, name)[:100] for name in shorter.__dataclass_fields__ if name not in ("header", "lost")
    }
    write_trace(tmp_path / "short.mcap", Trace(header=shorter.header, **columns))
    run("replay", files / "cube.pack", files / "whole.mcap", "-o", "a.run.mcap")
    run("replay", files / "cube.pack", "short.mcap", "-o", "short.run.mcap")
    code, _, errors = run(
        "report", "a.run.mcap", "--pack", files / "cube.pack", "--reference", "short.run.mcap", "-o", "r"
    )
    assert (code, len(errors)) == (2, 1)
    assert errors[0].startswith("E-RUN-REFERENCE short.run.mcap")
    assert not (tmp_path / "r").exists()


def test_a_bug_of_palmar_is_one_line_with_exit_code_70(run, files, monkeypatch):
    monkeypatch.setattr("palmar.files.load_pack", lambda path: 1 / 0)
    code, out, errors = run("show", files / "cube.pack")
    assert (code, out, len(errors)) == (70, "", 1)
    assert "bug of Palmar" in errors[0] and "--debug" in errors[0]
    with pytest.raises(ZeroDivisionError):
        run("show", files / "cube.pack", "--debug")


def test_verbs_load_no_stage_that_they_do_not_use(files, tmp_path):
    def loaded(*arguments):
        program = "import sys; from palmar.cli import run; run(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
        done = subprocess.run([sys.executable, "-c", program, *map(str, arguments)], capture_output=True, text=True)
        return set(done.stderr.split())

    stages = {"palmar.tools", "palmar.traces", "palmar.eval", "trimesh", "igl", "manifold3d", "matplotlib", "scipy"}
    assert not loaded("--version") & (stages | {"numpy", "rich"})
    assert not loaded("--help") & (stages | {"numpy", "rich"})
    replay = ("replay", files / "cube.pack", files / "whole.mcap", "-o", tmp_path / "a.run.mcap")
    assert not loaded(*replay) & stages
