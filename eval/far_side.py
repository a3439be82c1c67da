"""Where a scene says that a link must never be: convex regions in the object's frame. Format: docs/formats.md.

The true mesh alone cannot tell that a hand is behind a plate that it passed through steps ago; the scene can.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadTrace
from palmar.eval.gap import Flags
from palmar.eval.judge import Shape
from palmar.records import Run

Array = NDArray[np.float64]
Region = dict[str, Any]  # half_spaces (k, 4): n.x > d; links, all if left out


def far_side_of(run: Run) -> list[Region]:
    """The regions that the run's trace names; none if it names none. Raises BadTrace if they are not readable."""
    said = json.loads(run.header.get("trace_header", "{}")).get("far_side", "[]")
    try:
        regions = json.loads(said)
        for region in regions:
            if np.array(region["half_spaces"], dtype=np.float64).shape[1:] != (4,):
                raise ValueError("half_spaces are lists of four numbers")
    except (ValueError, TypeError, KeyError) as error:
        raise BadTrace("E-RUN-VALUE", "trace_header:far_side", f"{error}; see docs/formats.md") from None
    return regions


def on_far_side(shape: Shape, regions: list[Region]) -> Flags:
    """(n,) steps in which a part of a link's axis, or the centre of a palm sphere, lies in one of the regions."""
    found = np.zeros(len(shape.c1), dtype=np.bool_)
    for region in regions:
        links = np.array(region.get("links", range(16)), dtype=np.int64)
        half_spaces = np.array(region["half_spaces"], dtype=np.float64)
        bones = links[links > 0] - 1
        found |= _enters(shape.c1[:, bones], shape.c2[:, bones], half_spaces).any(axis=1)
        if 0 in links:
            found |= _enters(shape.palm, shape.palm, half_spaces).any(axis=1)
    return found


def _enters(start: Array, end: Array, half_spaces: Array) -> Flags:
    """Whether segments (n, k, 3) have a point with n.x > d in every half-space: the part left after clipping."""
    low, high = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
    for *normal, d in half_spaces:
        a, b = start @ np.array(normal) - d, end @ np.array(normal) - d
        crossing = np.divide(a, a - b, out=np.zeros_like(a), where=a != b)
        low = np.where((a <= 0) & (b > 0), np.maximum(low, crossing), low)
        high = np.where((a > 0) & (b <= 0), np.minimum(high, crossing), high)
        high = np.where((a <= 0) & (b <= 0), -1.0, high)
    return high > low
