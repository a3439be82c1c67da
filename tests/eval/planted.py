"""What goes wrong in a solver, planted in a run that keeps every limit; and which metric sees it, as a table.

    .venv/bin/python tests/eval/planted.py

The run is a hand that presses 3 mm into a ball of one sphere, slides over it, rests, and leaves.
"""

import json
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from small import small_hand, small_pack

from palmar import _runtime, read_run, reference, save_pack
from palmar.eval import judge
from palmar.eval.case import Reference
from palmar.eval.metrics import measure
from palmar.model import load_pack
from palmar.records import STATUS, Trace, write_trace

RADIUS_M = 0.02
POSE = reference.POSE
ALIKE = {"palm_priority": 1.0, "imposed_priority": 1.0}  # palm and fingers yield alike, as in the reference


def press(folder):
    """(run, pack, path of the pack)"""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_M)
    figures = {"max": 0.0, "p99": 0.0, "mean": 0.0}  # the mesh is inside the sphere
    about = {"levels": [{"protrusion_mm": figures, "gap_mm": figures, "normal_error_deg": {"median": 0.0, "p95": 0.0}}]}
    made = small_pack(small_hand(), [[0, 0, 0, RADIUS_M]], ball.vertices, ball.faces.astype(np.int32), about)
    pack = folder / "ball.pack"
    save_pack(pack, made)

    # The first phalanx of the middle finger comes down on the ball.
    key_s = [0.0, 0.2, 0.3, 0.7, 0.9, 1.1, 1.2]
    key_mm = np.array(
        [[0, -40, 45], [0, -40, 31], [0, -40, 25], [6, -46, 25], [6, -46, 25], [6, -46, 45], [0, -40, 45]]
    )
    time_s = 1e-3 * np.arange(1200)
    at = np.empty((len(time_s), 3))
    for (a, b), (p, q) in zip(pairwise(key_s), pairwise(key_mm), strict=True):
        u = np.clip((time_s - a) / (b - a), 0, 1)[:, None]
        inside = time_s >= a
        at[inside] = (1e-3 * (p + (q - p) * u * u * (3 - 2 * u)))[inside]
    phases = [("slide", 0.3, 0.7), ("hold", 0.7, 0.9)]
    count = len(time_s)
    trace = Trace(
        header={
            "schema": "palmar.trace/1",
            "device": "made",
            "hand": "made",
            "side": "right",
            "phases": json.dumps([{"name": name, "start_s": a, "end_s": b} for name, a, b in phases]),
        },
        time_s=time_s,
        palm_position_m=at,
        palm_rotation_wxyz=np.tile([1.0, 0, 0, 0], (count, 1)),
        flexion_rad=np.zeros((count, 5, 3)),
        abduction_rad=np.zeros((count, 5)),
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0, 0, 0], (count, 1)),
    )
    write_trace(folder / "ball.mcap", trace)
    _runtime.replay(str(pack), str(folder / "ball.mcap"), str(folder / "ball.run.mcap"), "", ALIKE, {})
    return read_run(folder / "ball.run.mcap"), load_pack(pack), pack


def judged(run, pack, path):
    """Rows of every metric."""
    return measure(run, pack, "thing", reference=Reference(reference.same_start(run, path)))[0]


def outside(rows):
    """The numbers above their limit, as "metric stat"."""
    return {
        f"{row['metric']} {row['stat']}" for row in rows if row["limit"] is not None and row["value"] > row["limit"]
    }


def with_graphic(run, hand, steps, source):
    """The run with the graphic poses of `steps` taken from rows `source`, and the forces that follow from them."""
    changed = {}
    for name in POSE:
        changed[name] = getattr(run, name).copy()
        changed[name][steps] = getattr(run, name)[source]
    return with_forces(replace(run, **changed), hand)


def with_forces(run, hand):
    graphic, haptic = judge.graphic_poses(run), judge.haptic_poses(run)
    palm = hand.palm_stiffness_n_per_m * (run.palm_position_m - run.haptic_palm_position_m)
    return replace(run, fingertip_force_n=judge.fingertip_force(hand, graphic, haptic), palm_force_n=palm)


