"""The stability suite as a matrix, scenes x solvers: the worst margin of each, and the moment that set it, in 3-D."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.metrics import by_rounding
from palmar.eval.panels import hard_steps
from palmar.eval.texts import fill, read
from palmar.eval.view3d import hand_shape, object_shape, pack_array, poses, three_js
from palmar.model import AssetPack, SphereTree
from palmar.records import Run

Array = NDArray[np.float64]

AROUND = 100  # steps on either side of the worst one, each a frame
OVERVIEW = 80  # frames of the rest of the run
MOST_SPHERES = 20_000  # of an object; of more every second one, or third, and so on
MINUS = "\u2212"
DEEPEST_DB = 60.0  # margins below minus this all have the darkest colour


def moment(
    run: Run, pack: AssetPack, object_name: str, row: dict[str, Any], series: dict[str, Array]
) -> dict[str, Any]:
    """What a cell shows of its worst run: frames around the step that set `row`, and some of the rest."""
    worst = worst_step(run, row["metric"], series)
    n = len(run.time_s)
    even = np.round(np.linspace(0, n - 1, min(OVERVIEW, n))).astype(np.int64)
    steps = np.unique(np.concatenate([even, np.arange(max(0, worst - AROUND), min(n, worst + AROUND + 1))]))
    tree, level = pack.objects[object_name], int(run.header.get("level", -1))
    seen = object_shape(_thinned(tree, level), -1)
    force = np.linalg.norm(run.fingertip_force_n, axis=2).max(axis=1)
    values = series.get(row["metric"])
    return {
        "object": hashlib.sha256(json.dumps(seen, sort_keys=True).encode()).hexdigest()[:16],
        "object_shape": seen,
        "hand": hand_shape(pack.hand),
        "first": int(np.searchsorted(steps, worst)),
        "steps": pack_array(steps),
        "time_s": pack_array(run.time_s[steps]),
        "poses": poses(run, steps),
        "force_mm_per_n": max((mm for mm in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0) if mm * force.max() <= 80), default=0.2),
        "metric": row["metric"],
        "unit": row["unit"],
        "values": None if values is None else pack_array(np.asarray(values)[steps]),
        "palm_offset_mm": pack_array(
            1e3 * np.linalg.norm(run.palm_position_m - run.haptic_palm_position_m, axis=1)[steps]
        ),
        "force_n": pack_array(force[steps]),
        "contacts": pack_array(run.contacts[steps]),
        "hard": hard_steps(run),
        "count": n,
    }


def worst_step(run: Run, metric: str, series: dict[str, Array]) -> int:
    """The step with the largest value of a metric; of one that has none a step, that of the largest force jump."""
    values = series.get(metric)
    if values is not None and np.isfinite(values).any() and np.nanmax(values) > 0:
        return int(np.nanargmax(values))
    if metric in ("end_offset", "end_force_spread") or len(run.time_s) < 2:
        return len(run.time_s) - 1
    return int(np.argmax(np.linalg.norm(np.diff(run.fingertip_force_n, axis=0), axis=2).max(axis=1))) + 1


def _thinned(tree: SphereTree, level: int) -> SphereTree:
    """The tree with the spheres of the level alone, no more of them than a page can draw; the same for all solvers."""
    spheres = tree.levels[level]
    return replace(tree, levels=[spheres[:: -(-len(spheres) // MOST_SPHERES)]])


def write_matrix(folder: Path, scenes: list[dict[str, Any]], moments: dict[tuple[str, str], dict[str, Any]]) -> Path:
    """Write index.html and, under cells/, what it loads for a cell; returns the page.

    scenes: of `check.json`, each with why; moments: (scene, solver) -> `moment`.
    """
    cells = folder / "cells"
    cells.mkdir(parents=True, exist_ok=True)
    for old in cells.glob("*.js"):
        old.unlink()
    for (scene, solver), shown in moments.items():
        shape, hand = shown["object_shape"], json.dumps(shown["hand"], sort_keys=True)
        hand_name = hashlib.sha256(hand.encode()).hexdigest()[:16]
        _script(cells / f"object-{shown['object']}.js", "shapes", shown["object"], shape)
        _script(cells / f"hand-{hand_name}.js", "shapes", hand_name, shown["hand"])
        kept = {key: value for key, value in shown.items() if key != "object_shape"} | {"hand": hand_name}
        _script(cells / f"{scene}-{solver}.js", "cells", f"{scene}-{solver}", kept)
    page = folder / "index.html"
    page.write_text(build_page(scenes, set(moments)), encoding="utf-8")
    return page


def _script(path: Path, table: str, name: str, content: Any) -> None:
    """A page opened from the disk may load scripts, and nothing else."""
    if not path.exists():
        path.write_text(f"palmar.{table}[{json.dumps(name)}] = {json.dumps(content)};\n", encoding="utf-8")


def build_page(scenes: list[dict[str, Any]], with_moment: set[tuple[str, str]]) -> str:
    """The matrix as HTML. A cell with a moment opens it."""
    solvers = list(dict.fromkeys(scene["solver"] for scene in scenes))
    table = {(scene["scene"], scene["solver"]): scene for scene in scenes}
    names = dict.fromkeys(scene["scene"] for scene in scenes)
    rows = []
    for name in names:
        of = next(scene for scene in scenes if scene["scene"] == name)
        cells = "".join(_cell(table.get((name, solver)), (name, solver) in with_moment) for solver in solvers)
        why = escape(" ".join(of.get("why", "").split()))
        rows.append(f'<tr><th class="id">{escape(of["id"])}</th><th title="{why}">{escape(name)}</th>{cells}</tr>')
    kept = {solver: [scene["passed"] for scene in scenes if scene["solver"] == solver] for solver in solvers}
    nearly = {solver: sum(_by_rounding(scene) for scene in scenes if scene["solver"] == solver) for solver in solvers}
    head = "".join(
        f"<th>{escape(solver)}<small>{sum(kept[solver])} of {len(kept[solver])} hold</small>"
        f"<small>{f'{nearly[solver]} more but for rounding' if nearly[solver] else '&nbsp;'}</small></th>"
        for solver in solvers
    )
    return fill(
        "matrix.html",
        css=read("page.css") + read("matrix.css"),
        head=head,
        rows="\n".join(rows),
        sentence=escape(_sentence(kept)),
        three_js=three_js(),
        script=read("bodies.js") + read("view.js") + read("matrix.js"),
    )


def _sentence(kept: dict[str, list[bool]]) -> str:
    parts = [f"{solver} keeps every limit of {sum(of)} of {len(of)} scenes" for solver, of in kept.items()]
    return "; ".join(parts) + "."


def _by_rounding(scene: dict[str, Any]) -> bool:
    """Whether nothing failed but limits of 0, by rounding alone."""
    return bool(scene["fails"]) and not scene["untouched"] and all(map(by_rounding, scene["fails"].values()))


def _cell(scene: dict[str, Any] | None, opens: bool) -> str:
    if scene is None or scene["worst"] is None:
        return '<td class="none">not measured</td>'
    text, under, colour = _said(scene)
    body = f"{escape(text)}<small>{escape(under)}</small>"
    told = escape("; ".join([f"{name} {row['value']:.4g} {row['unit']}" for name, row in scene["fails"].items()]))
    name = f"{scene['scene']}-{scene['solver']}"
    inner = f'<a href="#{escape(name)}" title="{told}">{body}</a>' if opens else f"<span>{body}</span>"
    kind = "holds" if scene["passed"] else "fails"
    return f'<td class="{kind}" style="--share:{colour:.2f}">{inner}</td>'


def _said(scene: dict[str, Any]) -> tuple[str, str, float]:
    """Margin and what sets it, and how strong the colour is, 0 to 1."""
    worst, margin = scene["worst"], scene["margin_db"]
    metric = worst["metric"]
    if scene["untouched"]:
        return "no contact", f"in {len(scene['untouched'])} cases", 1.0
    if margin is not None:
        share = min(1.0, abs(margin) / (DEEPEST_DB if margin < 0 else 40.0))
        return f"{margin:+.1f} dB".replace("-", MINUS), metric, share
    if worst["value"] > (worst["limit"] or 0.0):
        unit = "" if worst["unit"] == "1" else f" {worst['unit']}"
        return f"{MINUS}∞ dB", f"{metric} {worst['value']:.2g}{unit}", 0.1 if _by_rounding(scene) else 1.0
    return "all 0", "limits of 0 kept", 1.0
