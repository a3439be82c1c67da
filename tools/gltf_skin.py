"""A rigged mesh out of a GLB or glTF file: triangles, joints where the file shows them, and skin weights."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.errors import BadMesh
from palmar.tools.mesh import MAX_BYTES, READER_FAILURES
from palmar.tools.mesh_glb import glb_values

Array = NDArray[np.float64]

MAX_JOINTS = 1000
WEIGHT_SUM = 0.02  # that the weights of a vertex may be off 1 by: what 8-bit weights round to


@dataclass(frozen=True)
class SkinnedMesh:
    """One skinned mesh as the file shows it, in the file's unit and world frame. v vertices, f faces, j joints."""

    vertices: Array  # (v, 3) as shown: each joint where its node is
    faces: NDArray[np.int32]  # (f, 3)
    uv: Array | None  # (v, 2) of the first texture, or None
    weights: Array  # (v, j), rows sum to 1
    names: tuple[str, ...]  # (j,)
    parents: tuple[int, ...]  # (j,) nearest joint above, -1 without one
    joint: Array  # (j, 3)
    turn: Array  # (j, 3, 3) columns: the joint's own x, y, z axes
    source: str  # file name
    sha256: str  # of the file's bytes


def read_skin(path: str | Path) -> SkinnedMesh:
    """The skinned mesh of a .glb or .gltf file. Buffers in other files are not opened.

    Raises BadMesh with a code E-RIG-*: no skin, several skinned meshes that do not share one skin, joints in a circle,
    weights or places that are not finite numbers.
    """
    where = str(path)
    if Path(path).suffix.lower() not in (".glb", ".gltf"):
        raise BadMesh("E-RIG-FORMAT", where, f"{Path(path).suffix or 'no'!r} extension; .glb and .gltf are read")
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise BadMesh("E-MESH-LIMIT", where, f"{Path(path).stat().st_size} bytes; at most {MAX_BYTES} are read")
        raw = Path(path).read_bytes()
    except OSError as error:
        raise BadMesh("E-MESH-MISSING", where, f"{error.strerror}; a rigged hand is needed") from None
    tree, binary = _open(where, raw)
    try:
        return _assemble(where, tree, binary, Path(path).name, hashlib.sha256(raw).hexdigest())
    except READER_FAILURES as error:
        raise BadMesh("E-RIG-FORMAT", where, f"its JSON is not that of a glTF 2 scene ({error!r})") from None


def _open(where: str, raw: bytes) -> tuple[dict[str, Any], bytes]:
    """The scene as plain dicts, and its one buffer."""
    import pygltflib

    try:
        if raw[:4] == b"glTF":
            scene = pygltflib.GLTF2().load_from_bytes(raw)
        else:
            scene = pygltflib.GLTF2.from_json(raw.decode("utf-8"), infer_missing=True)
        if scene is None:
            raise ValueError("not a glTF 2 file")
        for buffer in scene.buffers:
            if buffer.uri and not buffer.uri.startswith("data:"):
                found = f"a buffer in {buffer.uri[:40]!r}; side files are never opened: export as GLB"
                raise BadMesh("E-MESH-PATH", where, found)
        if len(scene.buffers) > 1:
            raise BadMesh("E-RIG-FORMAT", where, f"{len(scene.buffers)} buffers; one is read: export as GLB")
        packed = [n for n in scene.extensionsRequired or [] if "compression" in n or "quantization" in n]
        if packed:
            raise BadMesh("E-MESH-FORMAT", where, f"{packed[0]} is not read; export without compression")
        scene.convert_buffers(pygltflib.BufferFormat.BINARYBLOB)
        binary = scene.binary_blob() or b""
    except (*READER_FAILURES, EOFError) as error:
        reason = " ".join(str(error).split())[:120]
        raise BadMesh("E-RIG-FORMAT", where, f"the glTF reader gave up ({reason})") from None
    return json.loads(scene.to_json()), binary


def _assemble(where: str, tree: dict[str, Any], binary: bytes, source: str, sha256: str) -> SkinnedMesh:
    nodes = tree.get("nodes", [])
    skinned = [node for node in nodes if node.get("mesh") is not None and node.get("skin") is not None]
    if not skinned:
        _raise(where, "no mesh with a skin; a hand with joints and skin weights is needed, or its joints as a file")
    skins = {node["skin"] for node in skinned}
    if len(skins) > 1:
        _raise(where, f"{len(skins)} skins; a file with one hand is needed")
    skin = tree["skins"][skins.pop()]
    joints = skin["joints"]
    if not 1 <= len(joints) <= MAX_JOINTS or len(set(joints)) != len(joints):
        _raise(where, f"{len(joints)} joints in the skin; 1 to {MAX_JOINTS}, each once, are read")
    world, above = _places(where, nodes)
    names = tuple(str(nodes[j].get("name") or f"joint {j}") for j in joints)
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if skin.get("inverseBindMatrices") is not None:
        stored = glb_values(where, tree, binary, skin["inverseBindMatrices"]).astype(np.float64)
        bind = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    if len(bind) != len(joints) or not (np.isfinite(bind).all() and np.isfinite(world[joints]).all()):
        _raise(where, "places of joints that are not finite numbers, or not one for each joint")
    parts = [
        _primitive(where, tree, binary, primitive, len(joints))
        for node in skinned
        for primitive in tree["meshes"][node["mesh"]]["primitives"]
    ]
    starts = np.cumsum([0, *(len(points) for points, _, _, _ in parts)])
    points = np.concatenate([points for points, _, _, _ in parts])
    weights = np.concatenate([weights for _, weights, _, _ in parts])
    faces = np.concatenate([faces + start for (_, _, faces, _), start in zip(parts, starts, strict=False)])
    uv = None if any(uv is None for *_, uv in parts) else np.concatenate([uv for *_, uv in parts if uv is not None])
    shown = np.einsum("vj,jab,vb->va", weights, (world[joints] @ bind)[:, :3], np.c_[points, np.ones(len(points))])
    turn = world[joints][:, :3, :3]
    size = np.linalg.norm(turn, axis=1)
    if not (size > 0).all():
        _raise(where, "a joint that is scaled to nothing; scales above 0 are needed")
    return SkinnedMesh(
        vertices=shown,
        faces=faces.astype(np.int32),
        uv=uv,
        weights=weights,
        names=names,
        parents=tuple(_joint_above(above, joints, j) for j in joints),
        joint=world[joints][:, :3, 3],
        turn=turn / size[:, None],
        source=source,
        sha256=sha256,
    )


