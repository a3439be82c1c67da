"""The report on a made-up run: what it draws, what it writes, and that the page works in a real browser."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from browser import ABSENT, AT_REST, CHROMIUM, DRIVER, open_browser

from palmar.errors import PalmarError
from palmar.eval.explain import MEANING
from palmar.eval.figures import write_figures
from palmar.eval.judge import fingertips, graphic_poses
from palmar.eval.metrics import METRICS
from palmar.eval.page import build_page, metrics_table, number_text, value_cell
from palmar.eval.panels import Judged, Panel, hard_steps, panels, thin, worst_steps
from palmar.eval.report import OF_A_REPORT, fill_folder, run_names, write_report
from palmar.eval.view3d import MOST_FRAMES, frame_steps, three_js
from palmar.files import whole_folder
from palmar.model import AssetPack, HandModel, SphereTree
from palmar.records import Run
from palmar.tools.hierarchy import bounds_over


def made_hand() -> HandModel:
    """Five parallel fingers on a flat palm, palmar side -z; the thumb is set apart like a finger."""
    x = np.array([44.0, 28.0, 9.5, -9.5, -28.0]) * 1e-3
    y = np.array([30.0, 88.0, 92.0, 87.0, 78.0]) * 1e-3
    length = np.array([[40, 34, 27], [42, 25, 22], [46, 29, 23], [42, 27, 23], [33, 20, 20]]) * 1e-3
    joint = np.zeros((5, 3, 3))
    phalanx = np.zeros((5, 3, 2, 3))
    for finger in range(5):
        start = np.array([x[finger], y[finger], 0.0])
        for part in range(3):
            joint[finger, part] = phalanx[finger, part, 0] = start
            start = start + np.array([0.0, length[finger, part], 0.0])
            phalanx[finger, part, 1] = start
    columns, rows = np.meshgrid(np.linspace(-0.036, 0.036, 5), np.linspace(0.004, 0.084, 6))
    palm = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(30), np.full(30, 0.012)])
    return HandModel(
        palm_spheres_m=palm,
        joint_m=joint,
        flexion_axis=np.broadcast_to([-1.0, 0, 0], (5, 3, 3)).copy(),
        abduction_axis=np.broadcast_to([0.0, 0, 1], (5, 3)).copy(),
        phalanx_m=phalanx,
        phalanx_radius_m=np.broadcast_to([[0.0095, 0.009], [0.009, 0.008], [0.008, 0.007]], (5, 3, 2)).copy(),
        flexion_limit_rad=np.broadcast_to([-0.5, 2.0], (5, 3, 2)).copy(),
        abduction_limit_rad=np.broadcast_to([-0.4, 0.4], (5, 2)).copy(),
        joint_stiffness_n_m_per_rad=np.full((5, 3), 0.5),
        palm_stiffness_n_per_m=np.array([1000.0]),
        palm_rotation_stiffness_n_m_per_rad=np.array([1.0]),
        about={"name": "made", "side": "right", "source": "test", "sha256": ""},
    )


def made_pack() -> AssetPack:
    """The hand and a box of 60 x 40 x 40 mm with 24 leaf spheres."""
    box = trimesh.creation.box((0.06, 0.04, 0.04))
    grid = np.stack(np.meshgrid([-0.02, -0.01, 0.0, 0.01, 0.02, 0.0], [-0.01, 0.01], [-0.01, 0.01]), axis=-1)
    leaves = np.column_stack([grid.reshape(-1, 3), np.full(24, 0.0125)])
    coarse = np.array([[0.0, 0, 0, 0.05]])
    tree = SphereTree(
        levels=[coarse, leaves],
        bounds=[bounds_over(coarse), bounds_over(leaves)],
        vertices_m=np.asarray(box.vertices),
        faces=np.asarray(box.faces, dtype=np.int32),
        about={"source": "box", "levels": [{"spheres": 1}, {"spheres": 24}]},
    )
    return AssetPack(made_hand(), {"box": tree}, {"schema": "palmar.pack/2"}, sha256="0" * 64)


def made_run(steps: int = 2000, rate_hz: float = 1000.0) -> Run:
    """The haptic hand closes, holds and opens over the box; the graphic hand lags behind it by a made-up rule."""
    time = np.arange(steps) / rate_hz
    close = np.sin(np.pi * time / time[-1]) ** 2
    flexion = close[:, None, None] * np.array([0.9, 0.8, 0.5]) * np.ones((steps, 5, 3))
    graphic = np.minimum(flexion, np.array([0.55, 0.5, 0.3]))
    abduction = 0.15 * close[:, None] * np.array([0.8, 0.4, 0.0, -0.3, -0.7])
    palm = np.column_stack([0.01 * np.sin(3 * time), np.full(steps, -0.1), 0.05 - 0.01 * close])
    force = 8.0 * (flexion - graphic).sum(axis=2)
    direction = np.array([[0.2, -0.3, 1.0], [0.1, 0.4, 1.0], [0.0, 0.3, 1.0], [-0.1, 0.3, 1.0], [-0.2, 0.2, 1.0]])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    cpu = 30 + 25 * close + 3 * np.abs(np.sin(97 * np.arange(steps)))
    touching = (force > 0).sum(axis=1).astype(np.uint32) * 7
    turn = np.zeros((steps, 4))
    turn[:, 0], turn[:, 3] = np.cos(0.2 * time), np.sin(0.2 * time)
    upright = np.tile([1.0, 0, 0, 0], (steps, 1))
    status = np.zeros(steps, dtype=np.uint32)
    status[steps // 2 : steps // 2 + 3] = 2
    phases = [
        {"name": name, "start_s": time[-1] * start, "end_s": time[-1] * end}
        for name, start, end in (("close", 0, 0.4), ("hold", 0.4, 0.6), ("open", 0.6, 1.0))
    ]
    zeros = np.zeros((steps, 3))
    return Run(
        header={
            "schema": "palmar.run/1",
            "solver": "none",
            "object": "box",
            "level": "1",
            "rate_hz": "1000",
            "settings": '{"tolerance_m": 1e-09}',
            "machine": '{"cpu": "<made & up>"}',
            "build": "{}",
            "pack_sha256": "0" * 64,
            "phases": json.dumps(phases),
        },
        time_s=time,
        status=status,
        palm_position_m=palm + [0, 0, 0.004] * close[:, None],
        palm_rotation_wxyz=turn,
        flexion_rad=graphic,
        abduction_rad=abduction,
        haptic_palm_position_m=palm,
        haptic_palm_rotation_wxyz=turn,
        haptic_flexion_rad=flexion,
        haptic_abduction_rad=abduction,
        object_position_m=zeros,
        object_rotation_wxyz=upright,
        palm_force_n=4.0 * close[:, None] * [0, 0, 1.0],
        palm_torque_n_m=zeros,
        joint_torque_n_m=0.5 * (graphic - flexion),
        fingertip_force_n=force[:, :, None] * direction,
        equation14_force_n=force[:, :, None] * direction * 1.5,
        contacts=touching,
        operations=np.full(steps, 50, dtype=np.uint32),
        state_hash=np.arange(steps, dtype=np.uint64),
        cpu_us=cpu,
        wall_us=cpu * 1.1,
        search_us=cpu * 0.3,
        solve_us=cpu * 0.4,
        verify_us=cpu * 0.3,
        contact_start=np.zeros(steps + 1, dtype=np.int64),
        contact_link=np.zeros(0, dtype=np.uint8),
        contact_object_sphere=np.zeros(0, dtype=np.uint32),
        contact_palm_sphere=np.zeros(0, dtype=np.uint32),
        contact_gap_m=np.zeros(0),
        contact_force_n=np.zeros(0),
        contact_point_m=np.zeros((0, 3)),
        contact_normal=np.zeros((0, 3)),
    )


def made_judged(name: str = "made", steps: int = 2000) -> Judged:
    """The run with made-up rows: one inside its limit at zero, one that breaks it, one without a limit."""
    run = made_run(steps)
    depth = np.zeros(steps)
    mesh = 0.2 * np.abs(np.sin(5 * run.time_s))
    rows = [
        {"metric": "penetration_spheres", "stat": "max", "unit": "mm", "value": 0.0, "limit": 0.001, "margin_db": None},
        {"metric": "penetration_mesh", "stat": "max", "unit": "mm", "value": 0.2, "limit": 0.1, "margin_db": -6.0206},
        {"metric": "penetration_mesh", "stat": "p99", "unit": "mm", "value": 0.19, "limit": None, "margin_db": None},
        {"metric": "step_cpu", "stat": "p99", "unit": "us", "value": 57.9, "limit": None, "margin_db": None},
    ]
    return Judged(
        name=name,
        run=run,
        pack=made_pack(),
        object_name="box",
        rows=rows,
        series={"penetration_spheres": depth, "penetration_mesh": mesh},
        verdict="penetration_mesh max is 0.2 mm, over its limit of 0.1 mm.",
        passed=False,
        sources={"run": Path(f"{name}.run.mcap"), "pack": Path("box.pack")},
    )


def test_thinning_keeps_the_highest_and_lowest_value_of_every_line():
    time = np.arange(600_000) * 1e-3  # ten minutes at 1 kHz
    noise = np.random.default_rng(0).normal(size=(5, len(time)))
    lines = {str(i): line for i, line in enumerate(noise)}
    thinned = thin(Panel("k", "t", "a, N", time, lines))
    assert len(thinned.time_s) * len(lines) <= 12_100  # the promise, and a few for the two ends
    for name, line in lines.items():
        assert thinned.lines[name].max() == line.max()
        assert thinned.lines[name].min() == line.min()
    assert (thinned.time_s[0], thinned.time_s[-1]) == (time[0], time[-1])


def test_a_run_of_ten_minutes_is_shown_with_a_bounded_number_of_frames_that_hold_the_worst_step():
    steps = frame_steps(replace(made_run(10), time_s=np.arange(600_000) * 1e-3), extra=[123_457])
    assert len(steps) <= MOST_FRAMES + 1
    assert 123_457 in steps
    assert steps[0] == 0 and steps[-1] == 599_999


def test_worst_steps_are_where_the_series_peak():
    judged = made_judged()
    judged.run.fingertip_force_n[700:, 1, 2] += 0.5
    worst = worst_steps(judged)
    assert worst["largest force jump"][0] == 700
    assert worst["slowest step"][0] == int(np.argmax(judged.run.cpu_us))
    assert worst["deepest in the mesh"][0] == int(np.argmax(judged.series["penetration_mesh"]))


def test_hard_steps_are_counted_by_reason():
    assert hard_steps(made_run()) == {"iteration_limit": 3}


def test_a_depth_of_zero_is_shown_as_zero_and_passes():
    cell = value_cell({"metric": "m", "stat": "max", "unit": "mm", "value": 0.0, "limit": 0.001})
    assert cell == '<td class="number pass">0</td>'
    assert number_text(None) == "&ndash;"
    assert number_text(1806076.0) == "1,806,076"


def test_every_metric_of_the_table_has_its_words():
    assert set(MEANING) == {metric.name for metric in METRICS}


def test_a_limit_of_the_scene_is_shown_with_its_reason():
    row = {"run": "a", "metric": "hover", "stat": "p99", "unit": "mm", "value": 0.4, "limit": 0.5, "margin_db": 1.9}
    assert "Limit of the scene: holes &amp; rims." in metrics_table([row | {"reason_limit": "holes & rims"}])
    none = row | {"limit": None, "margin_db": None, "reason_limit": "holes"}
    assert "Limit of the scene, none: holes." in metrics_table([none])
    assert "Limit of the scene" not in metrics_table([row])


def test_figures_are_the_same_bytes_twice_and_the_csv_is_what_is_drawn(tmp_path):
    charts = panels(made_judged(steps=400))
    digests = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        files = list(write_figures("run", charts, tmp_path / name))
        digests.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files})
    assert digests[0] == digests[1]
    assert {Path(name).suffix for name in digests[0]} == {".pdf", ".svg", ".png", ".csv"}
    table = np.genfromtxt(tmp_path / "a" / "run-fingertip_force.csv", delimiter=",", names=True)
    assert table.dtype.names[:2] == ("time_s", "thumb_n")
    # 9 digits are written.
    np.testing.assert_allclose(table["index_n"], charts[0].lines["index"], rtol=1e-8, atol=1e-12)


def test_runs_of_one_name_are_told_apart():
    runs = [(Path(p), Path("x.pack")) for p in ("a/cup.run.mcap", "b/cup.run.mcap", "rock.run.mcap")]
    assert run_names(runs) == ["cup-1", "cup-2", "rock"]


def test_a_folder_with_other_files_is_not_overwritten(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(PalmarError, match="E-FILE-PLACE"):
        write_report([], tmp_path)


def test_an_earlier_report_is_replaced_whole(tmp_path):
    out = tmp_path / "report"
    (out / "figures").mkdir(parents=True)
    (out / "figures" / "old.png").write_text("")
    with whole_folder(out, OF_A_REPORT, "report") as folder:
        fill_folder([made_judged(steps=200)], folder, lambda what: None)
    assert {path.name for path in out.iterdir()} == OF_A_REPORT
    assert not (out / "figures" / "old.png").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["report"]  # no temporary folder stays


def test_trimesh_ships_three_js_with_controls():
    source = three_js()
    assert "THREE.TrackballControls=TrackballControls" in source
    assert "</script" not in source


def test_the_page_asks_for_nothing_from_outside():
    page = build_page([made_judged(steps=200)], "one & only")
    own = page.split("<script>")[0]  # our HTML and CSS; libraries only name addresses in comments and links
    assert "http" not in own
    assert "<title>one &amp; only</title>" in own
    assert "&lt;made &amp; up&gt;" in own


# ---- in a browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A page of two runs in headless Chromium."""
    pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    if not (CHROMIUM and DRIVER):
        pytest.skip(ABSENT)
    folder = tmp_path_factory.mktemp("page")
    (folder / "index.html").write_text(
        build_page([made_judged("first"), made_judged("second")], "two"), encoding="utf-8"
    )
    chrome = open_browser(folder / "profile")
    chrome.get((folder / "index.html").as_uri())
    yield chrome
    chrome.quit()


