"""From a rig to the palm frame: side, joints, flexion axes and the zero pose, the rig checked against the shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.errors import BadMesh
from palmar.model import FINGERS
from palmar.tools.rig import Rig

Array = NDArray[np.float64]

# From wrist to the middle fingertip: the shortest of a child, the longest of a giant.
SMALLEST_M, LARGEST_M = 0.08, 0.3
AGREES_DEG = 35.0  # a rig's axis that is farther from the shape's is of another convention, and the shape's is taken


@dataclass(frozen=True)
class HandFrame:
    """Joints and axes of a hand in its palm frame: y to the fingertips, z out of the back, origin at the wrist."""

    side: str
    rotation: Array  # (3, 3) palm from file
    origin: Array  # (3,) the wrist in the file's frame, metres
    joint_m: Array  # (5, 3, 3) at the zero pose
    tip_m: Array  # (5, 3) at the zero pose
    flexion_axis: Array  # (5, 3, 3) at the zero pose
    abduction_axis: Array  # (5, 3)
    rest_flexion_rad: Array  # (5, 3) of the rig as its file shows it
    rest_joint_m: Array  # (5, 3, 3)
    axis_error_deg: Array  # (5, 3) between the rig's axis and the shape's
    axis_source: str  # which of the two was taken


def make_frame(where: str, rig: Rig, metres_per_unit: float = 1.0) -> HandFrame:
    """Raises BadMesh where the hand has not the size of one or its names contradict its shape."""
    chain = metres_per_unit * np.array([[rig.place(role) for role in _chain(finger)] for finger in FINGERS])
    wrist = metres_per_unit * rig.place("wrist")
    length = float(np.linalg.norm(np.diff(np.vstack([wrist, chain[2]]), axis=0), axis=1).sum())
    if not SMALLEST_M <= length <= LARGEST_M:
        allowed = f"{1e3 * SMALLEST_M:.0f} to {1e3 * LARGEST_M:.0f} mm is a hand: give --units m, cm or mm"
        raise BadMesh("E-RIG-UNITS", where, f"{1e3 * length:.4g} mm from the wrist to the middle fingertip; {allowed}")
    rotation, side = _palm_frame(chain, wrist)
    if rig.side and rig.side != side:
        found = f"named as of a {rig.side} hand, but its thumb and the way its fingers bend are of a {side} one"
        raise BadMesh("E-RIG-SIDE", where, f"{found}; mend the names, or the mirrored mesh")
    rest = (chain - wrist) @ rotation.T
    turns = rotation @ np.array([[rig.mesh.turn[rig.index[role]] for role in _chain(finger)[:3]] for finger in FINGERS])
    shape_axis = _shape_axes(rest)
    axis, source = _rig_axes(turns, shape_axis) if np.isfinite(turns).all() else (shape_axis, "shape")
    error = np.degrees(np.arccos(np.clip(np.einsum("fja,fja->fj", axis, shape_axis), -1, 1)))
    if np.median(error[1:]) > AGREES_DEG:
        axis, source = shape_axis, "shape"
    before = np.array([_bone_before(rig, finger, metres_per_unit, wrist) @ rotation.T for finger in FINGERS])
    return _zero_pose(side, rotation, wrist, rest, axis, before, error, source)


def _chain(finger: str) -> list[str]:
    parts = ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
    return [f"{finger}-{part}" for part in (*parts, "tip")]


def _bone_before(rig: Rig, finger: str, scale: float, wrist: Array) -> Array:
    """From the start of a finger's metacarpal, or from the wrist, to its first joint, in the file's frame."""
    first = scale * rig.place(_chain(finger)[0])
    role = f"{finger}-metacarpal"
    start = scale * rig.place(role) if finger != "thumb" and role in rig.index else wrist
    return first - start


def _palm_frame(chain: Array, wrist: Array) -> tuple[Array, str]:
    """Palm from file (3, 3), and the side. The inner side is where the thumb stands off and the fingers are bent to."""
    y = _unit(chain[2, 0] - wrist)
    across = chain[1, 0] - chain[4, 0]
    across = _unit(across - (across @ y) * y)
    z = np.cross(across, y)
    bones = np.diff(chain, axis=1)
    bones /= np.linalg.norm(bones, axis=2, keepdims=True)
    # Fingers bent inwards: later bones lean to the inner side; and so does the thumb, from the knuckles' plane.
    inward = -(bones[1:, 2] - bones[1:, 0]) @ z
    thumb = -(chain[0, 3] - chain[1:, 0].mean(axis=0)) @ z / np.linalg.norm(chain[2, 0] - wrist)
    if inward.sum() + thumb < 0:
        z = -z
    x = np.cross(y, z)
    return np.array([x, y, z]), "right" if x @ across < 0 else "left"


def _shape_axes(rest: Array) -> Array:
    """Flexion axes (5, 3, 3) from the chains of joints alone: across each bone and the plane the finger bends in."""
    axes = np.empty((5, 3, 3))
    ulnar = np.sign(rest[4, 0, 0] - rest[1, 0, 0])
    for f in range(5):
        # A finger bends into the palm, a thumb across it.
        towards = np.array([0.75 * ulnar, 0.15, -0.65]) if f == 0 else np.array([0.0, 0.0, -1.0])
        bone = np.diff(rest[f], axis=0)
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        # The finger's own plane, the surer the more it is bent, beside the plane across the palm.
        bend = np.cross(bone[0], bone[1]) + np.cross(bone[1], bone[2])
        usual = _unit(np.cross(bone[1], towards))
        weight = np.clip(bend @ usual / 0.5, 0, 1)
        mixed = weight * bend / max(np.linalg.norm(bend), 1e-9) + (1 - weight) * usual
        for j in range(3):
            axes[f, j] = _unit(mixed - (mixed @ bone[j]) * bone[j])
    return axes


def _rig_axes(turns: Array, shape_axis: Array) -> tuple[Array, str]:
    """The local axis of the joints, the same one for all of them, that agrees best with the shape's flexion axes."""
    agree = np.einsum("fjab,fja->fjb", turns[1:], shape_axis[1:])
    best = int(np.argmax(np.abs(agree.sum(axis=(0, 1)))))
    sign = np.sign(agree[..., best].sum())
    return sign * turns[..., best], f"rig, its {'-' if sign < 0 else ''}{'xyz'[best]}"


