"""A map of the surface with the errors of a union of spheres in named channels, as OpenEXR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.exr import shown, write_exr
from palmar.tools.cover_place import SurfaceErrors
from palmar.unwrap import Unwrapped

Array = NDArray[np.float64]


def write_map(path: str | Path, place: Unwrapped, errors: SurfaceErrors, colours: Array) -> list[str]:
    """Write the errors at the texels as float32 channels; returns their names.

    colours (n, 3), sRGB: what viewers show, stored linear as R, G, B; A is 1 on the surface. NaN in
    a felt channel: no fingertip reaches the place.
    """
    position = place.points * 1e3
    values = {
        **shown(colours),
        "gap_mm": errors.gap_m * 1e3,
        "protrusion_mm": errors.protrusion_m * 1e3,
        "normal_deg": errors.normal_deg,
        "felt_offset_mm": errors.felt_offset_m * 1e3,
        "felt_normal_deg": errors.felt_normal_deg,
        "position_mm.x": position[:, 0],
        "position_mm.y": position[:, 1],
        "position_mm.z": position[:, 2],
    }
    header = {
        "comments": "Palmar: errors of a union of spheres over the surface of its mesh; mm, degrees, A = 0: no surface",
        "texel_mm": float(place.pitch_m * 1e3),
    }
    return write_exr(path, place.shape, place.row, place.column, values, header)
