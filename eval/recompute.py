"""A run's own list of contacts, worked out once more by the judge from poses, hand and spheres alone."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.eval.case import Case
from palmar.eval.gap import capsule_point_gap
from palmar.eval.judge import graphic_poses, shape_in_object, sphere_gap

Array = NDArray[np.float64]

STEPS = 1000
TOLERANCE_MM = 1e-6
BAND_M = 1e-3


@dataclass(frozen=True)
class Recomputed:
    """What was compared, and the largest differences."""

    steps: int
    contacts: int
    gap_mm: float  # of a contact's gap, stated and found
    least_mm: float  # of the least gap of a step: listed, and of all pairs of hand and spheres; where both are in reach
    unlisted: int  # steps with a pair that overlaps though the list is empty

    @property
    def same(self) -> bool:
        return self.gap_mm <= TOLERANCE_MM and self.least_mm <= TOLERANCE_MM and not self.unlisted

    def told(self) -> dict[str, Any]:
        return {**asdict(self), "tolerance_mm": TOLERANCE_MM, "same": self.same}


def recompute(case: Case, seed: int = 0, count: int = STEPS) -> Recomputed:
    """Compare at most `count` steps, drawn by the seed from those that list a contact, or from all if none does."""
    run = case.run
    size = np.diff(run.contact_start)
    pool = np.flatnonzero(size > 0)
    pool = pool if len(pool) else np.arange(len(size))
    steps = np.sort(np.random.default_rng(seed).choice(pool, min(count, len(pool)), replace=False))
    shape = shape_in_object(case.pack.hand, graphic_poses(run)[steps], run, steps)
    rows = np.concatenate([np.arange(run.contact_start[i], run.contact_start[i + 1]) for i in steps])
    at = np.repeat(np.arange(len(steps)), size[steps])
    link, ball = run.contact_link[rows].astype(np.int64), run.contact_palm_sphere[rows].astype(np.int64)
    sphere = case.spheres[run.contact_object_sphere[rows]]
    finger = link > 0
    c1, c2 = np.empty((len(rows), 3)), np.empty((len(rows), 3))
    r1, r2 = np.empty(len(rows)), np.empty(len(rows))
    c1[finger], c2[finger] = shape.c1[at[finger], link[finger] - 1], shape.c2[at[finger], link[finger] - 1]
    r1[finger], r2[finger] = shape.r1[link[finger] - 1], shape.r2[link[finger] - 1]
    c1[~finger] = c2[~finger] = shape.palm[at[~finger], ball[~finger]]
    r1[~finger] = r2[~finger] = shape.palm_radius[ball[~finger]]
    gap = capsule_point_gap(c1, r1, c2, r2, sphere[:, :3]) - sphere[:, 3]
    apart = np.abs(gap - run.contact_gap_m[rows])
    least = sphere_gap(shape, case.spheres, band_m=BAND_M)
    listed = np.full(len(steps), np.inf)
    np.minimum.at(listed, at, run.contact_gap_m[rows])
    both = (listed < BAND_M) & (least < BAND_M)
    return Recomputed(
        steps=len(steps),
        contacts=len(rows),
        gap_mm=1e3 * float(apart.max(initial=0.0)),
        least_mm=1e3 * float(np.abs(least - listed)[both].max(initial=0.0)),
        unlisted=int(((least < 0) & ~np.isfinite(listed)).sum()),
    )
