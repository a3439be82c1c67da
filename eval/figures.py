"""The paper's figures of one run at IEEE column width, as PDF, SVG and PNG, with the numbers behind them as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from palmar.eval.panels import Panel

COLUMN_WIDTH_IN = 3.5  # one column of an IEEE journal
PANEL_IN, LEGEND_IN, BOTTOM_IN = 1.2, 0.24, 0.36
# Okabe and Ito's colours: told apart by colour-blind readers and in print.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
STYLE: Any = {  # keyed by rcParams names
    "font.family": "STIXGeneral",  # shipped with matplotlib, so the files are the same on every machine
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.linewidth": 0.3,
    "grid.color": "0.85",
    "lines.linewidth": 0.8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.hashsalt": "palmar",
    "savefig.dpi": 300,
}
# Panels that share a figure, as in the paper: step time under the forces.
FIGURES = {
    "forces": ("fingertip_force", "step_time"),
    "components": ("force_components",),
    "contacts": ("contacts",),
    "offset": ("palm_offset", "penetration"),
}
METADATA = {
    "pdf": {"CreationDate": None, "Creator": "palmar", "Producer": "matplotlib"},
    "svg": {"Date": None, "Creator": "palmar"},
    "png": {"Software": "palmar"},
}


def write_figures(name: str, charts: list[Panel], folder: Path) -> Iterator[Path]:
    """Draw every figure of a run into `folder`; yields the path of each file written. Equal input gives equal bytes."""
    by_key = {chart.key: chart for chart in charts}
    for figure_name, keys in FIGURES.items():
        drawn = [by_key[key] for key in keys if key in by_key]
        if not drawn:
            continue
        with rc_context(STYLE):
            figure = draw(drawn)
            for kind, metadata in METADATA.items():
                path = folder / f"{name}-{figure_name}.{kind}"
                figure.savefig(path, metadata=metadata)
                yield path
        for chart in drawn:
            path = folder / f"{name}-{chart.key}.csv"
            write_csv(path, chart)
            yield path


def draw(charts: list[Panel]) -> Figure:
    """Panels above each other over one time axis."""
    rows = len(charts)
    height = BOTTOM_IN + rows * (PANEL_IN + LEGEND_IN)
    figure = Figure(figsize=(COLUMN_WIDTH_IN, height))
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(rows, 1, sharex=True))
    # The same margins everywhere, so that figures set above each other line up in time.
    figure.subplots_adjust(0.135, BOTTOM_IN / height, 0.985, 1 - LEGEND_IN / height, hspace=LEGEND_IN / PANEL_IN)
    figure.align_ylabels(axes)
    for axis, chart in zip(axes, charts, strict=True):
        shown = {name: line for name, line in chart.lines.items() if name not in chart.hidden}
        for colour, (name, line) in zip(COLOURS, shown.items(), strict=False):
            step = {"drawstyle": "steps-post"} if chart.key == "contacts" else {}
            axis.plot(chart.time_s, line, color=colour, label=name, **step)
        axis.set_ylabel(chart.axis)
        axis.margins(x=0)
        # A curve that is zero all the way keeps its zero in sight.
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, 0.0), high if high > 0 else 1.0)
        if len(shown) > 1:
            axis.legend(
                loc="lower right",
                bbox_to_anchor=(1, 1),
                ncols=len(shown),
                borderaxespad=0.1,
                columnspacing=1.0,
                handlelength=1.4,
                handletextpad=0.4,
            )
    axes[-1].set_xlabel("time, s")
    return figure


def write_csv(path: Path, chart: Panel) -> None:
    """The plotted points: time and every line of the panel, with units in the header."""
    unit = chart.axis.rpartition(", ")[2] if ", " in chart.axis else ""
    names = [f"{name.replace(' ', '_')}{'_' + unit.lower() if unit else ''}" for name in chart.lines]
    table = np.column_stack([chart.time_s, *chart.lines.values()])
    with path.open("w", newline="\n") as out:
        np.savetxt(out, table, fmt="%.9g", delimiter=",", header=",".join(["time_s", *names]), comments="")
