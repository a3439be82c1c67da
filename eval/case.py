"""What the metrics look at: one run with its pack, and the exact gaps of its graphic hand, each worked out once."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack, BadTrace
from palmar.eval.gap import Flags, Mesh
from palmar.eval.judge import Shape, graphic_poses, mesh_gap, shape_in_object, sphere_gap
from palmar.model import AssetPack, SphereTree
from palmar.records import STATUS, Run

Array = NDArray[np.float64]
BITS = {name: np.uint32(bit) for bit, name in STATUS.items()}
MEASURED_BY_CLOCK = ("cpu_us", "wall_us", "search_us", "solve_us", "verify_us")  # a run without timing has none


class NotMeasured(Exception):
    """Why a metric has no value on this run."""


@dataclass(frozen=True)
class Reference:
    """What a converged solver answers to the same haptic hand: as runs, of which only the graphic poses are read.

    A pose that is not a number stands for a step without an answer.
    """

    same_start: Run | None = None  # each step started from the pose that the judged run had before it
    own_way: Run | None = None  # from the first step on its own


@dataclass(frozen=True)
class Case:
    """A run, the pack it was made with, and the object in it. Raises BadTrace or BadPack if they cannot be judged."""

    run: Run
    pack: AssetPack
    object_name: str
    pack_bytes: int | None = None  # size of the pack's file
    reference: Reference | None = None

    def __post_init__(self) -> None:
        run, name = self.run, self.object_name
        if name not in self.pack.objects:
            raise BadPack("E-PACK-OBJECT", name, f"no such object; there are {', '.join(sorted(self.pack.objects))}")
        count = len(self.tree.levels)
        if not -count <= self.level < count:
            raise BadPack("E-PACK-LEVEL", name, f"the run used level {self.level}; there are levels 0 to {count - 1}")
        if not len(run.time_s):
            raise BadTrace("E-RUN-EMPTY", "run", "no step; at least one is needed")
        for column in Run.__dataclass_fields__:
            values = getattr(run, column)
            if column in MEASURED_BY_CLOCK or not isinstance(values, np.ndarray) or np.isfinite(values).all():
                continue
            at = np.argwhere(~np.isfinite(values))[0].tolist()
            raise BadTrace("E-RUN-VALUE", f"run:{column}{at}", "not a finite number")

    @property
    def tree(self) -> SphereTree:
        return self.pack.objects[self.object_name]

    @property
    def level(self) -> int:
        return int(self.run.header.get("level", "-1"))

    @property
    def spheres(self) -> Array:
        """The spheres that the run collided with: the leaves, or the coarser level that its header names."""
        return self.tree.levels[self.level]

    @property
    def model_error(self) -> dict[str, Any]:
        """The pack's own figures for that level."""
        return self.tree.about.get("levels", [{}] * len(self.tree.levels))[self.level]

    @cached_property
    def shape(self) -> Shape:
        return shape_in_object(self.pack.hand, graphic_poses(self.run), self.run)

    @cached_property
    def mesh(self) -> Mesh:
        return Mesh(self.tree.vertices_m, self.tree.faces)

    @cached_property
    def sphere_gap_m(self) -> Array:
        """(n,) least gap of the hand to the spheres, cut at 2 mm: what a hand moves in a step at 2 m/s."""
        return sphere_gap(self.shape, self.spheres, band_m=2e-3)

    @cached_property
    def mesh_gap_m(self) -> tuple[Array, Array]:
        """Least gap of each link to the true mesh, cut at 0: phalanges (n, 15), palm spheres (n, p)."""
        return mesh_gap(self.shape, self.mesh)

    @property
    def link_depth_m(self) -> Array:
        """(n, 16) how deep the palm, and then each phalanx, is inside the true mesh; 0 outside."""
        phalanges, palm = self.mesh_gap_m
        return -np.minimum(0, np.column_stack([palm.min(axis=1), phalanges]))

    @cached_property
    def phalanx_contact(self) -> Flags:
        """(n, 15) whether the run reports a contact of the phalanx."""
        run = self.run
        step = np.repeat(np.arange(len(run.time_s)), np.diff(run.contact_start))
        phalanx = run.contact_link > 0
        reported = np.zeros((len(run.time_s), 15), dtype=bool)
        reported[step[phalanx], run.contact_link[phalanx].astype(int) - 1] = True
        return reported

    def has_status(self, *names: str) -> Flags:
        """(n,) steps with any of the status bits."""
        return (self.run.status & np.bitwise_or.reduce([BITS[name] for name in names])) != 0

    def in_phase(self, name: str) -> Flags:
        """(n,) steps in the phases of that name, ends not counted."""
        inside = np.zeros(len(self.run.time_s), dtype=bool)
        for phase in self.run.phases:
            if phase["name"] == name:
                inside |= (self.run.time_s >= phase["start_s"]) & (self.run.time_s < phase["end_s"])
        return inside

    def phase_slices(self, name: str) -> list[slice]:
        """The steps of each phase of that name, in order, ends not counted; phases without a step are left out."""
        times = self.run.time_s
        found = []
        for phase in self.run.phases:
            if phase["name"] == name:
                start, stop = np.searchsorted(times, [phase["start_s"], phase["end_s"]])
                found += [slice(int(start), int(stop))] if stop > start else []
        return found

    @cached_property
    def still_steps(self) -> NDArray[np.int64]:
        """(n,) how many steps ago, up to this one, the hand and object asked for last changed by a bit."""
        run = self.run
        same = np.ones(len(run.time_s), dtype=bool)
        same[0] = False
        for column in (
            run.haptic_palm_position_m,
            run.haptic_palm_rotation_wxyz,
            run.haptic_flexion_rad,
            run.haptic_abduction_rad,
            run.object_position_m,
            run.object_rotation_wxyz,
        ):
            flat = column.reshape(len(same), -1)
            same[1:] &= (flat[1:] == flat[:-1]).all(axis=1)
        steps = np.arange(len(same))
        return steps - np.maximum.accumulate(np.where(same, 0, steps))

    def settings(self) -> dict[str, Any]:
        return json.loads(self.run.header.get("settings", "{}"))

    @cached_property
    def limits_of_scene(self) -> dict[str, dict[str, Any]]:
        """Limits that the scene sets itself: "metric stat" -> {"limit", "reason"}. Raises BadTrace."""
        text = json.loads(self.run.header.get("trace_header", "{}")).get("limits", "{}")
        try:
            limits = json.loads(text)
            return {key: _limit(row) for key, row in limits.items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            message = f'{text!r}; {{"METRIC STAT": {{"limit": number or null, "reason": text}}}} is needed'
            raise BadTrace("E-RUN-VALUE", "run:trace_header.limits", message) from None


def _limit(row: dict[str, Any]) -> dict[str, Any]:
    return {"limit": None if row["limit"] is None else float(row["limit"]), "reason": str(row["reason"])}
