"""The paper's figures from runs of ours, at IEEE column width: pictures (Fig. 11, 13), forces (12, 14), cost (15)."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palmar.eval.figures import COLOURS, COLUMN_WIDTH_IN
from palmar.eval.judge import Poses, graphic_poses, haptic_poses
from palmar.eval.picture import HAPTIC, SKIN, Camera, arrows, draw, grasp_camera, hand_body, object_body
from palmar.model import FINGERS, AssetPack
from palmar.records import Run

Array = NDArray[np.float64]

TILE_PIXELS = 300
FORCE_COLOUR = "#c8102e"
ARROW: Any = {
    "arrowstyle": "-|>,head_width=0.09,head_length=0.16",
    "color": FORCE_COLOUR,
    "lw": 0.7,
    "shrinkA": 0,
    "shrinkB": 0,
}
LONGEST_MM = 55.0  # a force arrow
PHALANGES = ("proximal", "middle", "distal")
USED = ("one finger", "two fingers", "five fingers", "whole hand")
PARTS = {"detection_us": "detection", "response_us": "response", "total_us": "whole loop"}
SHORT = {"one finger": "SF", "two fingers": "TF", "five fingers": "FF", "whole hand": "WH"}


@dataclass(frozen=True)
class Replay:
    """One of the paper's experiments: of which figure, on what, what came of it, and the least times of its steps."""

    figure: str
    object: str
    label: str
    pack: AssetPack
    run: Run
    times_us: dict[str, Array]
    numbers: dict[tuple[str, str], float | None]  # (metric, stat) -> value
    series: dict[str, Array]

    def phase(self, *names: str) -> NDArray[np.int64]:
        """Steps of the phases of these names."""
        time = self.run.time_s
        inside = np.zeros(len(time), dtype=bool)
        for phase in self.run.phases:
            if phase["name"] in names:
                inside |= (time >= phase["start_s"]) & (time < phase["end_s"])
        return np.flatnonzero(inside)

    @property
    def force_n(self) -> Array:
        """(n, 5) magnitude of each fingertip's force."""
        return np.linalg.norm(self.run.fingertip_force_n, axis=2)


@dataclass(frozen=True)
class Tile:
    """A picture of one step of a replay."""

    replay: Replay
    step: int
    row: str
    column: str
    note: str = ""  # what it shows, where row and column do not say it


def tile_grid(tiles: Sequence[Tile], rows: Sequence[str], columns: Sequence[str]) -> Figure:
    """Pictures in rows and columns, one scale for the force arrows of all, stated below."""
    side = COLUMN_WIDTH_IN / (len(columns) + 0.12)
    head, foot = 0.16, 0.18
    figure = Figure(figsize=(COLUMN_WIDTH_IN, side * len(rows) + head + foot))
    FigureCanvasAgg(figure)
    height = figure.get_figheight()
    strongest = max((float(tile.replay.force_n[tile.step].max()) for tile in tiles), default=0.0)
    mm_per_n = max((s for s in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if s * strongest <= LONGEST_MM), default=0.2)
    left = 0.12 * side / COLUMN_WIDTH_IN
    for tile in tiles:
        r, c = rows.index(tile.row), columns.index(tile.column)
        box = (left + c * side / COLUMN_WIDTH_IN, (foot + (len(rows) - 1 - r) * side) / height)
        axis = figure.add_axes((*box, side / COLUMN_WIDTH_IN, side / height))
        draw_tile(axis, tile, mm_per_n)
    for c, name in enumerate(columns):
        figure.text(left + (c + 0.5) * side / COLUMN_WIDTH_IN, 1 - 0.12 / height, name, ha="center", fontsize=7)
    for r, name in enumerate(rows):
        middle = (foot + (len(rows) - 0.5 - r) * side) / height
        figure.text(0.012, middle, name, ha="center", va="center", rotation=90, fontsize=7)
    said = f"force on the user: {mm_per_n:g} mm a newton, at the object's scale; blue: haptic hand"
    figure.text(0.5, 0.05 / height, said, ha="center", fontsize=6, color="0.35")
    return figure


