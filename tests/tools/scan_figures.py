"""Registering a scan of another hand's shape, against what a rig of the scanned hand says.

`python tests/tools/scan_figures.py [SCANNED] [TO]` takes two rigged hands of one side (the Godot hand, onto the fitted
WebXR hand), throws away the rig of the first, places the mesh anywhere, gives landmarks 2 mm off, and registers it as a
mesh and as 30,000 points with 0.5 mm of noise and 1 % of strays, with six landmarks and with all joints given. Truth
are the rig's joints and the mesh with its skin weights: how far joints are off, and the larger of the 99th
percentiles of protrusion and gap of the fitted hand against the true mesh, beside those of the rigged fit.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.model import FINGERS, HandModel, load_pack
from palmar.skin import link_motions
from palmar.tools.cover import weighted_quantile
from palmar.tools.gltf_skin import read_skin
from palmar.tools.hand_fit import fit_hand
from palmar.tools.hand_frame import HandFrame, make_frame
from palmar.tools.hand_quality import SPACING_M, capsules_of, gap_samples, protrusion_samples
from palmar.tools.hand_shape import PosedHand, pose_hand, skin_points
from palmar.tools.rig import Rig, make_rig

HANDS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "hands"
TURN, SHIFT_M = Rotation.from_rotvec([0.7, -1.1, 2.0]), np.array([0.3, -0.2, 0.5])
WRIST_M = 0.025
MM = 1e3


def true_marks(rig: Rig) -> dict[str, np.ndarray]:
    """Wrist, skin at the fingertips and joints, in the rig's frame."""
    marks = {"wrist": rig.place("wrist")}
    for f, finger in enumerate(FINGERS):
        before, tip = rig.place(f"{finger}-distal"), rig.place(f"{finger}-tip")
        ahead = (tip - before) / np.linalg.norm(tip - before)
        of = rig.mesh.vertices[rig.link[rig.mesh.weights.argmax(axis=1)] == 3 * f + 3]
        off = of - before
        near = np.linalg.norm(off - (off @ ahead)[:, None] * ahead, axis=1) < 4e-3
        marks[f"{finger}-tip"] = before + (off[near] @ ahead).max() * ahead
        parts = ("metacarpal", "proximal") if f == 0 else ("proximal", "intermediate")
        marks |= {f"{finger}-{part}": rig.place(f"{finger}-{part}") for part in (*parts, "distal")}
    return marks


def write_cloud(path: Path, points: np.ndarray) -> Path:
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(header.encode() + points.astype("<f8").tobytes())
    return path