def _zero_pose(
    side: str, rotation: Array, wrist: Array, rest: Array, axis: Array, before: Array, error: Array, source: str
) -> HandFrame:
    """Straighten each finger about its flexion axes: then all angles are zero."""
    flexion = np.zeros((5, 3))
    joint, tip, zero_axis = np.empty((5, 3, 3)), np.empty((5, 3)), np.empty((5, 3, 3))
    for f in range(5):
        bones = np.vstack([before[f], np.diff(rest[f], axis=0)])
        for j in range(3):
            if f or j:  # a thumb's root has no straight pose of its own
                flexion[f, j] = _angle(bones[j], bones[j + 1], axis[f, j])
        # World turn of each link of the rest pose, from the zero pose: outwards, each about its axis at rest.
        turn, at = np.eye(3), rest[f, 0]
        for j in range(3):
            joint[f, j], zero_axis[f, j] = at, turn.T @ axis[f, j]
            turn = turn @ Rotation.from_rotvec(flexion[f, j] * zero_axis[f, j]).as_matrix()
            at = at + turn.T @ (rest[f, j + 1] - rest[f, j])
        tip[f] = at
    radial = rest[1, 0] - rest[4, 0]
    return HandFrame(
        side=side,
        rotation=rotation,
        origin=wrist,
        joint_m=joint,
        tip_m=tip,
        flexion_axis=zero_axis,
        abduction_axis=_abduction_axes(joint, tip, zero_axis, radial),
        rest_flexion_rad=flexion,
        rest_joint_m=rest[:, :3],
        axis_error_deg=error,
        axis_source=source,
    )


def _abduction_axes(joint: Array, tip: Array, axis: Array, radial: Array) -> Array:
    """Across each finger and its first flexion axis; a positive abduction goes to the thumb's side."""
    direction = joint[:, 1] - joint[:, 0]
    across = np.cross(direction, axis[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    towards = np.einsum("fa,a->f", np.cross(across, direction), radial)
    return np.where(towards[:, None] > 0, across, -across)


def _angle(a: Array, b: Array, axis: Array) -> float:
    """From direction a to b about the axis, in the plane across it."""
    return float(np.arctan2(axis @ np.cross(a, b), a @ b - (a @ axis) * (b @ axis)))


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
