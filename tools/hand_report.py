"""What `fit-hand --report` writes: the errors of every part at every pose, a picture, and a map of the surface."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from palmar.files import whole_folder
from palmar.model import HandModel
from palmar.tools.hand_map import write_hand_map
from palmar.tools.hand_picture import draw_hand

FILES = {"fit.json", "hand.exr", "hand.png"}
WHAT = "fit report"


def write_fit_report(folder: str | Path, hand: HandModel, answer: dict[str, Any]) -> None:
    """Write the report of a fit as a folder, in place of an earlier one."""
    rest = answer["hand"]["error"]["rest"]["phalanges"]
    figures = f"phalanges p99: {rest['protrusion_mm']['p99']:.2f} mm out, {rest['gap_mm']['p99']:.2f} mm bare"
    with whole_folder(Path(folder), FILES, WHAT) as made:
        draw_hand(made / "hand.png", hand, f"{answer['hand']['source']} ({answer['hand']['side']} hand), {figures}")
        write_hand_map(made / "hand.exr", hand)
        (made / "fit.json").write_text(json.dumps(answer, indent=1, sort_keys=True) + "\n")
