"""The report as one HTML page that needs nothing else: texts and tables as HTML, replay and charts by its script."""

from __future__ import annotations

import base64
import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from palmar.eval.explain import MEANING
from palmar.eval.judge import haptic_poses, shape_in_object
from palmar.eval.panels import INPUT_BITS, Judged, hard_steps, panels, worst_steps
from palmar.eval.recompute import TOLERANCE_MM
from palmar.eval.texts import fill, read
from palmar.eval.touch import touch_object
from palmar.eval.view3d import frame_steps, hand_shape, object_shape, pack_array, poses, three_js
from palmar.model import FINGERS
from palmar.records import Run

SCRIPTS = ("bodies.js", "view.js", "charts.js", "page.js")
# Beyond these a run's times say more of the machine than of the solver: waiting by work, p99 by p50 of steps alike.
MOST_WAIT, NOISY_TAIL, LEAST_IDLE = 0.1, 3.0, 100
HAPTIC_STEPS, SURFACE_POINTS = 40, 4000  # looked at for how deep the haptic hand goes
# Columns of the table over all runs: metric, stat.
OVERVIEW = (
    ("penetration_spheres", "max"),
    ("penetration_mesh", "max"),
    ("hover", "p99"),
    ("palm_offset", "p99"),
    ("cost_excess", "mean"),
    ("force_variation", "mean"),
    ("force_variation_ratio", "mean"),
    ("excess_force_step", "max"),
    ("joint_step_excess", "max"),
    ("step_cpu", "p50"),
    ("step_cpu", "p99"),
)


def build_page(runs: list[Judged], title: str, maps: dict[str, list[Path]] | None = None) -> str:
    """The whole page as text. Runs of the same pack share hand and object shapes. maps: PNGs of runs, by name."""
    content: dict[str, Any] = {"hands": {}, "objects": {}, "runs": []}
    sections = []
    for number, judged in enumerate(runs):
        shown = run_content(judged)
        content["runs"].append(shown)
        if shown["hand"] not in content["hands"]:
            content["hands"][shown["hand"]] = hand_shape(judged.pack.hand)
        if shown["object"] not in content["objects"]:
            tree = judged.pack.objects[judged.object_name]
            content["objects"][shown["object"]] = object_shape(tree, leaf_level(judged))
        heading = f"<h2>{escape(judged.name)}</h2>" if len(runs) > 1 else ""
        sections.append(
            run_section(number, judged, heading, shown["time_s"]["shape"][0] - 1, (maps or {}).get(judged.name, []))
        )
    return fill(
        "page.html",
        title=escape(title),
        css=read("page.css"),
        lead="" if len(runs) == 1 else lead(runs),
        overview="" if len(runs) == 1 else overview_table(runs),
        sections="\n".join(sections),
        limits=read("limits.html"),
        # A closing tag inside a string would end the script element.
        content=json.dumps(content).replace("</", "<\\/"),
        **libraries(),
    )


def libraries() -> dict[str, str]:
    """The scripts that page.html holds: three.js, plotly and our own."""
    ours = "\n".join(read(name) for name in SCRIPTS)
    return {"three_js": three_js(), "plotly_js": get_plotlyjs(), "script": ours}


def leaf_level(judged: Judged) -> int:
    """The level that the run used; the leaves if its header does not say."""
    return int(judged.run.header.get("level", -1))


def force_mm_per_n(run: Run) -> float:
    """Length of a force arrow: the longest of 0.5 to 20 mm a newton that keeps the run's highest force within 80 mm."""
    highest = np.linalg.norm(run.fingertip_force_n, axis=2).max()
    return max((scale for scale in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0) if scale * highest <= 80), default=0.2)


def run_content(judged: Judged) -> dict[str, Any]:
    """What the script needs of one run."""
    run = judged.run
    worst = worst_steps(judged)
    steps = frame_steps(run, [step for step, _ in worst.values()])
    return {
        "hand": judged.pack.sha256,
        "object": f"{judged.pack.sha256}/{judged.object_name}/{leaf_level(judged)}",
        "time_s": pack_array(run.time_s[steps]),
        "steps": pack_array(steps),
        "poses": {**poses(run, steps), **depths(judged, steps)},
        "force_mm_per_n": force_mm_per_n(run),
        "first": int(np.searchsorted(steps, worst["highest force"][0])),  # the moment that the page opens at
        "phases": run.phases,
        "panels": [
            {
                "key": panel.key,
                "title": panel.title,
                "axis": panel.axis,
                "unit": panel.axis.rpartition(", ")[2],
                "time_s": pack_array(panel.time_s),
                "lines": {name: pack_array(line) for name, line in panel.lines.items()},
                "hidden": list(panel.hidden),
            }
            for panel in panels(judged)
        ],
        "readouts": [
            {"key": key, "digits": digits, "values": pack_array(values[steps])}
            for key, _, _, digits, values in readouts(judged)
        ],
    }


