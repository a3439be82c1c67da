"""What the 3-D replay of a page needs: shapes once, poses at no more than 100 a second, and three.js from trimesh."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.viewer.notebook import scene_to_html

from palmar.errors import PalmarError
from palmar.eval.judge import Poses, phalanx_capsules
from palmar.model import HandModel, SphereTree
from palmar.records import Run

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

FRAME_RATE_HZ = 100.0
MOST_FRAMES = 12_000  # two minutes at the full rate; a longer run is shown at a lower one
MOST_CONTACTS = 16  # of a frame, the strongest
SMOOTH_ABOVE_FACES = 8_000  # a mesh of fewer shows its facets
LIGHT_FACES = 3_000  # of an object that is redrawn while something moves
FINE_FACES = 6_000  # and of one that depth is drawn on

# trimesh's page is one script: three.js as the global THREE, THREE.TrackballControls, a loader, its own start code.
SCRIPT_START = "<script>"
CONTROLS_END = "THREE.TrackballControls=TrackballControls;})();"


def three_js() -> str:
    """Source of three.js with its TrackballControls, as trimesh ships them. Raises PalmarError if it does not."""
    html = scene_to_html(trimesh.Scene(trimesh.creation.box()))
    start, end = html.find(SCRIPT_START), html.find(CONTROLS_END)
    if start < 0 or end < start:
        message = f"trimesh {trimesh.__version__} has no three.js with TrackballControls; trimesh 5.2 has"
        raise PalmarError("E-REPORT-VIEWER", "trimesh.viewer", message)
    return html[start + len(SCRIPT_START) : end + len(CONTROLS_END)]


def pack_array(values: NDArray[Any]) -> dict[str, Any]:
    """An array for the page: little-endian float32 or uint32 in base64, with its shape."""
    dtype = "<u4" if values.dtype.kind in "ui" else "<f4"
    content = np.ascontiguousarray(values, dtype=dtype).tobytes()
    return {"dtype": dtype, "shape": list(values.shape), "base64": base64.b64encode(content).decode("ascii")}


def frame_steps(run: Run, extra: list[int]) -> NDArray[np.int64]:
    """Steps to show: evenly spread at no more than 100 Hz, and the steps in `extra`. (f,) ascending."""
    count = len(run.time_s)
    length_s = float(run.time_s[-1] - run.time_s[0]) if count > 1 else 0.0
    frames = int(np.clip(length_s * FRAME_RATE_HZ + 1, 1, min(MOST_FRAMES, count)))
    even = np.round(np.linspace(0, count - 1, frames)).astype(np.int64)
    return np.unique(np.concatenate([even, np.asarray(extra, dtype=np.int64)]))


def poses(run: Run, steps: NDArray[np.int64]) -> dict[str, Any]:
    """Poses at `steps`, SI, w x y z. Each hand is (f, 27): palm position, palm rotation, 15 flexions, 5 abductions."""
    count = len(steps)
    graphic = [run.palm_position_m, run.palm_rotation_wxyz, run.flexion_rad, run.abduction_rad]
    haptic = [
        run.haptic_palm_position_m,
        run.haptic_palm_rotation_wxyz,
        run.haptic_flexion_rad,
        run.haptic_abduction_rad,
    ]
    return {
        "graphic": pack_array(np.hstack([column[steps].reshape(count, -1) for column in graphic])),
        "haptic": pack_array(np.hstack([column[steps].reshape(count, -1) for column in haptic])),
        "object": pack_array(np.hstack([run.object_position_m[steps], run.object_rotation_wxyz[steps]])),
        "fingertip_force_n": pack_array(run.fingertip_force_n[steps].reshape(count, 15)),
        "contacts": strongest_contacts(run, steps),
    }


def strongest_contacts(run: Run, steps: NDArray[np.int64]) -> dict[str, Any]:
    """Contacts with a force at `steps`: rows start[k] to start[k + 1] of place and of force on user, (c, 3) each."""
    first, count = run.contact_start[steps], run.contact_start[steps + 1] - run.contact_start[steps]
    frame = np.repeat(np.arange(len(steps)), count)
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
    pushing = run.contact_force_n[row] > 0
    frame, row = frame[pushing], row[pushing]
    order = np.lexsort((-run.contact_force_n[row], frame))
    frame, row = frame[order], row[order]
    size = np.bincount(frame, minlength=len(steps))
    kept = np.arange(len(row)) - np.repeat(np.cumsum(size) - size, size) < MOST_CONTACTS
    row, size = row[kept], np.minimum(size, MOST_CONTACTS)
    return {
        "start": pack_array(np.concatenate([[0], np.cumsum(size)]).astype(np.uint32)),
        "point_m": pack_array(run.contact_point_m[row]),
        "force_n": pack_array(run.contact_force_n[row, None] * run.contact_normal[row]),
    }


def hand_shape(hand: HandModel) -> dict[str, Any]:
    """The hand in the palm frame at the zero pose; capsules (15, 8): centre and radius at D, then at E."""
    zero = Poses(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 5, 3)), np.zeros((1, 5)))
    c1, r1, c2, r2 = phalanx_capsules(hand, zero)
    capsules = np.hstack([c1[0], r1[:, None], c2[0], r2[:, None]])
    return {
        "palm_spheres_m": pack_array(hand.palm_spheres_m),
        "joint_m": pack_array(hand.joint_m),
        "flexion_axis": pack_array(hand.flexion_axis),
        "abduction_axis": pack_array(hand.abduction_axis),
        "capsules_m": pack_array(capsules),
        "tip_m": pack_array(c2[0, 2::3]),
    }


def object_shape(tree: SphereTree, level: int) -> dict[str, Any]:
    """The object's true mesh, the spheres of one level, and a coarser mesh for while something moves."""
    vertices, faces = finer(tree.vertices_m, tree.faces.astype(np.int64), FINE_FACES)
    light_vertices, light_faces = coarser(tree.vertices_m, tree.faces.astype(np.int64), LIGHT_FACES)
    return {
        "vertices_m": pack_array(vertices),
        "faces": pack_array(faces.astype(np.uint32)),
        "light_vertices_m": pack_array(light_vertices),
        "light_faces": pack_array(light_faces.astype(np.uint32)),
        "flat": len(tree.faces) < SMOOTH_ABOVE_FACES,
        "spheres_m": pack_array(tree.levels[level]),
    }


