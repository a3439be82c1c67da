"""The page of `palmar tune`: what each reduction saved and cost, what is kept of the object, where the promise ends."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.texts import fill, read
from palmar.model import SphereTree

Array = NDArray[np.float64]

# Quantity of a stage, its title, its unit.
BARS = (
    ("spheres", "Spheres", ""),
    ("bytes", "Pack, kB", "kB"),
    ("cost_p50", "Step, p50", "us"),
    ("cost_p99", "Step, p99", "us"),
)
TIMES = ("cost_p50", "cost_p99", "p99", "p99.9", "max")
MOST_DRAWN = 60_000  # samples of what was seen


def build_page(
    answer: dict[str, Any], tree: SphereTree, leaves: Array, points: Array, reached: NDArray[np.bool_]
) -> str:
    """The whole page as text. answer: as in tune.json; leaves (n, 4): the lean ones; points (m, 3) of the surface."""
    stages = answer["stages"]
    held = [row for row in answer["limits"] if row["allowed"] is not None]
    seen = points[reached][:: 1 + int(reached.sum()) // MOST_DRAWN]
    content = {
        "full": _floats(tree.leaves),
        "lean": _floats(leaves),
        "seen": _floats(seen),
        "guard_m": answer["guard_mm"] / 1e3,
    }
    return fill(
        "tune.html",
        css=read("page.css") + read("tune.css"),
        object=escape(answer["object"]),
        verdict="pass" if answer["pack"] else "fail",
        sentence=escape(answer["sentence"]),
        promise="".join(f"<li>{escape(text)}</li>" for text in answer["promise"]),
        note=f'<p class="verdict fail">{escape(answer["note"])} Compare the stages with each other alone.</p>'
        if answer["note"]
        else "",
        bars="".join(_bars(stages, *bar) for bar in BARS),
        stages=_stages(stages),
        limit_heads="".join(f'<th class="number">{escape(stage["name"])}</th>' for stage in stages),
        limits="".join(_limit(row, stages) for row in held),
        others="".join(_limit(row, stages) for row in answer["limits"] if row["allowed"] is None),
        margin=f"{answer['margin']:.0%}",
        full_count=f"{stages[0]['spheres']:,}",
        lean_count=f"{stages[-1]['spheres']:,}",
        share=f"{answer['share_seen']:.0%}",
        guard=f"{answer['guard_mm']:g}",
        rest=f"{answer['rest_mm']:.3g}",
        outside_heads="".join(f'<th class="number">{_name(row)}</th>' for row in held),
        outside="".join(_outside(row, held, answer["holdout"]) for row in answer["outside"]),
        outside_limits=_outside_limits(held),
        outside_hidden="" if answer["outside"] else "hidden",
        tried="".join(_tried(row) for row in answer["tried"]),
        about="".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in _about(answer).items()),
        content=json.dumps(content),
        script=read("tune.js"),
    )


def _floats(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _value(stage: dict[str, Any], quantity: str) -> float:
    return float(stage["times_us"][quantity] if quantity.startswith("cost") else stage[quantity])


def _bars(stages: Sequence[dict[str, Any]], quantity: str, title: str, unit: str) -> str:
    """One panel of the waterfall: a bar for each stage, with what it is of the first."""
    values = [_value(stage, quantity) / (1e3 if unit == "kB" else 1) for stage in stages]
    rows = []
    for stage, value in zip(stages, values, strict=True):
        share = value / values[0]
        number = f"{value:,.0f}" if not unit or value >= 100 else f"{value:.1f}"
        rows.append(
            f'<div class="bar"><span class="label">{escape(stage["name"])}</span><span class="track">'
            f'<i style="width:{min(100 * value / max(values), 100):.1f}%"></i></span>'
            f'<span class="value">{number}{" µs" if unit == "us" else ""}</span>'
            f'<span class="share">{share:.0%}</span></div>'
        )
    return f"<figure><h3>{title}</h3>{''.join(rows)}</figure>"


def _stages(stages: Sequence[dict[str, Any]]) -> str:
    rows = []
    for stage in stages:
        cells = [f"{stage['spheres']:,}", f"{stage['bytes']:,}"]
        cells += [f"{stage['times_us'][name]:.1f}" for name in TIMES]
        cells += [f"{stage['operations'][name]:,.0f}" for name in ("mean", "p99", "max")]
        rows.append(
            f'<tr><td class="name"><b>{escape(stage["name"])}</b></td><td>{escape(stage["what"])}</td>'
            + "".join(f'<td class="number">{cell}</td>' for cell in cells)
            + "</tr>"
        )
    return "\n".join(rows)


def _name(row: dict[str, Any]) -> str:
    return escape(row["metric"].replace("_", " "))


def figure(value: float | None) -> str:
    if value is None:
        return "&ndash;"
    return "0" if value == 0 else f"{value:.3g}"


def _limit(row: dict[str, Any], stages: Sequence[dict[str, Any]]) -> str:
    values = [stage["values"][row["metric"]] for stage in stages]
    cells = "".join(map(_number, values))
    used = ""
    if row["allowed"] is not None:
        share = 0.0 if not row["limit"] or values[-1] is None else values[-1] / row["limit"]
        allowed = row["allowed"] / row["limit"] if row["limit"] else 1.0
        used = (
            f'<span class="track room"><i style="width:{min(100 * share, 100):.1f}%"></i>'
            f'<b style="left:{100 * allowed:.1f}%"></b></span>'
        )
    numbers = f"{cells}{_number(row['allowed'])}{_number(row['limit'])}"
    why = f'<span class="facts">{escape(row["why"])}</span>'
    return f'<tr><td class="name">{_name(row)}</td><td>{escape(row["unit"])}</td>{numbers}<td>{used}{why}</td></tr>'


def _number(value: float | None, bad: bool = False) -> str:
    return f'<td class="number{" fail" if bad else ""}">{figure(value)}</td>'


def _outside_limits(held: Sequence[dict[str, Any]]) -> str:
    cells = "".join(_number(row["limit"]) for row in held)
    return f'<tr class="limits"><td class="name">limit</td><td></td><td></td>{cells}</tr>'


def _outside(row: dict[str, Any], held: Sequence[dict[str, Any]], holdout: Sequence[str]) -> str:
    kind = "held out" if f"{row['name']}.mcap" in holdout or row["name"].startswith("all") else "changed"
    names = [limit["metric"] for limit in held]
    cells = [_number(row["values"][name], name in row["broken"]) for name in names]
    beyond = "inside" if row["beyond_mm"] == 0 else f"{row['beyond_mm']:.1f} mm outside"
    lines = "".join(f"<li>{escape(text)}</li>" for text in row["outside"])
    more = f'<tr class="more"><td></td><td colspan="{2 + len(held)}"><ul>{lines}</ul></td></tr>' if lines else ""
    tone = "" if row["beyond_mm"] == 0 else " beyond"
    return (
        f'<tr><td class="name"><b>{escape(row["name"])}</b></td><td class="facts">{kind}</td>'
        f'<td class="name{tone}">{beyond}</td>{"".join(cells)}</tr>{more}'
    )


def _tried(row: dict[str, Any]) -> str:
    broke = "; ".join(
        f"{each['metric'].replace('_', ' ')} {figure(each['value'])}, {figure(each['allowed'])} allowed"
        for each in row["broken"]
    )
    verdict = f"{broke} on {row['trace']}" if broke else row["why"] or "every limit holds"
    settings = ", ".join(f"{key} {value}" for key, value in row["settings"].items())
    return (
        f'<tr><td>{escape(row["what"])}</td><td class="number">{row["spheres"]:,}</td><td>{escape(settings)}</td>'
        f'<td class="{"fail" if broke else "facts" if row["why"] else "pass"}">{escape(verdict)}</td></tr>'
    )


def _about(answer: dict[str, Any]) -> dict[str, str]:
    return {
        "full model": f"{answer['full']['pack']}, sha256 {answer['full']['sha256'][:16]}; {answer['mode']} spheres",
        "tuned on": ", ".join(answer["traces"]),
        "held out": ", ".join(answer["holdout"]) or "none; give some with --holdout",
        "changed": "two of the traces it was tuned on, the first shifted along, or turned about, the x axis of the "
        "world, the second the y axis",
        "numbers": "the worst of all traces, judged without the solver's code on the full model's mesh",
        "differences": "between the lean and the full model's answer to a trace, means over the steps in which the "
        "full one touches and over the traces: of the force on a fingertip or the palm, by the full one's, 2 N at "
        "least; of the place of a fingertip or the palm. In the first column those of another fit of the full model, "
        "as fine, which differs in nothing but where its spheres are; the limits are 7 % and 2 mm beyond",
        "step times": f"CPU time of the steps in which the full model touches; cost: the least of {answer['repeats']} "
        "repeats of each step; tail: all of them as they came. All stages in one run, in an order drawn anew each time",
        "search": f"seed {answer['seed']}; by operations, not by the clock, so that it comes out the same everywhere",
        "machine": ", ".join(f"{key} {value}" for key, value in answer["machine"].items()),
        "build": ", ".join(f"{key} {value}" for key, value in answer["build"].items()),
    }
