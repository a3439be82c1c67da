"""The cover report as one HTML page that needs nothing else: a table side by side, pictures, worst places."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from string import Template
from typing import Any

TEMPLATE = Path(__file__).parent / "template" / "cover.html"
# Group, row, path to the number in a cover, what it says.
_FIGURES = (
    ("", "spheres", "spheres", ""),
    ("", "balanced p99, mm", "balanced_p99_mm", "mean of both p99: the number to compare by"),
    ("Protrusion, mm", "p50", "protrusion_mm p50", "a finger hovers by this much"),
    ("Protrusion, mm", "p99", "protrusion_mm p99", ""),
    ("Protrusion, mm", "max", "protrusion_mm max", "largest of the samples"),
    ("Gap, mm", "p50", "gap_mm p50", "a finger sinks in by this much"),
    ("Gap, mm", "p99", "gap_mm p99", ""),
    ("Gap, mm", "max", "gap_mm max", "largest of the samples"),
    ("Normals, a 2 mm ball, degrees", "p50", "normal_deg p50", ""),
    ("Normals, a 2 mm ball, degrees", "p95", "normal_deg p95", ""),
    ("What a fingertip feels", "offset p50, mm", "felt offset_mm p50", "from where it should rest, either way"),
    ("What a fingertip feels", "offset p95, mm", "felt offset_mm p95", ""),
    ("What a fingertip feels", "offset p99, mm", "felt offset_mm p99", ""),
    ("What a fingertip feels", "held off p99, mm", "felt held_off_mm", "by spheres that stick out"),
    ("What a fingertip feels", "let in p99, mm", "felt let_in_mm", "where spheres are missing"),
    ("What a fingertip feels", "normal p50, degrees", "felt normal_deg p50", ""),
    ("What a fingertip feels", "normal p95, degrees", "felt normal_deg p95", ""),
    ("What a fingertip feels", "normal p99, degrees", "felt normal_deg p99", ""),
    (
        "What a fingertip feels",
        "inside, share",
        "felt inside_share",
        "of its places, in a hole of the union; left out above",
    ),
    ("Volume", "union / mesh", "volume ratio", "1: right as a whole, not everywhere"),
    ("Tree", "levels", "tree levels", ""),
    (
        "Tree",
        "not contained",
        "tree not_contained",
        "spheres and balls that reach out of the ball above: contacts that a search loses",
    ),
    ("Tree", "not contained, float32", "tree not_contained_float32", "the same in the precision of a fast search"),
    ("Tree", "farthest out, mm", "tree farthest_out_mm", ""),
    (
        "Dual bound",
        "least spheres",
        "dual_bound least_spheres",
        "no choice with one common excess does with fewer, at its balanced p99",
    ),
    ("Dual bound", "spheres / least", "dual_bound ratio", ""),
)
_COUNTED = {"spheres", "volume ratio", "tree levels", "dual_bound least_spheres"}  # no best among them
_MUST_BE_0 = {"tree not_contained", "tree not_contained_float32", "tree farthest_out_mm"}


def build_page(answer: dict[str, Any], folder: Path) -> str:
    """The page for what `write_cover` found; the pictures are read from the folder."""
    mesh, covers = answer["mesh"], answer["covers"]
    title = f"{mesh.get('object', mesh['source'])}: how well spheres stand for it"
    size = " x ".join(f"{side:.1f}" for side in mesh["size_mm"])
    about = f"{mesh['source']}, {mesh['triangles']:,} triangles, {size} mm; positions in mm in the mesh's own frame"
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=escape(title),
        about=escape(about),
        closing=_closing(mesh),
        lead=escape(_lead(covers)),
        figures=_figures(covers),
        note="Bold: the least of a row." if len(covers) > 1 else "",
        pictures="\n".join(_section(cover, folder) for cover in covers),
        channels=escape(", ".join(covers[0]["map_channels"])),
    )


def _lead(covers: list[dict[str, Any]]) -> str:
    first = covers[0]
    said = (
        f"{first['name']}: {first['spheres']:,} spheres. 99 % of its surface is within "
        f"{first['gap_mm']['p99']:.3g} mm below the "
        f"mesh and 99 % of its skin within {first['protrusion_mm']['p99']:.3g} mm above it; a fingertip rests within "
        f"{first['felt']['offset_mm']['p99']:.3g} mm of its place and feels the normal within "
        f"{first['felt']['normal_deg']['p95']:.2g} degrees at 95 % of it."
    )
    for other in covers[1:]:
        ratio = other["balanced_p99_mm"] / max(first["balanced_p99_mm"], 1e-12)
        said += f" {other['name']} ({other['spheres']:,} spheres): {ratio:.3g} times the balanced error."
    return said


def _closing(mesh: dict[str, Any]) -> str:
    closing = mesh.get("closing")
    if not closing:
        return ""
    moved = closing["moved_mm"]
    rows = [
        f"<tr><td>{label}</td>{''.join(_cell(moved[key][stat]) for stat in ('max', 'p99', 'mean'))}"
        f'<td class="number">{_position(moved[key].get("at_mm"))}</td></tr>'
        for label, key in (
            ("of the mesh from the solid", "mesh_to_solid"),
            ("of the solid from the mesh", "solid_to_mesh"),
        )
    ]
    head = '<th></th><th class="number">max</th><th class="number">p99</th><th class="number">mean</th>'
    head += '<th class="number">the largest is at</th>'
    return (
        f"<h2>The mesh was closed</h2><p>{escape(str(mesh.get('closed', closing['how'])))}</p>"
        f'<div class="scroll"><table><tr>{head}</tr>{"".join(rows)}</table></div>'
        '<p class="note">Distances in mm. What follows is measured against the closed mesh.</p>'
    )


def _figures(covers: list[dict[str, Any]]) -> str:
    head = "".join(f'<th class="number">{escape(cover["name"])}</th>' for cover in covers)
    rows = [f"<tr><th></th>{head}<th></th></tr>"]
    group = ""
    for of, label, path, says in _FIGURES:
        values = [_dig(cover, path) for cover in covers]
        known = [value for value in values if value is not None]
        if not known:
            continue
        if of != group:
            group = of
            rows.append(f'<tr class="group"><th colspan="{len(covers) + 2}">{escape(of)}</th></tr>')
        compared = len(known) > 1 and path not in _COUNTED
        cells = [
            _cell(
                value,
                "wrong" if value and path in _MUST_BE_0 else "least" if compared and value == min(known) else "",
            )
            for value in values
        ]
        rows.append(f'<tr><td>{escape(label)}</td>{"".join(cells)}<td class="says">{escape(says)}</td></tr>')
    return f"<table>{''.join(rows)}</table>"


def _section(cover: dict[str, Any], folder: Path) -> str:
    image = base64.b64encode((folder / cover["picture"]).read_bytes()).decode()
    rows = [
        f'<tr><td class="number">{number}</td><td>{place["kind"]}</td><td>{_what(place)}</td>{_cell(place["max_mm"])}'
        f"{_cell(place['mean_mm'])}{_cell(place['extent_mm'])}{_cell(place['area_mm2'])}"
        f'<td class="number">{_position(place["at_mm"])}</td>'
        f'<td class="number">{_position(place["centre_mm"])}</td></tr>'
        for number, place in enumerate(cover["worst_places"], 1)
    ]
    titles = ("", "", "on", "max, mm", "mean, mm", "extent, mm", "area, mm²", "worst point, mm", "centre, mm")
    head = "".join(f'<th class="{"" if title == "on" else "number"}">{title}</th>' for title in titles)
    table = f'<div class="scroll"><table><tr>{head}</tr>{"".join(rows)}</table></div>' if rows else "<p>None.</p>"
    name = escape(cover["name"])
    return (
        f'<h2>{name}</h2><p><img src="data:image/png;base64,{image}" alt="{name}, from six sides, by error"></p>'
        "<p>The worst places, numbered as in the picture: the worst 2 % of the area for gap and for protrusion, "
        f"the five highest of each.</p>{table}"
        f'<p class="note">Map: <a href="{escape(cover["map"])}">{escape(cover["map"])}</a></p>'
    )


def _what(place: dict[str, Any]) -> str:
    thickness = place["thickness_mm"]
    return escape(place["what"]) + (f", {thickness:.3g} mm" if thickness is not None else "")


def _dig(cover: dict[str, Any], path: str) -> float | None:
    value: Any = cover
    for key in path.split():
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _cell(value: float | None, kind: str = "") -> str:
    text = "-" if value is None else f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
    return f'<td class="number {kind}">{text}</td>'


def _position(at: list[float] | None) -> str:
    return "-" if at is None else ", ".join(f"{x:.1f}" for x in at)