def draw_tile(axis: Axes, tile: Tile, mm_per_n: float) -> None:
    """One picture with its force arrows, and a bar of 20 mm."""
    replay, at = tile.replay, np.array([tile.step])
    run, hand, tree = replay.run, replay.pack.hand, replay.pack.objects[replay.object]
    graphic, haptic = (_in_object(run, poses(run)[at], tile.step) for poses in (graphic_poses, haptic_poses))
    camera = grasp_camera(hand, _both(graphic, haptic), tree.vertices_m, upright=bool(tile.note))
    bodies = [object_body(tree.vertices_m, tree.faces), hand_body(hand, graphic, SKIN)]
    image = draw(bodies, hand_body(hand, haptic, HAPTIC), camera, TILE_PIXELS)
    axis.imshow(image, origin="lower", extent=(0, 1, 0, 1), interpolation="antialiased")
    force = run.fingertip_force_n[tile.step] @ _turn(run.object_rotation_wxyz[tile.step])
    for start, end in arrows(hand, graphic, force, camera, mm_per_n):
        axis.annotate("", end, start, arrowprops=ARROW, annotation_clip=False)
    length = _bar(camera)
    axis.plot([0.03, 0.03 + length], [0.03, 0.03], color="0.2", lw=1.0, solid_capstyle="butt")
    axis.text(0.03, 0.97, tile.note, fontsize=6, va="top", color="0.35")
    axis.set_xlim(0, 1)
    axis.set_ylim(0, 1)
    axis.set_axis_off()


def _bar(camera: Camera) -> float:
    return 0.02 / camera.across_m


def _both(a: Poses, b: Poses) -> Poses:
    return Poses(*(np.concatenate([getattr(a, name), getattr(b, name)]) for name in Poses.__dataclass_fields__))


def _turn(wxyz: Array) -> Array:
    """World from object, as a matrix."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _in_object(run: Run, pose: Poses, step: int) -> Poses:
    """The pose in the object's frame of the step."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(np.roll(run.object_rotation_wxyz[step], -1)).inv()
    palm = turn * Rotation.from_quat(np.roll(pose.palm_rotation_wxyz, -1, axis=1))
    position = turn.apply(pose.palm_position_m - run.object_position_m[step])
    return Poses(position, np.roll(palm.as_quat(), 1, axis=1), pose.flexion_rad, pose.abduction_rad)


def tile_rows(tiles: Iterable[Tile]) -> list[dict[str, Any]]:
    """The numbers behind each picture: which step of what, its forces, depths and both poses."""
    rows = []
    for tile in tiles:
        run, i = tile.replay.run, tile.step
        row: dict[str, Any] = {
            "row": tile.row,
            "column": tile.column,
            "object": tile.replay.object,
            "trace": tile.replay.label,
            "step": i,
            "time_s": f"{run.time_s[i]:.6g}",
            "contacts": int(run.contacts[i]),
            "palm_offset_mm": f"{1e3 * np.linalg.norm(run.palm_position_m[i] - run.haptic_palm_position_m[i]):.6g}",
        }
        row |= {
            f"{name}_mm": f"{tile.replay.series[name][i]:.6g}" for name in ("penetration_spheres", "penetration_mesh")
        }
        row |= {f"force_{name}_n": f"{tile.replay.force_n[i, f]:.6g}" for f, name in enumerate(FINGERS)}
        for kind in ("", "haptic_"):
            for name in ("palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad"):
                values = getattr(run, kind + name)[i].ravel()
                row |= {f"{kind or 'graphic_'}{name}_{k}": f"{value:.9g}" for k, value in enumerate(values)}
        rows.append(row)
    return rows