def _places(where: str, nodes: list[dict[str, Any]]) -> tuple[Array, list[int]]:
    """World from node (n, 4, 4), and the node above each or -1. Raises BadMesh where nodes go in a circle."""
    above = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.get("children") or []:
            if not 0 <= child < len(nodes) or above[child] >= 0:
                _raise(f"{where}:node {number}", f"child {child} is missing or has two parents")
            above[child] = number
    world = np.empty((len(nodes), 4, 4))
    done = [False] * len(nodes)
    for number in range(len(nodes)):
        chain = []
        while number >= 0 and not done[number]:
            if number in chain:
                _raise(f"{where}:node {number}", f"{nodes[number].get('name')!r} is its own ancestor; a tree is needed")
            chain.append(number)
            number = above[number]
        for k in reversed(chain):
            own = _own_place(nodes[k])
            world[k] = own if above[k] < 0 else world[above[k]] @ own
            done[k] = True
    return world, above


def _own_place(node: dict[str, Any]) -> Array:
    """Parent from node (4, 4)."""
    if node.get("matrix"):
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    place = np.eye(4)
    if node.get("rotation"):
        place[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    if node.get("scale"):
        place[:3, :3] *= np.array(node["scale"], dtype=np.float64)
    if node.get("translation"):
        place[:3, 3] = node["translation"]
    return place


def _joint_above(above: list[int], joints: list[int], node: int) -> int:
    node = above[node]
    while node >= 0 and node not in joints:
        node = above[node]
    return joints.index(node) if node >= 0 else -1


def _primitive(
    where: str, tree: dict[str, Any], binary: bytes, primitive: dict[str, Any], joints: int
) -> tuple[Array, Array, NDArray[np.int64], Array | None]:
    """Points (v, 3), weights (v, j), faces (f, 3) and texture coordinates (v, 2) or None of one primitive."""
    if primitive.get("mode") not in (None, 4):
        raise BadMesh("E-MESH-FORMAT", where, "only plain triangles are read; export without strips, lines and points")
    having = {key: number for key, number in primitive["attributes"].items() if number is not None}
    if "JOINTS_0" not in having or "WEIGHTS_0" not in having:
        _raise(where, "a mesh without skin weights; every part of the hand needs them")

    def values(key: str) -> Array:
        read = glb_values(where, tree, binary, having[key])
        if read.dtype.kind == "u" and not key.startswith("JOINTS"):
            return read / np.iinfo(read.dtype).max
        return read.astype(np.float64)

    points = values("POSITION")
    uv = values("TEXCOORD_0") if "TEXCOORD_0" in having else None
    sets = [key.removeprefix("WEIGHTS_") for key in having if key.startswith("WEIGHTS_")]
    weights = np.zeros((len(points), joints))
    for number in sets:
        joint, weight = values(f"JOINTS_{number}").astype(np.int64), values(f"WEIGHTS_{number}")
        if len(joint) != len(points) or len(weight) != len(points) or weight.shape != joint.shape:
            _raise(where, f"{len(points)} vertices, {len(joint)} rows of joints, {len(weight)} of weights")
        if joint.min() < 0 or joint.max() >= joints:
            _raise(where, f"a weight of joint {int(joint.max())}; the skin has 0 to {joints - 1}")
        for column in range(joint.shape[1]):
            np.add.at(weights, (np.arange(len(points)), joint[:, column]), weight[:, column])
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1) | ~np.isfinite(weights).all(axis=1))
    if len(bad):
        _raise(f"{where}:vertex {bad[0]}", "place or weights are not finite numbers")
    total = weights.sum(axis=1)
    bad = np.flatnonzero((np.abs(total - 1) > WEIGHT_SUM) | (weights.min(axis=1) < 0))
    if len(bad):
        _raise(f"{where}:vertex {bad[0]}", f"weights that sum to {total[bad[0]]:.3g}; 0 or more each, 1 in sum")
    if primitive.get("indices") is None:
        faces = np.arange(len(points))
    else:
        faces = glb_values(where, tree, binary, primitive["indices"]).ravel().astype(np.int64)
    if len(faces) % 3 or not len(faces) or faces.max() >= len(points):
        raise BadMesh("E-MESH-INDEX", where, f"{len(faces)} corners over {len(points)} vertices; 3 a triangle")
    return points, weights / total[:, None], faces.reshape(-1, 3), uv


def _raise(where: str, message: str) -> NoReturn:
    raise BadMesh("E-RIG", where, message)