def settled(chrome):
    """Wait until what was asked for has been drawn."""
    chrome.execute_async_script(AT_REST)


def move_slider(chrome, frame):
    slider = chrome.find_element("css selector", "#run-0 .time-slider")
    chrome.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))", slider, frame
    )
    settled(chrome)


def test_the_slider_moves_the_hand_the_clock_and_the_cursor(browser):
    canvas = browser.find_element("css selector", "#run-0 canvas")
    seen = []
    for frame in (0, 60, 100):
        move_slider(browser, frame)
        clock = browser.find_element("css selector", "#run-0 .clock").text
        cursor = browser.find_element("css selector", "#run-0 .cursor").value_of_css_property("transform")
        seen.append((canvas.screenshot_as_base64, clock, cursor))
    for before, after in pairwise(seen):
        assert all(a != b for a, b in zip(before, after, strict=True))
    move_slider(browser, 0)
    assert canvas.screenshot_as_base64 == seen[0][0]  # the same moment is the same picture


def test_a_click_on_a_chart_goes_to_that_time(browser):
    from selenium.webdriver import ActionChains

    move_slider(browser, 0)
    plot = browser.find_element("css selector", "#run-0 .plot .nsewdrag")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    ActionChains(browser).move_to_element(plot).pause(0.3).click().perform()
    settled(browser)
    time = browser.execute_script("return replays.get(0).times[replays.get(0).frame]")
    # The middle of the axis is the middle of 2 s, give or take a pixel of 4 ms and a frame of 10 ms.
    assert time == pytest.approx(1.0, abs=0.02)


