"""A map of a hand mesh's surface, unwrapped by its six sides, with the errors of the hybrid hand in named channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.exr import shown, write_exr
from palmar.model import HandModel
from palmar.tools.hand_picture import colours_of
from palmar.tools.hand_quality import MM, capsules_of, hybrid_gap
from palmar.tools.hand_shape import points_at, pose_hand, sweep_angles
from palmar.unwrap import unwrap

Array = NDArray[np.float64]

TEXELS = 150_000  # of the surface, about
BENT_DEG = (30, 60, 90)


def write_hand_map(path: str | Path, hand: HandModel) -> list[str]:
    """Write the map as float32 channels; returns their names.

    error_mm.rest and error_mm.bent30 to .bent90: above 0 the model sticks out, below it the mesh is bare; position_mm:
    where the texel is at rest in the palm frame; link: 0 the palm, 1 + 3 finger + phalanx. R, G, B show the error at
    rest; A is 1 on the surface.
    """
    assert hand.mesh is not None
    surface = unwrap(hand.mesh.vertices_m, hand.mesh.faces, TEXELS)
    skin = points_at(hand.mesh, surface.face, surface.share)
    poses = {"rest": hand.mesh.flexion_rad} | {f"bent{d}": sweep_angles(hand, d) for d in BENT_DEG}
    values: dict[str, Array] = {}
    for name, flexion in poses.items():
        posed = pose_hand(skin, hand, flexion)
        values[f"error_mm.{name}"] = -MM * hybrid_gap(posed, hand.palm_spheres_m, capsules_of(hand), posed.points_m)
        if name == "rest":
            values |= {f"position_mm.{axis}": MM * posed.points_m[:, k] for k, axis in enumerate("xyz")}
    values |= shown(colours_of(values["error_mm.rest"])) | {"link": skin.link.astype(np.float64)}
    header = {
        "comments": "Palmar: errors of a hybrid hand over the surface of its mesh; mm; A = 0: no surface",
        "texel_mm": float(MM * surface.pitch_m),
    }
    return write_exr(path, surface.shape, surface.row, surface.column, values, header)