def finer(vertices: Array, faces: Faces, least: int) -> tuple[Array, Faces]:
    """The same surface with about `least` triangles or more, so that colours of its vertices can tell places apart."""
    if len(faces) >= least:
        return vertices, faces
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    longest = float(np.sqrt(4 * area / least))
    found = vertices, faces
    for scale in (8.0, 4.0, 2.0, 1.0):  # slivers become many: the last that is not too many
        cut = trimesh.remesh.subdivide_to_size(vertices, faces, scale * longest, max_iter=20)
        if len(cut[1]) > 3 * least:
            break
        found = cut
    return found


def coarser(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """The mesh with `most` triangles at the most: its vertices put together in cells of a grid. For the eye only."""
    if len(faces) <= most:
        return vertices, faces
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    cells, found = 8, (vertices, faces)
    while True:
        cell = np.floor((vertices - low) / size * cells * 0.999).astype(np.int64)
        _, at, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
        triangles = at.ravel()[faces]
        kept = (
            (triangles[:, 0] != triangles[:, 1])
            & (triangles[:, 1] != triangles[:, 2])
            & (triangles[:, 2] != triangles[:, 0])
        )
        if kept.sum() > most:
            return found
        means = np.stack([np.bincount(at.ravel(), vertices[:, k]) / count for k in range(3)], axis=1)
        found, cells = (means, triangles[kept]), cells + 4
