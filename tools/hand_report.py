"""What `fit-hand --report` writes: the errors of every part at every pose, a picture, and a map of the surface."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from palmar.errors import PalmarError
from palmar.model import HandModel, write_whole
from palmar.tools.hand_map import write_hand_map
from palmar.tools.hand_picture import draw_hand

FILES = ("fit.json", "hand.exr", "hand.png")


def write_fit_report(folder: str | Path, hand: HandModel, answer: dict[str, Any]) -> list[str]:
    """Write the report of a fit into a folder, new or of an earlier report. Returns the names of its files."""
    folder = check_report_place(folder)
    rest = answer["hand"]["error"]["rest"]["phalanges"]
    figures = f"phalanges p99: {rest['protrusion_mm']['p99']:.2f} mm out, {rest['gap_mm']['p99']:.2f} mm bare"
    with tempfile.TemporaryDirectory(prefix="palmar-") as made:
        draw_hand(
            Path(made) / "hand.png", hand, f"{answer['hand']['source']} ({answer['hand']['side']} hand), {figures}"
        )
        write_hand_map(Path(made) / "hand.exr", hand)
        write_whole(Path(made) / "fit.json", (json.dumps(answer, indent=1, sort_keys=True) + "\n").encode())
        folder.mkdir(parents=True, exist_ok=True)
        for name in FILES:
            shutil.copyfile(Path(made) / name, folder / name)
    return list(FILES)


def check_report_place(folder: str | Path) -> Path:
    """The folder. Raises PalmarError if it holds anything but an earlier report."""
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and {entry.name for entry in folder.iterdir()} <= set(FILES)):
        raise PalmarError("E-FILE-PLACE", str(folder), "holds other files; a new folder or an earlier report is needed")
    return folder