def force_figure(replays: Sequence[Replay], forces: Sequence[dict[str, Array]]) -> Figure:
    """Of each replay its forces, and the time of each step under them, with the states of its trace shaded."""
    panels = [2.0, 1.0] * len(replays)
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 1.5 * len(replays) + 0.55))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(panels), 1, height_ratios=panels, left=0.135, right=0.985, hspace=0.42)
    height = figure.get_figheight()
    grid.update(bottom=0.36 / height, top=1 - 0.32 / height)
    for number, (replay, lines) in enumerate(zip(replays, forces, strict=True)):
        above = figure.add_subplot(grid[2 * number])
        below = figure.add_subplot(grid[2 * number + 1], sharex=above)
        time = replay.run.time_s
        for colour, (name, line) in zip(COLOURS, lines.items(), strict=False):
            above.plot(time, line, color=colour, label=name, linewidth=0.7)
        below.plot(time, 1e-3 * replay.times_us["cpu_us"], color="0.25", linewidth=0.5)
        _shade(replay, (above, below))
        above.set_ylabel("force, N")
        below.set_ylabel("step, ms")
        below.set_ylim(bottom=0)
        above.tick_params(labelbottom=False)
        below.tick_params(labelbottom=number == len(replays) - 1)
        above.margins(x=0)
        if number == 0:
            above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.11), ncols=len(lines), columnspacing=0.9,
                         handlelength=1.1, handletextpad=0.35, borderaxespad=0.0, fontsize=6.5)  # fmt: skip
        above.text(0.008, 0.93, f"({'abcdefgh'[number]}) {replay.object.replace('_', ' ')}", transform=above.transAxes,
                   va="top", fontsize=7)  # fmt: skip
    below.set_xlabel("time, s")
    figure.align_ylabels(figure.axes)
    return figure


def _shade(replay: Replay, axes: Sequence[Axes]) -> None:
    """Every second state grey, with the names above the upper axis."""
    for number, phase in enumerate(replay.run.phases):
        start, end = phase["start_s"], phase["end_s"]
        if number % 2:
            for axis in axes:
                axis.axvspan(start, end, color="0.94", linewidth=0, zorder=0)
        axes[0].text((start + end) / 2, 1.015, phase["name"].replace(" fingers", "").replace(" finger", ""), fontsize=6,
                     color="0.35", ha="center", va="bottom", transform=axes[0].get_xaxis_transform())  # fmt: skip


def finger_forces(replay: Replay) -> dict[str, Array]:
    return {name: replay.force_n[:, f] for f, name in enumerate(FINGERS)}


def index_contact_force(replay: Replay) -> tuple[str, dict[str, Array]]:
    """Contact force on the index's phalanx that is pushed most: its name, components and magnitude (n,), world axes."""
    run = replay.run
    step = np.repeat(np.arange(len(run.time_s)), np.diff(run.contact_start))
    found = np.zeros((3, len(run.time_s), 3))
    for k in range(3):
        own = run.contact_link == 4 + k
        np.add.at(found[k], step[own], run.contact_force_n[own, None] * run.contact_normal[own])
    pushed = int(np.argmax(np.linalg.norm(found, axis=2).sum(axis=1)))
    x, y, z = found[pushed].T
    return PHALANGES[pushed], {"x": x, "y": y, "z": z, "magnitude": np.linalg.norm(found[pushed], axis=1)}


def cost_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Detection, response and total against what of the hand is in use; the contacts stand at the markers."""
    objects = list(dict.fromkeys(row["object"] for row in rows))
    across = 2
    down = -(-len(objects) // across)
    figure = Figure(figsize=(COLUMN_WIDTH_IN, 1.25 * down + 0.3))
    FigureCanvasAgg(figure)
    highest = max(row["total_us"] for row in rows)
    for k, name in enumerate(objects):
        axis = figure.add_subplot(down, across, k + 1)
        own = [row for row in rows if row["object"] == name]
        x = [USED.index(row["in_use"]) for row in own]
        for colour, (key, label) in zip(COLOURS, PARTS.items(), strict=False):
            axis.plot(x, [row[key] for row in own], "o-", color=colour, markersize=2.5, linewidth=0.8, label=label)
        for place, row in zip(x, own, strict=True):
            at = place, row["total_us"]
            axis.annotate(f"{row['contacts']:.0f}", at, (0, 3), textcoords="offset points", ha="center", fontsize=6)
        axis.set_ylim(0, 1.18 * highest)
        axis.set_xlim(-0.4, 3.4)
        axis.set_xticks(range(4), [SHORT[used] for used in USED])
        axis.set_title(name.replace("_", " "), fontsize=7, pad=2)
        if k % across == 0:
            axis.set_ylabel("step, mean, µs")
        else:
            axis.tick_params(labelleft=False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=3, loc="upper center", frameon=False, borderaxespad=0.1)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.2 / figure.get_figheight()), pad=0.4)
    return figure


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """A CSV with the keys of the first row as its header."""
    with path.open("w", newline="", encoding="utf-8") as out:
        table = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
