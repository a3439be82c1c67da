"""A rigged hand that is known: the capsules and palm balls of a model as one mesh with noise, written as GLB."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from manifold3d import Manifold, OpType
from scipy.spatial.transform import Rotation

from palmar.model import FINGERS, HandModel
from palmar.tools.capsule_fit import capsule_gap
from palmar.tools.hand_quality import capsules_of

BLEND_M = 0.004  # over which a joint's skin goes from one phalanx to the next


@pytest.fixture(scope="session")
def make_rigged():
    """`make_rigged_hand` below."""
    return make_rigged_hand


@pytest.fixture(scope="session")
def write_rigged():
    """`write_glb` below."""
    return write_glb


def names_of() -> list[tuple[str, int]]:
    """Joints in the order of the file with the link that each moves."""
    names = [("wrist", 0)]
    for f, finger in enumerate(FINGERS):
        parts = ("metacarpal", "proximal", "distal") if f == 0 else ("proximal", "intermediate", "distal")
        names += [(f"{finger}-{part}", 1 + 3 * f + j) for j, part in enumerate(parts)]
        names.append((f"{finger}-tip", 1 + 3 * f + 2))
    return names


def make_rigged_hand(hand: HandModel, noise_m: float = 0.0, edge_m: float = 0.0025, seed: int = 0) -> dict:
    """vertices, faces, weights (v, j), joints (j, 3), turns (j, 3, 3) whose -x is the flexion axis, names."""
    solid = Manifold.batch_boolean([_capsule(row) for row in capsules_of(hand)] + _palm(hand), OpType.Add)
    mesh = solid.refine_to_length(edge_m).to_mesh64()
    vertices, faces = np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts).astype(np.int64)
    weights = _weights(hand, vertices)
    corners = vertices[faces]
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    vertices = vertices + noise_m * np.random.default_rng(seed).normal(size=len(vertices))[:, None] * normals
    joints, turns = [np.zeros(3)], [np.eye(3)]
    for f in range(5):
        for j in range(3):
            bone = hand.phalanx_m[f, j, 1] - hand.phalanx_m[f, j, 0]
            x = -hand.flexion_axis[f, j]
            z = -(bone - (bone @ x) * x)
            z /= np.linalg.norm(z)
            joints.append(hand.joint_m[f, j])
            turns.append(np.stack([x, np.cross(z, x), z], axis=1))
        joints.append(capsules_of(hand)[3 * f + 2, 3:6])
        turns.append(turns[-1])
    names = [name for name, _ in names_of()]
    full = np.zeros((len(vertices), len(names)))
    for number, (name, link) in enumerate(names_of()):
        if not name.endswith("tip"):
            full[:, number] = weights[:, link]
    return {
        "vertices": vertices,
        "faces": faces,
        "weights": full,
        "joints": np.array(joints),
        "turns": np.array(turns),
        "names": names,
    }


def _capsule(row: np.ndarray) -> Manifold:
    balls = [Manifold.sphere(r, 32).translate(tuple(c)) for c, r in ((row[:3], row[6]), (row[3:6], row[7]))]
    return Manifold.batch_hull(balls)


def _palm(hand: HandModel) -> list[Manifold]:
    return [Manifold.sphere(r, 16).translate((x, y, z)) for x, y, z, r in hand.palm_spheres_m]


def _weights(hand: HandModel, vertices: np.ndarray) -> np.ndarray:
    """Each vertex to the nearest shape, blended across the two joints of a finger that lie outside the palm."""
    rows = capsules_of(hand)
    gap = np.stack([capsule_gap(row[:6].reshape(2, 3), row[6:], vertices)[0] for row in rows], axis=1)
    spheres = hand.palm_spheres_m
    palm = (np.linalg.norm(vertices[:, None] - spheres[None, :, :3], axis=2) - spheres[:, 3]).min(axis=1)
    nearest = np.where(palm < gap.min(axis=1) + 1e-5, 0, 1 + gap.argmin(axis=1))
    weights = np.eye(16)[nearest]
    for f in range(5):
        of = np.flatnonzero((nearest > 3 * f) & (nearest <= 3 * f + 3))
        bone = hand.phalanx_m[f, 0, 1] - hand.phalanx_m[f, 0, 0]
        bone = bone / np.linalg.norm(bone)
        past = [np.clip((vertices[of] - hand.joint_m[f, j]) @ bone / BLEND_M + 0.5, 0, 1) for j in (1, 2)]
        weights[of] = 0
        weights[of, 1 + 3 * f] = 1 - past[0]
        weights[of, 2 + 3 * f] = past[0] * (1 - past[1])
        weights[of, 3 + 3 * f] = past[0] * past[1]
    return weights


def write_glb(path: Path, rigged: dict, change=lambda tree: None, scale: float = 1.0) -> Path:
    """Write it; change(tree) may spoil the JSON before that."""
    order = np.argsort(-rigged["weights"], axis=1)[:, :4]
    picked = np.take_along_axis(rigged["weights"], order, axis=1)
    bind = np.tile(np.eye(4), (len(rigged["names"]), 1, 1))
    bind[:, :3, :3] = rigged["turns"]
    bind[:, :3, 3] = scale * rigged["joints"]
    arrays = [
        (scale * rigged["vertices"]).astype("<f4"),
        order.astype("<u2"),
        picked.astype("<f4"),
        rigged["faces"].astype("<u4").reshape(-1, 1),
        np.linalg.inv(bind).transpose(0, 2, 1).reshape(-1, 16).astype("<f4"),
    ]
    types = [("VEC3", 5126), ("VEC4", 5123), ("VEC4", 5126), ("SCALAR", 5125), ("MAT4", 5126)]
    binary, views, accessors = b"", [], []
    for number, (array, (kind, component)) in enumerate(zip(arrays, types, strict=True)):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        accessors.append({"bufferView": number, "componentType": component, "count": len(array), "type": kind})
        binary += array.tobytes()
    nodes = [
        {"name": name, "translation": place[:3, 3].tolist(), "rotation": Rotation.from_matrix(turn).as_quat().tolist()}
        for name, place, turn in zip(rigged["names"], bind, rigged["turns"], strict=True)
    ]
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(len(nodes) + 1))}],
        "scene": 0,
        "nodes": [*nodes, {"name": "mesh", "mesh": 0, "skin": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "skins": [{"joints": list(range(len(nodes))), "inverseBindMatrices": 4}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path
