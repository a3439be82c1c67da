"""Run against run as one HTML page: what differs and where, both hands in one view, and both runs in every chart."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.page import force_mm_per_n, libraries, number_text, table, timing_line, unit_text, verdict_line
from palmar.eval.panels import Panel, thin
from palmar.eval.texts import fill, read
from palmar.eval.view3d import frame_steps, hand_shape, object_shape, pack_array, poses
from palmar.model import AssetPack
from palmar.records import Run

Array = NDArray[np.float64]

DEPTHS = ("penetration_spheres", "penetration_mesh")


def build_page(
    answer: dict[str, Any], runs: Sequence[Run], packs: Sequence[AssetPack], series: Sequence[dict[str, Array]]
) -> str:
    """The page of what `compare_files` found of two runs. The view shows the first's hand, and the second's in blue."""
    a, b = runs
    n = min(len(a.time_s), len(b.time_s))
    first = answer["first_step"]
    places = {name: row["step"] for name, row in answer["largest"].items() if row["value"] > 0}
    begin = min(first if first is not None else 0, n - 1)
    steps = frame_steps(_cut(a, n), [begin, *places.values()])
    name, level = a.header.get("object", ""), int(a.header.get("level", -1))
    names = [Path(path).name for path in answer["runs"]]
    told = [_panel(*each, a.time_s[:n]) for each in _lines(a, b, n, series)]
    of_a, of_b = poses(a, steps), poses(b, steps)
    content = {
        "hands": {"a": hand_shape(packs[0].hand)},
        "objects": {"a": object_shape(packs[0].objects[name], level)},
        "runs": [
            {
                "hand": "a",
                "object": "a",
                "time_s": pack_array(a.time_s[steps]),
                "steps": pack_array(steps),
                "poses": of_a | {"haptic": of_b["graphic"]},
                "force_mm_per_n": force_mm_per_n(a),
                "first": int(np.searchsorted(steps, begin)),
                "phases": a.phases,
                "panels": told,
                "readouts": [
                    {"key": key, "digits": 4, "values": pack_array(apart[steps])} for key, _, apart in _apart(a, b, n)
                ],
            }
        ],
    }
    buttons = {"first differing step": begin} if first is not None else {}
    buttons |= {f"largest difference, {name}": step for name, step in places.items()}
    section = fill(
        "run.html",
        number=0,
        heading="",
        graphic="run a",
        haptic="run b",
        force_scale=f"{force_mm_per_n(a):g}",
        verdict=verdict_line(answer["equal"], _sentence(answer)),
        facts=f"a: {escape(names[0])} · b: {escape(names[1])}. Forces and contacts in the view are those of a.",
        last_frame=len(steps) - 1,
        sphere_count=f"{len(packs[0].objects[name].levels[level]):,}",
        worst="".join(
            f'<button type="button" data-step="{step}">{escape(text)}</button>' for text, step in buttons.items()
        ),
        readouts="".join(
            f'<div><dt>{escape(label)}</dt><dd><span data-key="{key}">&ndash;</span></dd></div>'
            for key, label, _ in _apart(a, b, n)
        ),
        below=_tables(answer, runs),
    )
    return fill(
        "page.html",
        title="Run against run",
        css=read("page.css"),
        lead="",
        overview="",
        sections=section,
        limits=read("limits.html"),
        content=json.dumps(content).replace("</", "<\\/"),
        **libraries(),
    )


def _cut(run: Run, n: int) -> Run:
    return replace(run, time_s=run.time_s[:n])


def _sentence(answer: dict[str, Any]) -> str:
    if answer["equal"]:
        return "The same poses, forces and status in every step, bit for bit."
    at = "" if answer["first_time_s"] is None else f" ({answer['first_time_s']:.4g} s)"
    asked = answer["first_asked"]
    cause = "both were asked the same" if asked is None else f"hand or object asked for differ from step {asked} on"
    palm, force = (answer["largest"][name] for name in ("palm", "fingertip force"))
    return (
        f"They part at step {answer['first_step']}{at}; {cause}. At the most the palms are {palm['value']:.3g} mm "
        "apart and "
        f"a fingertip's forces {force['value']:.3g} N."
    )


def _apart(a: Run, b: Run, n: int) -> list[tuple[str, str, Array]]:
    """What the numbers beside the view say of each step."""
    palm = 1e3 * np.linalg.norm(a.palm_position_m[:n] - b.palm_position_m[:n], axis=1)
    flexion = np.degrees(np.abs(a.flexion_rad[:n] - b.flexion_rad[:n]).reshape(n, 15).max(axis=1))
    force = np.linalg.norm(a.fingertip_force_n[:n] - b.fingertip_force_n[:n], axis=2).max(axis=1)
    return [
        ("palm", "palms apart, mm", palm),
        ("flexion", "joints apart, degrees", flexion),
        ("force", "forces apart, N", force),
    ]


def _lines(a: Run, b: Run, n: int, series: Sequence[dict[str, Array]]) -> list[tuple[str, str, str, dict[str, Array]]]:
    """Key, title, axis and lines of each chart."""
    force = [np.linalg.norm(run.fingertip_force_n[:n], axis=2).max(axis=1) for run in (a, b)]
    offset = [1e3 * np.linalg.norm(run.palm_position_m[:n] - run.haptic_palm_position_m[:n], axis=1) for run in (a, b)]
    palm, flexion, forces = (values for _, _, values in _apart(a, b, n))
    found: list[tuple[str, str, str, dict[str, Array]]] = [
        ("fingertip_force", "Strongest fingertip force", "force, N", dict(zip("ab", force, strict=True))),
        ("apart_force", "Forces apart", "difference, N", {"largest of five": forces}),
        ("apart_palm", "Palms apart", "difference, mm", {"palm": palm}),
        ("apart_flexion", "Joints apart", "difference, degrees", {"largest of fifteen": flexion}),
        ("palm_offset", "Palm offset", "offset, mm", dict(zip("ab", offset, strict=True))),
        ("step_time", "Step time", "time of a step, ms", {"a": 1e-3 * a.cpu_us[:n], "b": 1e-3 * b.cpu_us[:n]}),
    ]
    depth = {
        f"{letter}, {metric.removeprefix('penetration_')}": each[metric][:n]
        for letter, each in zip("ab", series, strict=True)
        for metric in DEPTHS
        if metric in each
    }
    if depth:
        found.append(("penetration", "Penetration", "depth, mm", depth))
    return found


def _panel(key: str, title: str, axis: str, lines: dict[str, Array], time: Array) -> dict[str, Any]:
    panel = thin(Panel(key, title, axis, time, lines))
    return {
        "key": key,
        "title": title,
        "axis": axis,
        "unit": axis.rpartition(", ")[2],
        "time_s": pack_array(panel.time_s),
        "lines": {name: pack_array(line) for name, line in panel.lines.items()},
        "hidden": [],
    }


def _tables(answer: dict[str, Any], runs: Sequence[Run]) -> str:
    """Largest differences, status, metrics, how far times are to be trusted, what of settings and packs differs."""
    largest = [
        f"<td>{escape(name)}</td>{_number(row['value'])}<td>{unit_text(row['unit'])}</td>{_number(row['step'])}"
        for name, row in answer["largest"].items()
    ]
    status = [
        f"<td>{escape(name)}</td>{_number(both[0])}{_number(both[1])}"
        for name, both in answer["status"].items()
        if any(both)
    ]
    metrics = []
    for row in answer["metrics"] or []:
        one, other = row["values"]
        mark = "" if one == other else ' class="differs"'
        metrics.append(
            f"<td{mark}>{escape(row['metric'])} {escape(row['stat'])}</td>{_number(one)}{_number(other)}"
            f"<td>{unit_text(row['unit'])}</td>"
        )
    header = [
        f'<td>{escape(name)}</td><td class="hash">{escape(str(old))}</td><td class="hash">{escape(str(new))}</td>'
        for name, (old, new) in answer["header"].items()
    ] + [f'<td>pack</td><td colspan="2">{escape(line)}</td>' for line in answer["packs"]]
    number = '<th class="number">'
    parts = [
        "<h3>Largest differences</h3>",
        table("plain", f"<th>of</th>{number}value</th><th>unit</th>{number}at step</th>", largest),
        "<h3>Hard steps</h3>" if status else "",
        table("plain", f"<th>status</th>{number}steps of a</th>{number}of b</th>", status) if status else "",
        "<h3>Metrics</h3>",
        f'<p class="note">a: {timing_line(runs[0])} b: {timing_line(runs[1])}</p>',
        table("plain", f"<th>metric</th>{number}a</th>{number}b</th><th>unit</th>", metrics),
        "<h3>What of settings, files, build and machine differs</h3>",
        table("settings", "<th></th><th>a</th><th>b</th>", header) if header else "<p>Nothing.</p>",
    ]
    return "\n".join(parts)


def _number(value: float | None) -> str:
    return f'<td class="number">{number_text(value)}</td>'