def sunk(run, hand, steps):
    """The run with the graphic hand at the haptic one, without contact, in `steps`; nothing said about it."""
    at = {name: getattr(run, name).copy() for name in POSE}
    for name in POSE:
        at[name][steps] = getattr(run, f"haptic_{name}")[steps]
    count = np.diff(run.contact_start)
    kept = ~np.repeat(np.isin(np.arange(len(count)), steps), count)
    contacts = {name: getattr(run, name)[kept] for name in run.__dataclass_fields__ if name.startswith("contact_")
                and name != "contact_start"}  # fmt: skip
    count[steps] = 0
    start = np.concatenate([[0], np.cumsum(count)])
    return with_forces(replace(run, **at, **contacts, contact_start=start, contacts=count.astype(np.uint32)), hand)


def dropped_contact(run, pack):
    return sunk(run, pack.hand, np.arange(325, 900, 50)), pack


def silent_freeze(run, pack):
    return with_graphic(run, pack.hand, np.arange(600, 1200), 600), pack


def stated_freeze(run, pack):
    """Frozen as above, and each step says that it kept the pose before."""
    frozen = silent_freeze(run, pack)[0]
    kept = next(bit for bit, name in STATUS.items() if name == "kept_previous")
    status = frozen.status.copy()
    status[600:] |= np.uint32(kept)
    return replace(frozen, status=status), pack


def lag(run, pack):
    return with_graphic(run, pack.hand, np.arange(5, 1200), np.arange(1195)), pack


def shifted_mesh(up_m):
    def shift(run, pack):
        tree = pack.objects["thing"]
        moved = replace(tree, vertices_m=tree.vertices_m + np.array([0, 0, up_m]))
        return run, replace(pack, objects={"thing": moved})

    return shift


def depth_stated_as_zero(run, pack):
    down = 2e-4 * (run.contacts > 0)[:, None] * [0, 0, 1]
    deep = replace(run, palm_position_m=run.palm_position_m - down, contact_gap_m=np.zeros_like(run.contact_gap_m))
    return with_forces(deep, pack.hand), pack


# Name -> what makes it of (run, pack), and the numbers that leave their limit.
FAULTS = {
    "a contact dropped one step in 50": (
        dropped_contact,
        {
            "penetration_spheres max",
            "penetration_mesh max",
            "excess_force_step max",
            "still_force_step max",
            "contact_toggles sum",
            "force_above_20hz value",
            "energy_generated max",
        },
    ),
    "the hand freezes and says nothing": (silent_freeze, {"cost_excess mean"}),
    "the hand freezes and says so": (stated_freeze, {"cost_excess mean", "frozen_steps sum", "frozen_steps longest"}),
    "the hand is 5 steps late": (lag, {"free_lag max_palm", "cost_excess mean"}),
    "the mesh stands 1 mm above its spheres": (shifted_mesh(0.001), {"penetration_mesh max"}),
    "the mesh stands 1 mm below its spheres": (shifted_mesh(-0.001), {"hover p99"}),
    # It sinks in and comes out again at once, which is a jump of force, and one that nobody paid for.
    "0.2 mm of depth stated as gap 0": (
        depth_stated_as_zero,
        {"penetration_spheres max", "penetration_mesh max", "excess_force_step max", "energy_generated max"},
    ),
}


def main():
    """Metric x fault: the value where it is above its limit, the value in brackets where it only moved."""
    with tempfile.TemporaryDirectory(prefix="palmar-faults-") as folder:
        run, pack, path = press(Path(folder))
        columns = {"as it is": judged(run, pack, path)}
        for name, (plant, _) in FAULTS.items():
            columns[name] = judged(*plant(run, pack), path)
    for k, name in enumerate(columns):
        print(f"{k}: {name}")
    head = [f"{'metric':<32}", f"{'limit':>8}", *(f"{k:>10}" for k in range(len(columns)))]
    print(" ".join(head))
    for cells in zip(*columns.values(), strict=True):
        if cells[0]["limit"] is None or cells[0]["metric"].startswith("step_"):
            continue
        values = [cell["value"] for cell in cells]
        text = ["-" if v is None else f"{v + 0.0:.3g}{'!' if v > cells[0]['limit'] else ' '}" for v in values]
        name = f"{cells[0]['metric']} {cells[0]['stat']}, {cells[0]['unit']}"
        print(" ".join([f"{name:<32}", f"{cells[0]['limit']:>8.3g}", *(f"{each:>10}" for each in text)]))


if __name__ == "__main__":
    main()
