"""Maps of a surface as OpenEXR: named float channels over the texels of an `Unwrapped`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def write_exr(
    path: str | Path,
    shape: tuple[int, int],
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    values: dict[str, Array],
    header: dict[str, Any],
) -> list[str]:
    """Write values (n,) by channel at texels (row, column) of an image, 0 elsewhere, as float32; returns the names."""
    import OpenEXR

    channels = {}
    for name, value in values.items():
        image = np.zeros(shape, dtype=np.float32)
        image[row, column] = value
        channels[name] = image
    form = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File({**form, **header}, channels) as out:
        out.write(str(path))
    return list(values)


def write_parts(path: str | Path, parts: dict[str, dict[str, Array]], header: dict[str, Any]) -> None:
    """Write one image a part, each with its own channels (rows, columns), float32; the header stands in every part."""
    import OpenEXR

    form = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    made = [
        OpenEXR.Part(
            {**form, **header},
            {key: np.ascontiguousarray(image, dtype=np.float32) for key, image in images.items()},
            name,
        )
        for name, images in parts.items()
    ]
    with OpenEXR.File(made) as out:
        out.write(str(path))


def shown(colours: Array) -> dict[str, Array]:
    """The channels R, G, B, linear as viewers take them, of sRGB colours (n, 3), and A = 1: there is a surface."""
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    return {**{letter: linear[:, k] for k, letter in enumerate("RGB")}, "A": np.ones(len(colours))}
