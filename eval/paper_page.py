"""The paper's figures and its table of section V.D as a folder: PDF, SVG and PNG, the numbers as CSV, and a page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palmar.eval.figures import METADATA, STYLE
from palmar.eval.force import FLOOR_N
from palmar.eval.metrics import measure
from palmar.eval.paper_figures import (
    Replay,
    Tile,
    cost_figure,
    finger_forces,
    force_figure,
    index_contact_force,
    tile_grid,
    tile_rows,
    write_rows,
)
from palmar.eval.texts import fill, read
from palmar.files import whole_folder
from palmar.model import FINGERS

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

MEASURED = ("penetration_spheres", "penetration_mesh", "force_variation_ratio", "excess_force_step", "palm_offset")
ROWS = ("one finger", "two fingers", "five and palm")
FORCES_OF = ("cup", "ears")  # of Fig. 14, if they are there; else the first two
# What the paper states: mean step times of Fig. 11 in ms, and of V.D.
PAPER_MEAN_MS = {"sphere": 0.41, "cylinder": 0.31, "triangular_prism": 0.31, "cube": 0.32, "hexagonal_prism": 0.48}
PAPER_TABLE = {"penetration_spheres_mm": "0.1", "variation_%": "0.18 (0.32)", "variation_x_%": "0.18 (0.32)",
               "variation_y_%": "0.16 (0.29)", "variation_z_%": "0.18 (0.32)"}  # fmt: skip


def write_paper(
    told: Sequence[dict[str, Any]], out: Path, note: str, about: dict[str, str], progress: Progress
) -> dict[str, Any]:
    """Judge replays and write figures, CSVs and index.html. told: figure, object, label, assets, run, times_us.

    Returns figures, table (rows of V.D), note, about.
    """
    replays = []
    for number, each in enumerate(told):
        progress(f"judge {each['object']} {each['label']}", 0.6 * number / len(told))
        replays.append(_judged(each))
    table = _table(replays)
    with whole_folder(out / "figures", set(), "paper's figures") as folder:
        captions = {}
        for number, (name, (figure, rows, caption)) in enumerate(_figures(replays)):
            progress(f"draw {name}", 0.6 + 0.4 * number / 5)
            for kind, metadata in METADATA.items():
                figure.savefig(folder / f"{name}.{kind}", metadata=metadata, dpi=600 if kind != "png" else 300)
            for ending, part in rows.items():
                write_rows(folder / f"{name}{ending}.csv", part)
            captions[name] = caption
        write_rows(folder / "table_vd.csv", table)
        page = _page(folder, captions, table, note, about)
    (out / "index.html").write_text(page, encoding="utf-8")
    return {"figures": captions, "table": table, "note": note, "about": about}


def _judged(told: dict[str, Any]) -> Replay:
    rows, series = measure(told["run"], told["assets"], told["object"], only=MEASURED)
    numbers = {(row["metric"], row["stat"]): row["value"] for row in rows}
    kept = (told[key] for key in ("figure", "object", "label", "assets", "run", "times_us"))
    return Replay(*kept, numbers=numbers, series=series)


def _figures(replays: Sequence[Replay]) -> Any:
    """(name, (figure, {ending: rows of a CSV}, caption)), drawn one after the other in the reports' style."""
    by = {number: [replay for replay in replays if replay.figure == number] for number in ("11", "12", "13", "15")}
    for name, make, of in (
        ("fig11", _fig11, by["11"]),
        ("fig12", _fig12, by["12"]),
        ("fig13", _fig13, by["13"]),
        ("fig14", _fig14, by["13"]),
        ("fig15", _fig15, by["15"]),
    ):
        if of:
            with rc_context(STYLE):
                yield name, make(of)


