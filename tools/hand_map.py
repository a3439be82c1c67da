"""A map of a hand mesh's surface with the errors of the hybrid hand in named channels, as OpenEXR.

Every two triangles share a square tile, so every point of the surface is there once. The tiles stand in the order of
the links, palm first.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.model import HandModel
from palmar.tools.hand_picture import colours_of
from palmar.tools.hand_quality import MM, capsules_of, hybrid_gap
from palmar.tools.hand_shape import points_at, pose_hand, sweep_angles

Array = NDArray[np.float64]

TEXELS = 150_000  # of the surface, about
BENT_DEG = (30, 60, 90)


def write_hand_map(path: str | Path, hand: HandModel) -> list[str]:
    """Write the map as float32 channels; returns their names.

    error_mm.rest and error_mm.bent30 to .bent90: above 0 the model sticks out, below it the mesh is bare; position_mm:
    where the texel is at rest in the palm frame; link: 0 the palm, 1 + 3 finger + phalanx. R, G, B show the error at
    rest; A is 1 on the surface.
    """
    import OpenEXR

    assert hand.mesh is not None
    order = np.argsort(hand.mesh.weights[hand.mesh.faces].sum(axis=1).argmax(axis=1), kind="stable")
    row, column, face, mix, shape = _tiles(len(order))
    skin = points_at(hand.mesh, order[face], mix)
    poses = {"rest": hand.mesh.flexion_rad} | {f"bent{d}": sweep_angles(hand, d) for d in BENT_DEG}
    values: dict[str, Array] = {}
    for name, flexion in poses.items():
        posed = pose_hand(skin, hand, flexion)
        values[f"error_mm.{name}"] = -MM * hybrid_gap(posed, hand.palm_spheres_m, capsules_of(hand), posed.points_m)
        if name == "rest":
            values |= {f"position_mm.{axis}": MM * posed.points_m[:, k] for k, axis in enumerate("xyz")}
    shown = colours_of(values["error_mm.rest"])
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    values |= {letter: linear[:, k] for k, letter in enumerate("RGB")}
    values |= {"A": np.ones(len(face)), "link": skin.link.astype(np.float64)}
    channels = {}
    for name, value in values.items():
        image = np.zeros(shape, dtype=np.float32)
        image[row, column] = value
        channels[name] = image
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": "Palmar: errors of a hybrid hand over the surface of its mesh; mm; A = 0: no surface",
    }
    with OpenEXR.File(header, channels) as out:
        out.write(str(path))
    return list(values)


def _tiles(faces: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], Array, tuple[int, int]]:
    """Row, column, face (n,), barycentric coordinates (n, 3) of each texel, and the image's shape."""
    side = max(2, round(np.sqrt(2 * TEXELS / faces)))
    tiles = (faces + 1) // 2
    across = int(np.ceil(np.sqrt(tiles)))
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    lower = (i + j < side).ravel()
    u, v = (i.ravel() + 0.5) / side, (j.ravel() + 0.5) / side
    u, v = np.where(lower, u, 1 - u), np.where(lower, v, 1 - v)
    # On the tile's diagonal a texel's middle lies on the edge of its triangle or just beyond.
    mix = np.clip(np.column_stack([1 - u - v, u, v]), 0, 1)
    mix /= mix.sum(axis=1)[:, None]
    tile = np.repeat(np.arange(tiles), side * side)
    face = 2 * tile + np.tile(~lower, tiles)
    row, column = tile // across * side + np.tile(i.ravel(), tiles), tile % across * side + np.tile(j.ravel(), tiles)
    used = face < faces
    shape = (int(np.ceil(tiles / across)) * side, across * side)
    return row[used], column[used], face[used], np.tile(mix, (tiles, 1))[used], shape
