"""`palmar calibrate` and `palmar import` on made and on recorded positions, as a user runs them."""

import json
from pathlib import Path

import numpy as np
import pytest

from palmar import load_pack, read_run, read_trace
from palmar.cli import run
from palmar.eval.case import Case
from palmar.profile import bone_vectors
from palmar.tools.profile_file import read_profile

SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "traces"
OPTICAL = SHARED / "qualisys_pillow" / "pillow_first_30s.csv"
JOINTS = [SHARED / "quest3_webxr" / "quest3_right.csv", *sorted(SHARED.glob("leap/*.csv"))]
needs_recordings = pytest.mark.skipif(not OPTICAL.is_file(), reason="the shared recordings are not beside the project")


def answer(capsys, *arguments):
    assert run([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_measurements_make_a_hand(tmp_path, capsys):
    out = tmp_path / "anna.toml"
    flags = ["--hand-length-mm", 175, "--hand-breadth-mm", 76, "--length-mm", "index=38,22,14"]
    told = answer(capsys, "calibrate", "-o", out, *flags, "--width-mm", "index=19,17,15,12", "--side", "left")
    assert told["name"] == "anna" and told["sha256"] == read_profile(out).sha256
    assert told["hand"]["length_mm"] == 175.0 and told["hand"]["breadth_mm"] == 76.0
    assert told["hand"]["fingers"]["index"]["length_mm"] == [38.0, 22.0, 14.0]
    # More measurements are added to what is there.
    told = answer(capsys, "calibrate", out, "-o", out, "--hand-length-mm", 176)
    assert told["hand"]["length_mm"] == 176.0 and told["hand"]["fingers"]["index"]["length_mm"] == [38.0, 22.0, 14.0]
    pack = tmp_path / "a.pack"
    answer(capsys, "build", "shape:cube", "--spheres", 30, "--profile", out, "-o", pack)
    hand = load_pack(pack).hand
    np.testing.assert_allclose(np.linalg.norm(bone_vectors(hand, 1), axis=1), [0.038, 0.022, 0.014], atol=1e-9)
    assert hand.about["side"] == "left" and hand.about["profile_sha256"] == told["sha256"]


@pytest.mark.parametrize(
    ("flags", "found"),
    [
        (["--length-mm", "index=38,22"], "E-USAGE --length-mm"),
        (["--length-mm", "toe=38,22,14"], "E-USAGE --length-mm"),
        (["--length-mm", "index=38,22,1e9"], "E-USAGE --length-mm"),
        (["--length-mm", "index=38,22,0.014"], "E-CONF --length-mm"),
        (["--hand-length-mm", "0.175"], "hand_length_m"),
        (["--hand-breadth-mm", "nan"], "hand_breadth_m"),
        (["--side", "both"], "E-CONF --side"),
        (["--hand", "default:male-51"], "nearest: default:male-5"),
    ],
)
def test_a_wrong_measurement_is_one_line_and_no_file(flags, found, tmp_path, capsys):
    out = tmp_path / "me.toml"
    assert run(["calibrate", "-o", str(out), *flags]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and found in line and not out.exists()


@needs_recordings
@pytest.mark.parametrize("log", JOINTS, ids=lambda path: path.stem)
def test_recorded_joints_are_met_by_the_hand_of_their_user(log, tmp_path, capsys, request):
    if log.stem in ("pinch", "waiting_110fps") and not request.config.getoption("--all-recordings"):
        pytest.skip("only with --all-recordings")
    profile, trace = tmp_path / "me.toml", tmp_path / "log.mcap"
    told = answer(capsys, "calibrate", log, "-o", profile)
    spread = np.array([finger["spread_mm"] for finger in told["hand"]["fingers"].values()])
    assert spread.max() <= (
        0.7 if "quest" in log.stem else 0.01
    )  # mm; the Quest's file has millimetres, the Leap a model
    made = answer(capsys, "import", log, "--profile", profile, "-o", trace)
    limit = 3.0 if "quest" in log.stem else 0.6  # mm; asked are 3 of both
    assert made["residual_mm"]["fingertips"]["p99"] <= limit
    times = np.loadtxt(log, delimiter=",", skiprows=1, usecols=0)
    np.testing.assert_array_equal(read_trace(trace).time_s, times)  # gaps and all
    assert read_trace(trace).header["profile_sha256"] == told["sha256"]


@needs_recordings
def test_recorded_markers_are_met_and_the_missing_counted(tmp_path, capsys, request):
    log = OPTICAL
    if not request.config.getoption("--all-recordings"):
        lines = OPTICAL.read_text().splitlines()
        log = tmp_path / "fifth.csv"  # every fifth frame of all thirty seconds
        log.write_text("\n".join([lines[0], *lines[1::5]]) + "\n")
    profile = tmp_path / "me.toml"
    answer(capsys, "calibrate", log, "-o", profile)
    made = answer(capsys, "import", log, "--profile", profile, "-o", tmp_path / "log.mcap")
    assert made["residual_mm"]["fingertips"]["p99"] <= 5.0
    missing = sum(line.split(",").count("") for line in log.read_text().splitlines()) // 3
    assert made["changed"]["points not seen"] == missing > 0


@needs_recordings
@pytest.mark.parametrize("log", ["quest3_webxr/quest3_right.csv", "leap/handsplay_110fps.csv"])
def test_a_hand_calibrated_on_the_first_half_meets_the_second(log, tmp_path, capsys):
    lines = (SHARED / log).read_text().splitlines()
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    half = 1 + (len(lines) - 1) // 2
    first.write_text("\n".join(lines[:half]) + "\n")
    second.write_text("\n".join([lines[0], *lines[half:]]) + "\n")
    answer(capsys, "calibrate", first, "-o", tmp_path / "me.toml")
    made = answer(capsys, "import", second, "--profile", tmp_path / "me.toml", "-o", tmp_path / "log.mcap")
    assert made["residual_mm"]["fingertips"]["p99"] <= 3.0


@needs_recordings
@pytest.mark.parametrize("log", [JOINTS[0], SHARED / "leap" / "grab.csv"], ids=lambda path: path.stem)
def test_a_recorded_hand_closes_on_an_object_and_does_not_enter_it(log, tmp_path, capsys, request):
    if log.stem == "quest3_right" and not request.config.getoption("--all-recordings"):
        pytest.skip("13 s; only with --all-recordings")
    profile, pack, trace, out = (tmp_path / name for name in ("me.toml", "a.pack", "a.mcap", "a.run.mcap"))
    answer(capsys, "calibrate", log, "-o", profile)
    answer(capsys, "build", "shape:cylinder", "--spheres", 120, "--profile", profile, "-o", pack)
    answer(capsys, "import", log, "--profile", profile, "--grasp", pack, "-o", trace)
    told = answer(capsys, "replay", pack, trace, "-o", out)
    assert told["status"]["kept_previous"] == told["status"]["bad_sample"] == 0
    case = Case(read_run(out), load_pack(pack), "cylinder")
    assert len(set((case.run.contact_link[case.run.contact_link > 0] - 1) // 3)) >= 3  # fingers
    assert case.sphere_gap_m.min() >= -1e-6  # metres: what a verified pose may be short of

    # A trace of one person on the hand of another is told.
    answer(capsys, "build", "shape:cylinder", "--spheres", 120, "-o", pack)
    assert run(["replay", str(pack), str(trace), "-o", str(out), "--set", "rate_hz=100"]) == 0
    assert "fitted to another profile or none" in capsys.readouterr().err