def test_a_worst_step_button_goes_to_that_very_step(browser):
    step = worst_steps(made_judged())["slowest step"][0]
    browser.execute_script(f"document.querySelector('#run-0 [data-step=\"{step}\"]').click()")
    settled(browser)
    assert f"step {step} " in browser.find_element("css selector", "#run-0 .clock").text


def test_the_hand_on_the_page_stands_where_the_judge_puts_it(browser):
    judged = made_judged()
    for frame in (0, 57, 130):
        move_slider(browser, frame)
        step, shown = browser.execute_script(
            "const r = replays.get(0), s = r.view; s.scene.updateMatrixWorld(true);"
            "return [r.steps[r.frame],"
            " s.hand.fingertips.map(n => n.getWorldPosition(new THREE.Vector3()).toArray())]"
        )
        expected = fingertips(judged.pack.hand, graphic_poses(judged.run))[step]
        # Millimetres on the page, from 32-bit poses of about 0.2 m: 2e-8 m of rounding each, ten in a chain.
        np.testing.assert_allclose(np.array(shown) * 1e-3, expected, atol=1e-6)


def test_the_leaf_spheres_can_be_shown_instead_of_the_mesh(browser):
    canvas = browser.find_element("css selector", "#run-0 canvas")
    before = canvas.screenshot_as_base64
    box = browser.find_element("css selector", "#run-0 [data-toggle=spheres]")
    browser.execute_script("arguments[0].click()", box)
    settled(browser)
    assert canvas.screenshot_as_base64 != before


def test_the_console_stays_free_of_errors(browser):
    browser.execute_script("document.querySelector('#run-1').scrollIntoView()")
    settled(browser)
    assert browser.execute_script("return replays.size") == 2  # both runs were set up
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