def depths(judged: Judged, steps: np.ndarray) -> dict[str, Any]:
    """Depth of each link at the steps, and where the scales of colours end: a round number, mm."""
    if judged.link_depth_mm is None:
        return {}
    run = judged.run
    touching = np.flatnonzero(run.contacts > 0)
    some = touching[np.unique(np.linspace(0, len(touching) - 1, HAPTIC_STEPS).astype(int))] if len(touching) else [0]
    placed = shape_in_object(judged.pack.hand, haptic_poses(run)[np.array(some)], run, np.array(some))
    surface = judged.pack.objects[judged.object_name].vertices_m
    haptic = (
        1e3 * touch_object(placed, surface[:: max(1, len(surface) // SURFACE_POINTS)], np.zeros(len(some)))[0].max()
    )
    ends = {"graphic": round_up(max(0.1, judged.link_depth_mm.max())), "haptic": round_up(max(1.0, haptic))}
    return {"link_depth_mm": pack_array(judged.link_depth_mm[steps]), "depth_end_mm": ends}


def round_up(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * value))


def readouts(judged: Judged) -> list[tuple[str, str, str, int, np.ndarray]]:
    """Numbers beside the 3-D view that follow the slider: key, label, unit, digits, (n,) values."""
    run, series = judged.run, judged.series
    force = np.linalg.norm(run.fingertip_force_n, axis=2)
    offset = 1e3 * np.linalg.norm(run.palm_position_m - run.haptic_palm_position_m, axis=1)
    shown = [(f"force-{name}", f"force {name}", "N", 3, force[:, i]) for i, name in enumerate(FINGERS)]
    shown.append(("contacts", "contacts", "", 0, run.contacts.astype(np.float64)))
    shown.append(("palm-offset", "palm offset", "mm", 3, offset))
    for metric, label in (("penetration_spheres", "into spheres"), ("penetration_mesh", "into mesh")):
        if metric in series:
            shown.append((metric, label, "mm", 4, series[metric]))
    shown.append(("step-cpu", "step, CPU", "µs", 1, run.cpu_us))
    return shown


def run_section(number: int, judged: Judged, heading: str, last_frame: int, maps: list[Path]) -> str:
    """One run: verdict, replay, charts, metrics, settings."""
    worst = "".join(
        f'<button type="button" data-step="{step}">{escape(label)} <small>{escape(note)}</small></button>'
        for label, (step, note) in worst_steps(judged).items()
    )
    numbers = "".join(
        f'<div><dt>{escape(label)}</dt><dd><span data-key="{key}">&ndash;</span> {unit}</dd></div>'
        for key, label, unit, _, _ in readouts(judged)
    )
    tree = judged.pack.objects[judged.object_name]
    below = fill(
        "below.html",
        metrics=metrics_table(judged.rows),
        maps="".join(map_figure(path) for path in maps),
        timing=timing_line(judged.run),
        recomputed=recomputed_line(judged),
        settings=settings_table(judged),
    )
    return fill(
        "run.html",
        number=number,
        heading=heading,
        graphic="graphic hand",
        haptic="haptic hand",
        force_scale=f"{force_mm_per_n(judged.run):g}",
        verdict=verdict_line(judged.passed, judged.verdict),
        facts=facts(judged),
        last_frame=last_frame,
        sphere_count=f"{len(tree.levels[leaf_level(judged)]):,}",
        worst=worst,
        readouts=numbers,
        below=below,
    )


def map_figure(path: Path) -> str:
    image, name = base64.b64encode(path.read_bytes()).decode(), escape(path.stem)
    return (
        f'<figure class="map"><img src="data:image/png;base64,{image}" alt="{name}">'
        f'<figcaption><a href="maps/{name}.exr">maps/{name}.exr</a></figcaption></figure>'
    )


def timing_line(run: Run) -> str:
    """How far the times of the run are to be trusted."""
    cpu, wall = run.cpu_us, run.wall_us
    if not np.isfinite(cpu).any():
        return "The run has no timing."
    kept = np.isfinite(cpu) & np.isfinite(wall)
    waited = max(0.0, float(wall[kept].sum() / max(float(cpu[kept].sum()), 1e-9)) - 1)
    idle = cpu[kept & (run.contacts == 0)]
    said = (
        "Each step was timed once; nothing is left out, the first steps neither. "
        f"The steps waited {waited:.0%} of the time that they worked"
    )
    if len(idle) >= LEAST_IDLE:
        p50, p99 = np.percentile(idle, (50, 99))
        said += f"; those without a contact, alike in work, took {p50:.1f} µs (p50) and {p99:.1f} µs (p99)"
    noisy = waited > MOST_WAIT or (len(idle) >= LEAST_IDLE and p99 > NOISY_TAIL * p50)
    return f"{said}. " + (
        "<b>The machine was noisy</b>: times of this run are an upper bound." if noisy else "The machine was quiet."
    )


def recomputed_line(judged: Judged) -> str:
    """What came of the list of contacts worked out once more."""
    found = judged.recomputed
    if found is None or not found.contacts:
        return "The run lists no contacts, so its list was not recomputed."
    said = (
        f"Recomputed by the judge: the {found.contacts:,} contacts of {found.steps:,} random steps. Their gaps are "
        "as stated to "
        f"{found.gap_mm:.2g} mm, the least gap of a step to {found.least_mm:.2g} mm"
    )
    if found.same:
        return f"{said}."
    return f"{said}: <b>beyond {TOLERANCE_MM:g} mm</b>; {found.unlisted} steps overlap and list nothing."


def facts(judged: Judged) -> str:
    """The line under the verdict: what was replayed, and how many steps were hard."""
    run, tree = judged.run, judged.pack.objects[judged.object_name]
    seconds = float(run.time_s[-1] - run.time_s[0])
    spheres = len(tree.levels[leaf_level(judged)])
    parts = [
        f"{escape(judged.object_name)}: {len(tree.faces):,} triangles, {spheres:,} leaf spheres",
        f"{len(run.time_s):,} steps, {seconds:.2f} s",
        f"solver {escape(run.header.get('solver', 'not stated'))}",
    ]
    hard = hard_steps(run)
    if hard:
        counts = ", ".join(
            f"{count:,} {name}{' (input)' if name in INPUT_BITS else ''}" for name, count in sorted(hard.items())
        )
        parts.append(f"hard steps: {counts}")
    else:
        parts.append("no hard steps")
    if any(run.lost.values()):
        lost = ", ".join(f"{count} {what}" for what, count in run.lost.items() if count)
        parts.append(f"<strong>the run file is damaged, lost: {escape(lost)}</strong>")
    return " · ".join(parts)


def lead(runs: list[Judged]) -> str:
    """The first sentence over several runs."""
    failed = [judged.name for judged in runs if not judged.passed]
    if failed:
        return verdict_line(False, f"Outside a limit: {len(failed)} of {len(runs)} runs, {', '.join(failed)}.")
    return verdict_line(True, f"All {len(runs)} runs are inside every limit.")


def verdict_line(passed: bool, sentence: str) -> str:
    outcome, mark = ("pass", "&check;") if passed else ("fail", "&cross;")
    return f'<p class="verdict {outcome}"><span class="mark">{mark}</span> {escape(sentence)}</p>'


def overview_table(runs: list[Judged]) -> str:
    """Runs against the metrics that matter first."""
    units = {(row["metric"], row["stat"]): row["unit"] for judged in runs for row in judged.rows}
    columns = [key for key in OVERVIEW if key in units]
    head = ["<th>run</th><th>verdict</th>"]
    for metric, stat in columns:
        label = f"{metric.replace('_', ' ')}<br>{stat}, {unit_text(units[metric, stat])}"
        head.append(f'<th class="number" title="{escape(MEANING.get(metric, ""))}">{label}</th>')
    head.append('<th class="number">hard<br>steps</th>')
    body = []
    for number, judged in enumerate(runs):
        by_key = {(row["metric"], row["stat"]): row for row in judged.rows}
        hard = sum(count for name, count in hard_steps(judged.run).items() if name not in INPUT_BITS)
        outcome = "pass" if judged.passed else "fail"
        damaged = " <strong>(file damaged)</strong>" if any(judged.run.lost.values()) else ""
        cells = [
            f'<td class="name"><a href="#run-{number}">{escape(judged.name)}</a>{damaged}</td>',
            f'<td class="{outcome}">{outcome}</td>',
            *(value_cell(by_key.get(key)) for key in columns),
            f'<td class="number">{hard:,}</td>',
        ]
        body.append("".join(cells))
    return table("overview", "".join(head), body)


def metrics_table(rows: list[dict[str, Any]]) -> str:
    """Every metric with value, limit, margin and meaning."""
    head = (
        '<th>metric</th><th>over steps</th><th class="number">value</th><th>unit</th><th class="number">limit</th>'
        '<th class="number" title="20 log10(limit / value); 0 or more passes">margin, dB</th><th>meaning</th>'
    )
    body, previous = [], None
    for row in rows:
        metric, limit = row["metric"], row.get("limit")
        again = metric == previous
        reason = f" <em>Not measured: {escape(row['reason'])}.</em>" if row.get("reason") else ""
        if row.get("reason_limit"):
            reason += (
                f" <em>Limit of the scene{'' if limit is not None else ', none'}: {escape(row['reason_limit'])}.</em>"
            )
        cells = [
            f'<td class="name">{"" if again else escape(metric)}</td>',
            f"<td>{escape(row['stat'])}</td>",
            value_cell(row),
            f"<td>{unit_text(row['unit'])}</td>",
            f'<td class="number">{"" if limit is None else number_text(limit)}</td>',
            f'<td class="number">{margin_text(row["value"], limit, row.get("margin_db"))}</td>',
            f'<td class="meaning">{"" if again else escape(MEANING.get(metric, ""))}{reason}</td>',
        ]
        body.append("".join(cells))
        previous = metric
    return table("metrics", head, body)


def table(kind: str, head: str, rows: list[str]) -> str:
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="wide"><table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def value_cell(row: dict[str, Any] | None) -> str:
    """A table cell, coloured when the row has a limit."""
    if row is None:
        return '<td class="number">&ndash;</td>'
    limit, value = row.get("limit"), row["value"]
    outcome = "" if limit is None else ("pass" if value is not None and value <= limit else "fail")
    return f'<td class="number {outcome}">{number_text(value)}</td>'


def unit_text(unit: str) -> str:
    return "µs" if unit == "us" else escape(unit)


def number_text(value: float | None) -> str:
    """A number to four digits, a count whole; a dash where nothing could be measured. Zero is a number."""
    if value is None or not np.isfinite(value):
        return "&ndash;"
    if value == int(value) and abs(value) < 1e9:
        return f"{int(value):,}"
    text = f"{value:.4g}"
    if "e" in text:
        digits, exponent = text.split("e")
        return f"{digits} &times; 10<sup>{int(exponent)}</sup>".replace("-", "&minus;")
    return text


def margin_text(value: float | None, limit: float | None, margin: float | None) -> str:
    if limit is None or value is None:
        return ""
    if margin is None or not np.isfinite(margin):
        return "&infin;" if value <= limit else "&minus;&infin;"
    return f"{margin:+.1f}".replace("-", "&minus;")


def settings_table(judged: Judged) -> str:
    """The run's header, keys and values, nested JSON spread out; and the declared error of the model."""
    lines = [
        setting_line("run file", judged.sources["run"].name),
        setting_line("pack file", judged.sources["pack"].name),
    ]
    for key, value in sorted(judged.run.header.items()):
        if key == "phases":
            continue
        nested = json_object(value)
        if nested is None:
            lines.append(setting_line(key, value))
        else:
            lines += [setting_line(f"{key} · {name}", entry) for name, entry in sorted(nested.items())]
    return f'<table class="settings"><tbody>{"".join(lines)}</tbody></table>'


def setting_line(key: str, value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return f'<tr><th>{escape(key)}</th><td class="hash">{escape(text)}</td></tr>'


def json_object(text: str) -> dict[str, Any] | None:
    """The object that `text` is as JSON, or None."""
    if not text.startswith("{"):
        return None
    try:
        return json.loads(text)
    except ValueError:
        return None