def write_scans(folder: Path, rig: Rig, seed: int = 0) -> dict[str, Path]:
    """The mesh, and noisy points on it, both turned and moved; and landmarks of wrist and tips, and of all joints."""
    rng = np.random.default_rng(seed)
    vertices = TURN.apply(rig.mesh.vertices) + SHIFT_M
    lines = ["v {:.7f} {:.7f} {:.7f}\n".format(*vertex) for vertex in vertices]
    lines += ["f {} {} {}\n".format(*face) for face in rig.mesh.faces + 1]
    (folder / "mesh.obj").write_text("".join(lines))
    corner = vertices[rig.mesh.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    face = rng.choice(len(corner), 30_000, p=area / area.sum())
    points = np.einsum("nk,nka->na", rng.dirichlet([1, 1, 1], len(face)), corner[face])
    points += 5e-4 * rng.normal(size=points.shape)
    points[:300] = rng.uniform(points.min(axis=0), points.max(axis=0), (300, 3))
    write_cloud(folder / "cloud.ply", points)
    marks = {name: TURN.apply(place) + SHIFT_M for name, place in true_marks(rig).items()}
    marks = {name: (place + 2e-3 / 3**0.5 * rng.normal(size=3)).tolist() for name, place in marks.items()}
    six = {name: place for name, place in marks.items() if name == "wrist" or name.endswith("-tip")}
    (folder / "six.json").write_text(json.dumps(six))
    (folder / "all.json").write_text(json.dumps(marks))
    return {name: folder / name for name in ("mesh.obj", "cloud.ply", "six.json", "all.json")}


def judged(found: HandModel, at: HandFrame, true: HandModel, frame: HandFrame) -> dict[str, float]:
    """The larger 99th percentile of protrusion and gap, mm, of the found hand against the true mesh as it was scanned.

    at: the found hand's frame in the true rig's frame. The palm beyond WRIST_M, since scans are closed there anyhow.
    """
    assert true.mesh is not None and found.mesh is not None
    turn = frame.rotation @ at.rotation.T
    shift = (at.origin - frame.origin) @ frame.rotation.T
    palm = found.palm_spheres_m.copy()
    palm[:, :3] = palm[:, :3] @ turn.T + shift
    capsules, skin = capsules_of(found), skin_points(true.mesh, SPACING_M)
    axes = (found.joint_m, found.flexion_axis, found.abduction_axis)
    posed = pose_hand(skin, true, true.mesh.flexion_rad)
    turns, shifts = (m[0] for m in link_motions(*axes, found.mesh.flexion_rad[None], np.zeros((1, 5))))
    mine: PosedHand = replace(posed, turn=turn @ turns, shift=shifts @ turn.T + shift)
    gap = gap_samples(replace(skin, real=posed.points_m[:, 1] > WRIST_M), mine, palm, capsules)
    out = protrusion_samples(mine, palm[palm[:, 1] - palm[:, 3] > 0.8 * WRIST_M], capsules, 0)
    parts = {"thumb": slice(1, 4), "fingers": slice(4, 16), "palm": slice(0, 1)}
    return {name: max(_p99(out[part]), _p99(gap[part])) for name, part in parts.items()}


def _p99(samples: list[tuple[np.ndarray, np.ndarray]]) -> float:
    values, areas = (np.concatenate(part) for part in zip(*samples, strict=True))
    return weighted_quantile(values, areas, 0.99)


def joint_errors(found: HandFrame, true: HandFrame, tips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (5, 3) of joints, mm, and the part of it across the bone, frames and tips (5, 3) in the true rig's."""
    places = [frame.rest_joint_m @ frame.rotation + frame.origin for frame in (found, true)]
    off = places[0] - places[1]
    bone = np.diff(np.concatenate([places[1], tips[:, None]], axis=1), axis=1)
    bone /= np.linalg.norm(bone, axis=2, keepdims=True)
    aside = off - np.einsum("fja,fja->fj", off, bone)[..., None] * bone
    return MM * np.linalg.norm(off, axis=2), MM * np.linalg.norm(aside, axis=2)


def in_frame_of_rig(frame: HandFrame) -> HandFrame:
    """A frame of the scan as one of the rig that the scan was made of."""
    return replace(frame, rotation=frame.rotation @ TURN.as_matrix(), origin=TURN.inv().apply(frame.origin - SHIFT_M))


def measure_scan(scanned: Path, to: Path, folder: Path, scan: str, marks: str) -> dict[str, Any]:
    """Register one scan, fit it and judge it. `to` and the rigged fit of the scanned hand are packs in the folder."""
    from palmar.tools import scan as scan_module

    rig = make_rig(str(scanned), read_skin(scanned))
    files = write_scans(folder, rig)
    made: list[Any] = []
    original = scan_module.rig_of_scan
    scan_module.rig_of_scan = lambda *given: made.append(original(*given)) or made[-1]  # type: ignore[func-returns-value]
    start = time.process_time()
    try:
        fit_hand(files[scan], folder / "scan.pack", scan_to=to, landmarks=files[marks])
    finally:
        scan_module.rig_of_scan = original
    seconds = time.process_time() - start
    frame, at = make_frame("true", rig), in_frame_of_rig(make_frame("scan", made[0][0]))
    tips = np.array([rig.place(f"{finger}-tip") for finger in FINGERS])
    true = load_pack(folder / f"{scanned.stem}.pack").hand
    return {
        "joints_mm": joint_errors(at, frame, tips),
        "residual_mm": made[0][1]["residual_mm"]["all"],
        "left_mm": made[0][1]["left_mm"],
        "p99_mm": judged(load_pack(folder / "scan.pack").hand, at, true, frame),
        "rigged_mm": judged(true, frame, true, frame),
        "cpu_s": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scanned", nargs="?", type=Path, default=HANDS / "godot_hand_right.gltf")
    parser.add_argument("to", nargs="?", type=Path, default=HANDS / "webxr_generic_hand_right.glb")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for hand in (given.scanned, given.to):
            fit_hand(hand, folder / f"{hand.stem}.pack")
        for scan in ("mesh.obj", "cloud.ply"):
            for marks in ("six.json", "all.json"):
                print(f"== {scan}, {marks}")
                tell(measure_scan(given.scanned, folder / f"{given.to.stem}.pack", folder, scan, marks))


def tell(figures: dict[str, Any]) -> None:
    off, aside = figures["joints_mm"]
    for name in ("residual_mm", "left_mm"):
        print(f"  {name}: " + ", ".join(f"{key} {value:.2f}" for key, value in figures[name].items()))
    print(f"  joints mm: median {np.median(off):.2f}, largest {off.max():.2f}; across the bones {np.median(aside):.2f}")
    for finger, row in zip(FINGERS, off, strict=True):
        print(f"    {finger}: " + " ".join(f"{value:.1f}" for value in row))
    rigged = figures["rigged_mm"]
    against = ", ".join(f"{part} {value:.2f} ({rigged[part]:.2f})" for part, value in figures["p99_mm"].items())
    print(f"  p99 mm against the true mesh (rigged fit): {against}; CPU {figures['cpu_s']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
