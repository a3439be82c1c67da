"""Golden numbers: what was planted is found and named, and nothing else is."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from palmar import golden
from palmar.model import load_pack, save_pack
from palmar.records import read_trace, write_trace
from palmar.tools.hand_file import default_hand

OF_THE_PROJECT = Path(__file__).parent / "data" / "golden.csv"
SCENES = ("concave_notch", "limits_against_contact")


@pytest.fixture
def kept(run, tmp_path):
    """golden.csv of two scenes."""
    assert run("check", *SCENES, "--golden", "golden.csv", "--update", "--reason", "first numbers")[0] == 0
    return tmp_path / "golden.csv"


def rows_of(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_the_same_core_gives_the_same_numbers(run, kept):
    code, out, errors = run("check", "--golden", "golden.csv")
    assert (code, errors) == (0, [])
    assert [line.split()[0] for line in out.splitlines()] == list(SCENES) and "FAILS" not in out
    assert {row["reason"] for row in rows_of(kept)} == {"first numbers"}


def test_the_projects_own_scenes_give_the_numbers_that_are_kept(run):
    # Without the trail, which is of one build: what is kept is meant to hold for every compiler.
    code, out, errors = run("check", "--golden", OF_THE_PROJECT)
    assert (code, errors) == (0, []), out
    assert len(out.splitlines()) == 4 and "FAILS" not in out


def test_a_micrometre_of_a_radius_is_found_and_named(run, kept, monkeypatch):
    hand = default_hand()
    radius = hand.phalanx_radius_m.copy()
    radius[1, 2, 1] += 1e-6  # the index's tip
    monkeypatch.setattr(golden, "default_hand", lambda: replace(hand, phalanx_radius_m=radius))
    code, out, _ = run("check", "--golden", "golden.csv", "--json")
    assert code == 1
    failures = json.loads(out)["failures"]
    offset = next(f for f in failures if f["metric"] == "palm_offset" and f["scene"] == "limits_against_contact")
    assert abs(offset["old"] - offset["new"]) < 2e-3  # mm: the palm stands off by no more than the tip grew
    assert offset["first_beyond"] > 100 and offset["first_step"] is not None
    assert any(cause.startswith("hand.phalanx_radius_m[1, 2, 1] was 0.0067") for cause in offset["causes"])


def test_a_joint_limit_is_named_even_where_no_number_tells(run, kept, monkeypatch):
    hand = default_hand()
    limit = hand.flexion_limit_rad.copy()
    limit[3, 2, 1] -= 0.001
    monkeypatch.setattr(golden, "default_hand", lambda: replace(hand, flexion_limit_rad=limit))
    code, out, _ = run("check", "--golden", "golden.csv")
    assert code == 1 and out.count("FAILS hand.flexion_limit_rad[3, 2, 1] was ") == 2


def test_friction_in_the_forces_is_found_in_the_metric_meant_for_it(run, kept, monkeypatch):
    def with_friction(*arguments):
        answer = replay(*arguments)
        across = np.zeros_like(answer.palm_force_n)
        across[:, 1] = 0.1 * np.linalg.norm(answer.palm_force_n, axis=1)
        return replace(answer, palm_force_n=answer.palm_force_n + across)

    replay = golden.replay_case
    monkeypatch.setattr(golden, "replay_case", with_friction)
    code, out, _ = run("check", "concave_notch", "--golden", "golden.csv", "--json")
    failures = json.loads(out)["failures"]
    friction = next(f for f in failures if f["metric"] == "friction_force")
    assert code == 1 and friction["new"] > 100 * friction["old"]
    # The first touch is lighter than the tolerance.
    assert 0 < friction["first_step"] <= friction["first_beyond"] <= friction["first_step"] + 2
    assert friction["causes"] == ["hand, object, input and settings are the same"]


def test_an_update_changes_and_explains_what_changed_and_nothing_else(run, kept):
    rows = rows_of(kept)
    changed = next(k for k, row in enumerate(rows) if row["metric"] == "palm_offset")
    wrong = kept.read_text().replace(rows[changed]["value"], "7.5")
    kept.write_text(wrong)
    code, out, _ = run("check", "--golden", "golden.csv")
    assert code == 1 and "palm_offset mean was 7.5 mm, is " in out
    assert run("check", "--golden", "golden.csv", "--update", "--reason", "it was wrong")[0] == 0
    again = rows_of(kept)
    assert again[changed] == rows[changed] | {"reason": "it was wrong"}
    assert [row for k, row in enumerate(again) if k != changed] == [row for k, row in enumerate(rows) if k != changed]


def test_ci_systems_get_xml_and_a_summary(run, kept, tmp_path):
    kept.write_text(kept.read_text().replace("palm_offset,max,mm,", "palm_offset,max,mm,1", 1))
    code, _, _ = run("check", "--golden", "golden.csv", "--junit", "j.xml", "--markdown", "s.md")
    suite = Xml.parse(tmp_path / "j.xml").getroot()
    failed = [case for case in suite if case.find("failure") is not None]
    assert code == 1 and suite.get("failures") == "1" == str(len(failed))
    assert failed[0].get("classname").endswith(".progressive") and failed[0].get("name") == "palm_offset max"
    assert (tmp_path / "s.md").read_text().startswith("## palmar check: 1 of 3 failed\n")


def test_a_recorded_trace_is_golden_with_its_pack_and_moves_with_its_folder(run, kept, tmp_path):
    run("check", "concave_notch", "--quick", "-o", "o", "--runs")
    folder = tmp_path / "data"
    folder.mkdir()
    trace, pack = folder / "notch.mcap", folder / "notch.pack"
    (tmp_path / "o" / "concave_notch-progressive.mcap").rename(trace)
    (tmp_path / "o" / "concave_notch-progressive.pack").rename(pack)
    line = (
        "check",
        trace,
        "--golden",
        folder / "g.csv",
        "--pack",
        pack,
        "--solver",
        "paper",
        "--solver",
        "progressive",
    )
    assert run(*line, "--update", "--reason", "recorded")[0] == 0
    assert {(row["scene"], row["pack"], row["solver"]) for row in rows_of(folder / "g.csv")} == {
        ("notch.mcap", "notch.pack", "paper"),
        ("notch.mcap", "notch.pack", "progressive"),
    }
    folder.rename(tmp_path / "elsewhere")
    assert run("check", "--golden", "elsewhere/g.csv")[0] == 0

    # A sphere that is 1 um larger is named by its number, a sample that is another by its step.
    pack = tmp_path / "elsewhere" / "notch.pack"
    assets = load_pack(pack)
    assets.objects["object"].levels[-1][17, 3] += 1e-6
    save_pack(pack, assets)
    samples = read_trace(tmp_path / "elsewhere" / "notch.mcap")
    samples.flexion_rad[900, 0, 0] += 1e-3
    write_trace(tmp_path / "elsewhere" / "notch.mcap", samples)
    out = run("check", "--golden", "elsewhere/g.csv")[1]
    assert "object.spheres_m differs" in out and "first number 17" in out and "differs from step 9" in out


def test_each_mistake_is_one_line_with_exit_code_2(run, kept, tmp_path):
    (tmp_path / "cut.csv").write_text("scene,metric\n")
    (tmp_path / "word.csv").write_text(kept.read_text().replace(",0.0001,", ",little,", 1))
    (tmp_path / "metric.csv").write_text(kept.read_text().replace("palm_offset,mean", "palm_ofset,mean", 1))
    before = sorted(path.name for path in tmp_path.iterdir())
    mistakes = {
        ("check", "--golden", "absent.csv"): "E-FILE-MISSING absent.csv",
        ("check", "--golden", "cut.csv"): "E-GOLDEN cut.csv:1: ",
        ("check", "--golden", "word.csv"): "E-GOLDEN word.csv:2: tolerance 'little'",
        ("check", "--golden", "metric.csv"): "E-GOLDEN metric.csv:",
        ("check", "poke", "--golden", "golden.csv"): "E-GOLDEN golden.csv: says nothing of poke",
        ("check", "--golden", "golden.csv", "--update"): "E-USAGE --update: says why in --reason",
        ("check", "--golden", "golden.csv", "--update", "--reason", " "): "E-USAGE --update: says why",
        ("check", "--golden", "golden.csv", "--reason", "x"): "E-USAGE --reason: goes with --update",
        ("check", "--update", "--reason", "x"): "E-USAGE --golden: ",
        ("check", "--golden", "golden.csv", "--quick"): "E-USAGE --golden: goes without",
        ("check", "grasp", "--golden", "golden.csv", "--update", "--reason", "x"): "E-CONF grasp: ",
        ("check", "--golden", "golden.csv", "--junit", "absent/j.xml"): "E-FILE-PLACE absent",
        ("check", "concave_notch", "--runs"): "E-USAGE --runs: ",
        ("compare", "absent.run.mcap", "golden.csv"): "E-FILE-MISSING absent.run.mcap",
    }
    for arguments, start in mistakes.items():
        code, out, errors = run(*arguments)
        assert (code, out, len(errors)) == (2, "", 1), (arguments, out, errors)
        assert errors[0].startswith(start), errors
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_two_runs_are_compared_by_pose_by_setting_and_by_metric(run, tmp_path):
    run("check", "concave_notch", "--quick", "-o", "o", "--runs")
    pack, trace = (f"o/concave_notch-progressive.{ending}" for ending in ("pack", "mcap"))
    for name, solver in (("a", "progressive"), ("b", "progressive"), ("c", "paper")):
        assert run("replay", pack, trace, "-o", f"o/{name}.run.mcap", "--solver", solver)[0] == 0
    code, out, _ = run("compare", "o/a.run.mcap", "o/b.run.mcap")
    assert code == 0 and out.startswith("the same poses, forces and status in every step")
    code, out, _ = run("compare", "o/a.run.mcap", "o/c.run.mcap")
    assert code == 1 and out.startswith("first differing step ") and "settings.solver" in out and "palm_offset" in out
    code, out, _ = run("compare", "o/a.run.mcap", "o/c.run.mcap", "--json")
    answer = json.loads(out)
    assert code == 1 and answer["first_asked"] is None and answer["largest"]["palm"]["value"] > 0
    assert answer["header"]["solver"] == ["progressive", "paper"] and answer["packs"] == []

    code, out, _ = run("compare", "o/a.run.mcap", "o/c.run.mcap", "-o", "page")
    assert code == 1 and out.splitlines()[-1] == "page: page/index.html"
    page = (tmp_path / "page" / "index.html").read_text()
    assert f'data-step="{answer["first_step"]}">first differing step' in page and "settings.solver" in page
    assert json.loads((tmp_path / "page" / "compare.json").read_text())["largest"] == answer["largest"]
