"""How large the page of a long run is, how soon it stands in Chromium, and how many frames its slider draws a second.

    .venv/bin/python tests/eval/page_figures.py [--minutes 10] [--shape ears] [--spheres 3000] [--keep DIR] [--judge]

Without --judge the page is built without judging every step, with depths of 0: the same size, and minutes earlier.
The run is a grasp of 6 s again and again, its place varied by the seed. Chromium draws with the processor.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from browser import ABSENT, AT_REST, CHROMIUM, DRIVER, open_browser

from palmar.eval.page import build_page
from palmar.eval.panels import Judged
from palmar.eval.report import write_report
from palmar.model import AssetPack, load_pack, save_pack
from palmar.records import Trace, read_run, write_trace
from palmar.replay import replay_file
from palmar.tools.hand_file import default_hand
from palmar.tools.shapes import SHAPES
from palmar.tools.spread import spread_levels
from palmar.traces.scripted import load_scene, script_trace

DIFFERENT = 10  # grasps, then the same again
# A new place of the slider for each frame that the browser draws; the picture is asked for at the end of each.
SLIDE = """
const [seconds, done] = arguments, replay = replays.get(0), slider = replay.slider, count = replay.times.length;
const began = performance.now(), gaps = [];
let frames = 0, before = began;
const next = now => {
  if (frames) gaps.push(now - before);
  before = now;
  if (now - began > 1000 * seconds) {
    const sorted = gaps.slice().sort((a, b) => a - b);
    const at = share => sorted[Math.floor(share * sorted.length)];
    return done({ frames, seconds: (now - began) / 1000, p50: at(0.5), p95: at(0.95) });
  }
  slider.value = Math.floor(count * ((0.37 + frames * 0.0021) % 1));
  slider.dispatchEvent(new Event("input"));
  frames += 1;
  requestAnimationFrame(next);
};
requestAnimationFrame(next);
"""


def make_run(folder: Path, shape: str, spheres: int, minutes: float) -> tuple[Path, Path]:
    """Pack and run in the folder."""
    pack, trace, run = folder / "long.pack", folder / "long.mcap", folder / "long.run.mcap"
    tree = spread_levels(*SHAPES[shape](), [spheres], {"source": f"shape:{shape}", "sha256": "", "units": "m"})
    save_pack(pack, AssetPack(default_hand(), {shape: tree}, {"tools": {}, "seed": 0}))
    scene = load_scene("grasp")[0]
    grasps = [script_trace(scene, default_hand(), tree, seed) for seed in range(DIFFERENT)]
    count = round(60_000 * minutes)
    rows = [grasps[k % DIFFERENT] for k in range(-(-count // len(grasps[0].time_s)))]
    columns = {
        name: np.concatenate([getattr(grasp, name) for grasp in rows])[:count]
        for name in Trace.__dataclass_fields__
        if name not in ("header", "lost")
    }
    header = {key: value for key, value in grasps[0].header.items() if key != "phases"}
    write_trace(trace, Trace(header | {"object": shape}, **columns | {"time_s": 1e-3 * np.arange(count)}))
    replay_file(pack, trace, run, object_name=shape)
    return pack, run


def write_unjudged(folder: Path, shape: str) -> None:
    """The page with all poses, contacts and curves of the run, and depths of 0."""
    run, pack = read_run(folder / "long.run.mcap"), load_pack(folder / "long.pack")
    count = len(run.time_s)
    series = {name: np.zeros(count) for name in ("penetration_spheres", "penetration_mesh")}
    sources = {name: folder / f"long.{name}" for name in ("run", "pack")}
    judged = Judged("long", run, pack, shape, [], series, "Not judged.", True, sources, None, np.zeros((count, 16)))
    (folder / "report").mkdir(exist_ok=True)
    (folder / "report" / "index.html").write_text(build_page([judged], "long"), encoding="utf-8")


def cpu_seconds(root: int) -> float:
    """Processor time of a process and all below it: a browser draws in several, and a busy machine stretches clocks."""
    parent, spent = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parent[int(path.parent.name)], spent[int(path.parent.name)] = int(fields[1]), int(fields[11]) + int(fields[12])
    below, grown = {root}, True
    while grown:
        more = {pid for pid, of in parent.items() if of in below} - below
        below, grown = below | more, bool(more)
    return sum(spent.get(pid, 0) for pid in below) / os.sysconf("SC_CLK_TCK")


def measure_page(page: Path, profile: Path) -> dict[str, float]:
    """Seconds until the first picture and the charts stand; frames a second of the slider at two sizes of a window."""
    chrome = open_browser(profile)
    try:
        chrome.set_page_load_timeout(300)
        chrome.set_script_timeout(300)
        began = time.perf_counter()
        chrome.get(page.as_uri())
        chrome.execute_async_script(AT_REST)
        found = {"load_s": time.perf_counter() - began}
        chrome.execute_async_script(SLIDE, 2)  # warm-up: the meshes of what moves are made
        chrome.execute_async_script(AT_REST)
        for name, size in (("", (1280, 900)), ("_full_hd", (1920, 1080))):
            chrome.set_window_size(*size)
            chrome.execute_async_script(AT_REST)
            before = cpu_seconds(chrome.service.process.pid)
            told = chrome.execute_async_script(SLIDE, 8)
            found[f"cpu_ms_a_frame{name}"] = 1e3 * (cpu_seconds(chrome.service.process.pid) - before) / told["frames"]
            found |= {f"frames_a_second{name}": told["frames"] / told["seconds"], f"frame_p50_ms{name}": told["p50"],
                      f"frame_p95_ms{name}": told["p95"]}  # fmt: skip
        began = time.perf_counter()
        chrome.execute_async_script(
            "const done = arguments[0], v = replays.get(0).view; v.draw(); requestAnimationFrame(() => done())"
        )
        found["whole_picture_s"] = time.perf_counter() - began
        errors = [entry for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]
        return {**found, "errors": len(errors)}
    finally:
        chrome.quit()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--shape", default="ears")
    parser.add_argument("--spheres", type=int, default=3000)
    parser.add_argument("--keep", type=Path, help="folder for pack, run and report, taken up again if they are there")
    parser.add_argument("--judge", action="store_true", help="judge every step, as palmar report does")
    asked = parser.parse_args()
    if not (CHROMIUM and DRIVER):
        sys.exit(ABSENT)
    with tempfile.TemporaryDirectory(prefix="palmar-page-") as place:
        folder = asked.keep or Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        told: dict[str, float] = {}
        began = time.perf_counter()
        if not (folder / "long.run.mcap").is_file():
            make_run(folder, asked.shape, asked.spheres, asked.minutes)
            told["replay_s"] = time.perf_counter() - began
        if not (folder / "report" / "index.html").is_file():
            began = time.perf_counter()
            if asked.judge:
                write_report([(folder / "long.run.mcap", folder / "long.pack")], folder / "report")
            else:
                write_unjudged(folder, asked.shape)
            told["report_s"] = time.perf_counter() - began
        page = folder / "report" / "index.html"
        told |= {"page_mb": page.stat().st_size / 1e6, "run_mb": (folder / "long.run.mcap").stat().st_size / 1e6}
        told |= measure_page(page, Path(place) / "profile")
        print(json.dumps({name: round(value, 3) for name, value in told.items()}, indent=1))


if __name__ == "__main__":
    main()
