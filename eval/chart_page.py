"""The chart as one HTML page that needs nothing else: its numbers as JSON, drawn as SVG by its script."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

from palmar.eval.chart import DEEP_MM, FAILURES, NUMBERS, Dot, pareto
from palmar.eval.texts import fill, read

# Number, what it is, axis, the lowest power of ten drawn: below it is the lane that holds zero, and a line to hold.
PANELS = (
    ("penetration_spheres_mm", "Into the spheres", "deepest inside the spheres, mm", 1e-4, 0.1),
    ("penetration_mesh_mm", "Into the true mesh", "deepest inside the true mesh, mm", 1e-3, 0.1),
    ("hover_mm", "Hover", "gap to the true mesh in contact, p99, mm", 1e-3, 0.1),
    ("force_above_20hz_n", "Force ripple", "fingertip force above 20 Hz in slides, rms, N", 1e-3, 0.1),
)
FAILED_HOW = {
    "wrong_side": "on the wrong side of the surface",
    "kept_previous": "kept the pose of the step before",
    "deep": f"more than {DEEP_MM:g} mm inside the spheres",
}


def build_page(
    found: Sequence[Dot],
    contacts: dict[str, list[dict[str, float]]],
    fingers: Sequence[dict[str, Any]],
    *,
    product: str,
    sentence: str,
    note: str,
    about: dict[str, Any],
) -> str:
    """The whole page as text. note: of a noisy machine, or ""; about: name -> what else to say of the measurement."""
    shown = [panel for panel in PANELS if any(dot.numbers[panel[0]] is not None for dot in found)]
    content = {
        "product": product,
        "dots": [told(dot) for dot in found],
        "panels": [
            {
                "number": number,
                "title": title,
                "axis": axis,
                "least": least,
                "hold": hold,
                "pareto": [found.index(dot) for dot in pareto(found, number)],
            }
            for number, title, axis, least, hold in shown
        ],
        "contacts": contacts,
        "fingers": list(fingers),
    }
    return fill(
        "chart.html",
        css=read("page.css") + read("chart.css"),
        sentence=escape(sentence[:1].upper() + sentence[1:]),
        note=f'<p class="verdict fail">{escape(note)} Compare the solvers with each other, not with another day.</p>'
        if note
        else "",
        table=_table(found, product),
        about="".join(f"<tr><th>{escape(name)}</th><td>{escape(str(text))}</td></tr>" for name, text in about.items()),
        fingers="" if fingers else "hidden",
        content=json.dumps(content).replace("</", "<\\/"),
        script=read("chart.js"),
    )


def told(dot: Dot) -> dict[str, Any]:
    """A dot for the script and for chart.json."""
    return {
        "solver": dot.solver,
        "level": dot.level,
        "quality": dot.quality,
        "spheres": dot.spheres,
        "traces": dot.traces,
        "steps": dot.steps,
        "failed": dot.failed,
        "failures": {FAILED_HOW[name]: dot.failures[name] for name in FAILURES if dot.failures[name]},
        "not_converged": dot.not_converged,
        "cost_us": dot.cost_us,
        "tail_us": dot.tail_us,
        "wall_us": dot.wall_us,
        "numbers": {name: dot.numbers[name] for name in NUMBERS},
    }


def _table(found: Sequence[Dot], product: str) -> str:
    rows = []
    for dot in sorted(found, key=lambda dot: (dot.level, dot.solver != product, dot.solver, dot.quality)):
        name = f"<b>{escape(dot.solver)}</b>" if dot.solver == product else escape(dot.solver)
        cells = [
            f'<td class="name">{name} <span class="facts">{escape(dot.quality)}</span></td>',
            _number(f"{dot.spheres:,}"),
            *(_number(f"{dot.cost_us[stat]:.1f}") for stat in ("p50", "p99")),
            *(_number(f"{dot.tail_us[stat]:.0f}") for stat in ("p99", "p99.9", "max")),
            *(_number("&ndash;" if dot.numbers[name] is None else f"{dot.numbers[name]:.3g}") for name in NUMBERS),
            f'<td class="number{" fail" if dot.failed else ""}">{dot.failed:,}</td>',
            _number(f"{dot.steps:,}"),
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    return "\n".join(rows)


def _number(text: str) -> str:
    return f'<td class="number">{text}</td>'
