"""The order in which `palmar tune` tries reductions, in a made-up world where it is known what each comes to."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palmar import tune_search
from palmar.tune_cells import Model, Trial
from palmar.tune_search import COARSER, FINER, STEP, Search, Stage, parts_left_out, search

FULL, SAVES = 5000, {"iterations": 0.1, "corrections": 0.0, "reach_most_m": 0.05, "reach_least_m": 0.0}
ROW = SimpleNamespace(rule=SimpleNamespace(name="hover"), allowed=1.0)


@pytest.fixture
def world(monkeypatch):
    """Makes a search where an error of up to STEP ** steps holds, and settings that `forbidden` does not name."""

    def make(steps, forbidden=lambda settings: False, dear=lambda settings: False, **changed):
        def answer(bench, model, traces, rows):
            fine = 0.0 if model.pack.name == "full" else float(model.pack.name)
            broken = fine > STEP**steps * (1 + 1e-9) or forbidden(model.settings)
            # Each further value of a setting saves its share once more.
            share = np.prod(
                [
                    (1 - SAVES[name]) ** (1 + values.index(model.settings[name]))
                    for name, values in tune_search.SETTINGS
                    if name in model.settings
                ]
            )
            operations = {stat: model.spheres * float(share) for stat in ("mean", "p99", "max")}
            return Trial(model, {"hover": fine}, operations, [ROW] if broken else [])

        def place(bench, trial, traces, rows, tell):
            broken = [ROW] if dear(trial.model.settings) else []
            return Trial(trial.model, trial.values, trial.operations, broken)

        monkeypatch.setattr(tune_search, "try_answer", answer)
        monkeypatch.setattr(tune_search, "try_place", place)
        monkeypatch.setattr(
            Search, "model", lambda s, fine, settings: Model(Path(repr(fine)), int(1000 / fine**2), settings)
        )
        full = Model(Path("full"), FULL, {"rate_hz": 1000})
        tree = SimpleNamespace(about={"parameters": {"error_mm": 1.0}, "levels": [{}]})
        asked = {"rest_mm": 30.0, "left_out": [], "tries": 1000} | changed
        s = Search(
            bench=SimpleNamespace(name="bar", full=full),
            pack=SimpleNamespace(objects={"bar": tree}),
            traces=[Path("a.mcap")],
            rows=[ROW],
            seen_m=np.zeros((0, 4)),
            share_seen=0.1,
            seed=0,
            made=Path("made"),
            progress=lambda text, part: None,
            **asked,
        )
        start = Stage("full", "the full model", Trial(full, {"hover": 0.0}, {"mean": FULL, "p99": FULL}, []), 1.0)
        return s, search(s, start)

    return make


def named(stages):
    return {stage.name: stage for stage in stages}


@pytest.mark.parametrize("steps", range(15))
def test_the_largest_error_that_holds_is_found(world, steps):
    s, stages = world(steps)
    found = named(stages).get("coarser contact")
    most = min(steps, COARSER[-1])
    assert (found.fine_mm if found else 1.0) == pytest.approx(STEP**most, rel=1e-12)
    tried = [row["fine_mm"] for row in s.tried if not row["settings"].keys() - {"rate_hz"}]
    assert len(tried) <= 8 and len(set(tried)) == len(tried)
    assert named(stages)["coarse rest"].fine_mm == 1.0


def test_where_hands_come_it_is_never_coarser_than_elsewhere(world):
    found = named(world(12, rest_mm=STEP**5 * 1.01)[1])["coarser contact"]
    assert found.fine_mm == pytest.approx(STEP**5, rel=1e-12)


def test_a_model_that_has_to_be_finer_is_not_tried_coarser(world):
    s, stages = world(-2)
    assert named(stages)["coarse rest"].fine_mm == pytest.approx(STEP ** FINER[1], rel=1e-12)
    assert "coarser contact" not in named(stages)
    assert [row["broken"] != [] for row in s.tried[:3]] == [True, True, False]
    # Finer than any that is tried: the spheres stay, and only settings are cheaper.
    assert [stage.name for stage in world(-20)[1]] == ["full", "settings"]


def test_parts_that_came_near_nothing_touch_nothing_if_that_holds(world):
    kept = named(world(0, left_out=["thumb", "little"])[1])["parts left out"].trial.model
    assert kept.settings["leave_out"] == "thumb+little" and kept.settings["rate_hz"] == 1000
    stages = world(0, forbidden=lambda settings: "leave_out" in settings, left_out=["thumb"])[1]
    assert "parts left out" not in named(stages)


def test_settings_go_as_far_as_they_hold_and_save(world):
    s, stages = world(0, forbidden=lambda settings: settings.get("iterations", 9) < 2)
    settings = named(stages)["settings"].trial.model.settings
    assert {key: value for key, value in settings.items() if key != "rate_hz"} == {
        "iterations": 2,
        "reach_most_m": 0.0015,
    }
    why = {row["what"]: row["why"] for row in s.tried}
    assert why["corrections 1"] == why["reach_least_m 0.0001"] == "saves nothing" and why["iterations 1"] == ""


def test_settings_that_break_a_limit_together_are_taken_back_from_the_last(world):
    stages = world(0, dear=lambda settings: settings.get("iterations", 9) < 3)[1]
    settings = named(stages)["settings"].trial.model.settings
    assert settings.get("iterations") == 3 and "reach_most_m" not in settings
    assert "settings" not in named(world(0, dear=lambda settings: "iterations" in settings)[1])


@pytest.mark.parametrize("tries", [1, 2, 3, 5, 8])
def test_no_more_is_tried_than_was_asked_for(world, tries):
    assert len(world(5, tries=tries)[0].tried) == tries


def test_parts_beyond_the_guard_are_left_out_but_never_all():
    assert parts_left_out({"thumb": 0.1, "index": 0.001, "palm": 0.011}, 0.01) == ["thumb", "palm"]
    assert parts_left_out({"thumb": 0.1, "index": 0.2}, 0.01) == []
