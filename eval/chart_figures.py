"""The chart as figures for print: two IEEE columns wide, as PDF, SVG and PNG, in the style of the reports' figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from palmar.eval.chart import Dot, pareto
from palmar.eval.chart_page import PANELS
from palmar.eval.figures import COLOURS, METADATA, STYLE

PAGE_WIDTH_IN = 7.16  # both columns of an IEEE journal
STACK = (("detection_us", "detection", 1.0), ("response_us", "response", 0.6), ("rest_us", "rest", 0.25))


def write_figures(
    found: Sequence[Dot],
    contacts: dict[str, list[dict[str, float]]],
    fingers: Sequence[dict[str, Any]],
    product: str,
    folder: Path,
) -> None:
    """Draw `chart` and `cost` into a folder. Equal input gives equal bytes."""
    solvers = sorted({dot.solver for dot in found}, key=lambda name: name != product)
    colours = {solver: COLOURS[k % len(COLOURS)] for k, solver in enumerate(solvers)}
    with rc_context({**STYLE, "axes.grid.which": "major"}):
        for name, figure in (
            ("chart", _scatter(found, colours, product)),
            ("cost", _costs(found, contacts, fingers, colours)),
        ):
            for kind, metadata in METADATA.items():
                figure.savefig(folder / f"{name}.{kind}", metadata=metadata)


def _scatter(found: Sequence[Dot], colours: dict[str, str], product: str) -> Figure:
    panels = [panel for panel in PANELS if any(dot.numbers[panel[0]] is not None for dot in found)]
    rows = (len(panels) + 1) // 2
    figure = Figure(figsize=(PAGE_WIDTH_IN, 0.3 + 2.5 * rows))
    FigureCanvasAgg(figure)
    levels = sorted({dot.level for dot in found})
    for k, (number, title, axis_name, least, hold) in enumerate(panels):
        axis = figure.add_subplot(rows, 2, k + 1)
        axis.set_xscale("log")
        axis.set_yscale("symlog", linthresh=least, linscale=0.4)
        front = [(dot.cost_us["p99"], dot.numbers[number]) for dot in pareto(found, number)]
        if front:
            axis.step(
                *zip(*front, strict=True), where="post", color="0.8", linewidth=4, zorder=1, solid_capstyle="round"
            )
        for solver, colour in colours.items():
            of = [dot for dot in found if dot.solver == solver and dot.numbers[number] is not None]
            plain = sorted((dot for dot in of if not dot.quality), key=lambda dot: dot.level)
            width = 1.4 if solver == product else 0.6
            axis.plot(*_places(plain, number), color=colour, linewidth=width, zorder=2, label=solver)
            for dot in of:
                size = 2.6 + 1.0 * levels.index(dot.level)
                fill = "white" if dot.failed else colour
                place, marker = _places([dot], number), "D" if dot.quality else "o"
                axis.plot(*place, marker, color=colour, markerfacecolor=fill, markersize=size, zorder=3)
                if dot.failed:
                    axis.annotate(
                        f"{dot.failed:,}", (place[0][0], place[1][0]), (3, 2), textcoords="offset points", fontsize=5.5
                    )
        axis.axhline(hold, color="0.4", linewidth=0.6, linestyle="--")
        for limit_us in (100, 1000):
            axis.axvline(limit_us, color="0.4", linewidth=0.6, linestyle="--")
        axis.set_ylim(bottom=-0.15 * least)
        axis.set_xlim(right=max(1200.0, axis.get_xlim()[1]))
        _plain_ticks(axis)
        axis.set_xlabel("step, p99 of least CPU times, µs")
        axis.set_ylabel(axis_name)
        axis.set_title(title, fontsize=8)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=len(labels), loc="upper center", frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.25 / figure.get_figheight()))
    return figure


def _places(dots: Sequence[Dot], number: str) -> tuple[list[float], list[Any]]:
    return [dot.cost_us["p99"] for dot in dots], [dot.numbers[number] for dot in dots]


def _plain_ticks(axis: Axes) -> None:
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_locator(NullLocator())


def _costs(
    found: Sequence[Dot],
    contacts: dict[str, list[dict[str, float]]],
    fingers: Sequence[dict[str, Any]],
    colours: dict[str, str],
) -> Figure:
    count = 3 if fingers else 2
    figure = Figure(figsize=(PAGE_WIDTH_IN, 2.5))
    FigureCanvasAgg(figure)
    against = [figure.add_subplot(1, count, k + 1) for k in range(2)]
    for solver, colour in colours.items():
        rows = contacts.get(solver, [])
        plain = sorted((dot for dot in found if dot.solver == solver and not dot.quality), key=lambda dot: dot.spheres)
        for stat, style in (("p50", "-"), ("p99", ":")):
            label = solver if stat == "p50" else None
            against[0].plot(
                [row["contacts"] for row in rows], [row[stat] for row in rows], style, color=colour, label=label
            )
            marker = "o" if stat == "p50" else ""
            line = [dot.spheres for dot in plain], [dot.cost_us[stat] for dot in plain]
            against[1].plot(*line, style, marker=marker, markersize=2.5, color=colour)
    for axis, name in zip(against, ("contacts handled", "spheres of the level"), strict=True):
        axis.set_xscale("log")
        axis.set_yscale("log")
        _plain_ticks(axis)
        axis.set_xlabel(name)
        axis.set_ylabel("step, µs (full p50, dotted p99)")
    if fingers:
        _bars(figure.add_subplot(1, count, 3), fingers, colours)
    handles, labels = against[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=len(labels), loc="upper center", frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.9))
    return figure


def _bars(axis: Axes, fingers: Sequence[dict[str, Any]], colours: dict[str, str]) -> None:
    groups = list(dict.fromkeys(row["in_use"] for row in fingers))
    width = 0.8 / len(colours)
    for row in fingers:
        x = groups.index(row["in_use"]) + (list(colours).index(row["solver"]) - len(colours) / 2 + 0.5) * width
        rest = max(0.0, row["total_us"] - row["detection_us"] - row["response_us"])
        base = 0.0
        for name, _, alpha in STACK:
            part = rest if name == "rest_us" else row[name]
            axis.bar(x, part, width * 0.92, base, color=colours[row["solver"]], alpha=alpha, linewidth=0)
            base += part
        axis.annotate(f"{row['contacts']:.0f}", (x, base), ha="center", va="bottom", fontsize=4.5)
    axis.set_xticks(range(len(groups)), [name.replace(" ", "\n") for name in groups])
    axis.set_ylabel("step, mean, µs (dark to light: " + ", ".join(name for _, name, _ in STACK) + ")", fontsize=6)