def _fig11(replays: Sequence[Replay]) -> tuple[Figure, dict[str, Any], str]:
    tiles = []
    for replay in replays:
        hold = replay.phase("hold")
        tiles.append(Tile(replay, int(hold[len(hold) // 2]), replay.label, replay.object.replace("_", " ")))
    columns = list(dict.fromkeys(tile.column for tile in tiles))
    means = {
        name: _mean_ms([r for r in replays if r.object == name]) for name in dict.fromkeys(r.object for r in replays)
    }
    said = ", ".join(f"{name.replace('_', ' ')} {mean:.3f}" for name, mean in means.items())
    stated = ", ".join(f"{PAPER_MEAN_MS[name]:g}" for name in means if name in PAPER_MEAN_MS)
    caption = (
        f"Simple objects, each the middle of a hold. Mean time of a step over the three, in contact: {said} ms (the "
        f"paper, on its machine: {stated})."
    )
    return tile_grid(tiles, ROWS, columns), {"": tile_rows(tiles)}, caption


def _mean_ms(replays: Sequence[Replay]) -> float:
    parts = [replay.times_us["cpu_us"][replay.run.contacts > 0] for replay in replays]
    return 1e-3 * float(np.concatenate(parts).mean()) if any(map(len, parts)) else 0.0


def _fig12(replays: Sequence[Replay]) -> tuple[Figure, dict[str, Any], str]:
    forces = [finger_forces(replay) for replay in replays]
    rows = {f"-{replay.object}": _force_rows(replay, lines) for replay, lines in zip(replays, forces, strict=True)}
    slowest = max(float(replay.times_us["cpu_us"].max()) for replay in replays)
    caption = (
        "Normal forces at the five fingertips while none, one, two, five, two, one and no finger has hold, and the "
        "time of each step; "
        f"the slowest took {1e-3 * slowest:.3f} ms (the paper: all below 1 ms)."
    )
    return force_figure(replays, forces), rows, caption


def _force_rows(replay: Replay, lines: dict[str, Array]) -> list[dict[str, str]]:
    columns = {"time_s": replay.run.time_s, **{f"{name}_n": line for name, line in lines.items()}}
    columns |= {"step_cpu_us": replay.times_us["cpu_us"], "contacts": replay.run.contacts.astype(float)}
    return [
        dict(zip(columns, (f"{value:.9g}" for value in row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]


def _fig13(replays: Sequence[Replay]) -> tuple[Figure, dict[str, Any], str]:
    tiles, columns = [], ["squeeze", "hold", "slide"]
    for replay in replays:
        name = replay.object.replace("_", " ")
        steps, notes = _states(replay), ("", "", "")
        if replay.label == "switch of contact":
            steps, name, notes = _switch(replay), f"{name}, switch", ("first ear", "in the air", "second ear")
        tiles += [Tile(replay, *of) for of in zip(steps, [name] * 3, columns, notes, strict=True)]
    rows = list(dict.fromkeys(tile.row for tile in tiles))
    deepest = max(replay.numbers["penetration_spheres", "max"] or 0.0 for replay in replays)
    caption = (
        "Complex objects: the end of the squeeze, the middle of the hold, the step of the slide with the most "
        "contacts. The last row, where the "
        "ears are: an index on the first ear, in the air, on the second. "
        f"Deepest overlap with a sphere in any step of them: {deepest:.2g} mm."
    )
    return tile_grid(tiles, rows, columns), {"": tile_rows(tiles)}, caption


def _states(replay: Replay) -> list[int]:
    """End of the squeeze, middle of the hold, most contacts of the slide; parts of what touches if there are none."""
    run = replay.run
    touching = np.flatnonzero(run.contacts > 0)
    touching = touching if len(touching) else np.arange(len(run.time_s))
    close, hold, slide = (replay.phase(name) for name in ("close", "hold", "slide"))
    return [
        int(close[-1]) if len(close) else int(touching[len(touching) // 6]),
        int(hold[len(hold) // 2]) if len(hold) else int(touching[len(touching) // 2]),
        int(slide[np.argmax(run.contacts[slide])]) if len(slide) else int(touching[5 * len(touching) // 6]),
    ]


def _switch(replay: Replay) -> list[int]:
    """The strongest touch before and after the longest time in the air between two touches, and its middle."""
    force = replay.force_n.max(axis=1)
    touching = np.flatnonzero(force > 0)
    gaps = np.diff(touching)
    if not len(gaps) or gaps.max() == 1:
        return _states(replay)
    k = int(np.argmax(gaps))
    before, after = touching[: k + 1], touching[k + 1 :]
    return [
        int(before[np.argmax(force[before])]),
        int(touching[k] + gaps[k] // 2),
        int(after[np.argmax(force[after])]),
    ]


def _fig14(replays: Sequence[Replay]) -> tuple[Figure, dict[str, Any], str]:
    of_states = [replay for replay in replays if replay.label != "switch of contact"]
    shown = [replay for replay in of_states if replay.object in FORCES_OF] or of_states[:2]
    found = [index_contact_force(replay) for replay in shown]
    rows = {
        f"-{number}-{replay.object}": _force_rows(replay, lines)
        for number, (replay, (_, lines)) in enumerate(zip(shown, found, strict=True))
    }
    every = np.concatenate([replay.times_us["cpu_us"] for replay in shown])
    where = ", ".join(f"{replay.object}: {name}" for replay, (name, _) in zip(shown, found, strict=True))
    caption = (
        f"Contact force on the phalanx of the index that is pushed most ({where}), components and magnitude in "
        "world axes, and the time of each step: "
        f"{100 * float((every < 1000).mean()):.4g} % below 1 ms, the slowest {1e-3 * every.max():.3f} ms (the "
        "paper: most below 1, all below 1.5 ms)."
    )
    return force_figure(shown, [lines for _, lines in found]), rows, caption


def _fig15(replays: Sequence[Replay]) -> tuple[Figure, dict[str, Any], str]:
    rows = []
    for replay in replays:
        at = replay.run.contacts > 0
        mean = {k: float(v[at].mean()) if at.any() else 0.0 for k, v in replay.times_us.items()}
        rows.append(
            {
                "object": replay.object,
                "in_use": replay.label,
                "steps": int(at.sum()),
                "contacts": float(replay.run.contacts[at].mean()) if at.any() else 0.0,
                "contacts_max": int(replay.run.contacts.max()),
                "detection_us": mean["search_us"],
                "response_us": mean["solve_us"] + mean["verify_us"],
                "total_us": mean["cpu_us"],
            }
        )
    caption = (
        "Mean time of a step in contact with one finger (SF), two (TF), five (FF) and the whole hand (WH) in use; "
        "the number at a marker is the mean "
        "of the contacts handled. One thread: a step has no more (the paper: 131 contacts of two fingers on the "
        "bunny, about 1 ms)."
    )
    return cost_figure(rows), {"": rows}, caption


def _table(replays: Sequence[Replay]) -> list[dict[str, Any]]:
    """Rows of section V.D, the paper's own first."""
    rows = []
    for replay in replays:
        if replay.figure == "V.D" or (replay.figure == "13" and replay.label != "switch of contact"):
            rows.append(
                {
                    "object": replay.object,
                    "hold": "with sensor noise" if replay.figure == "V.D" else "as scripted",
                    **_row(replay),
                }
            )
    if not rows:
        return []
    stated = {key: PAPER_TABLE.get(key, "") for key in rows[0]}
    return [stated | {"object": "the paper", "hold": "by a glove, held still"}, *rows]


def _row(replay: Replay) -> dict[str, str]:
    force, hold = replay.run.fingertip_force_n[:, FINGERS.index("index")], replay.phase("hold")
    found = {"penetration_spheres_mm": _text(replay.numbers["penetration_spheres", "max"])}
    found["penetration_mesh_mm"] = _text(replay.numbers["penetration_mesh", "max"])
    components = {"": np.linalg.norm(force, axis=1), "_x": force[:, 0], "_y": force[:, 1], "_z": force[:, 2]}
    for name, line in components.items():
        at = np.abs(line[hold])
        varied = 100 * np.abs(np.diff(at)) / np.maximum(at[:-1], FLOOR_N) if len(at) > 1 else np.zeros(0)
        found[f"variation{name}_%"] = f"{varied.mean():.2g} ({varied.std():.2g})" if len(varied) else ""
    found["by_frozen_hand"] = _text(replay.numbers["force_variation_ratio", "mean"])
    found["excess_force_step_n"] = _text(replay.numbers["excess_force_step", "max"])
    found["palm_offset_p99_mm"] = _text(replay.numbers["palm_offset", "p99"])
    return found


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


HEADS = {
    "object": "object",
    "hold": "hold",
    "penetration_spheres_mm": "depth in spheres, mm",
    "penetration_mesh_mm": "in the true mesh, mm",
    "variation_%": "variation of |F|, %",
    "variation_x_%": "of x",
    "variation_y_%": "of y",
    "variation_z_%": "of z",
    "by_frozen_hand": "by that of a frozen hand",
    "excess_force_step_n": "excess force step, N",
    "palm_offset_p99_mm": "palm offset p99, mm",
}


def _page(folder: Path, captions: dict[str, str], table: list[dict[str, Any]], note: str, about: dict[str, str]) -> str:
    shown = []
    for name, caption in captions.items():
        image = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        files = sorted(path.name for path in folder.glob(f"{name}*") if path.suffix != ".png")
        links = " ".join(f'<a href="figures/{escape(file)}">{escape(file)}</a>' for file in files)
        title = f"Fig. {name.removeprefix('fig')}"
        shown.append(
            f'<figure id="{name}"><img src="data:image/png;base64,{image}" alt="{title}"><figcaption><b>{title}.</b> '
            f'{escape(caption)}<br><span class="files">{links}</span></figcaption></figure>'
        )
    head = "".join(f"<th>{escape(HEADS[key])}</th>" for key in (table[0] if table else ()))
    rows = "".join(f"<tr>{''.join(f'<td>{escape(str(value))}</td>' for value in row.values())}</tr>" for row in table)
    return fill(
        "paper.html",
        css=read("page.css"),
        note=f'<p class="verdict fail">{escape(note)} Times below are of that machine.</p>' if note else "",
        figures="\n".join(shown),
        table=f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>",
        about="".join(f'<tr><th>{escape(k)}</th><td class="hash">{escape(v)}</td></tr>' for k, v in about.items()),
    )
