"""What a pack holds: one HandModel and named objects, each a SphereTree with its true mesh. Format: docs/formats.md."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.pack_check import HAND_MESH, HAND_SHAPES, PACK_SCHEMA, check_pack
from palmar.skin import HandMesh

FINGERS = ("thumb", "index", "middle", "ring", "little")
JOINTS = ("MCP", "PIP", "DIP")

Array = NDArray[np.float64]

# PIP per MCP and DIP per PIP of each finger; why these numbers: docs/hand_toml.md.
DEFAULT_COUPLING = ((1.0, 1.6), (1.11, 0.667), (1.11, 0.667), (1.11, 0.667), (1.11, 0.667))


def default_coupling() -> Array:
    """`flexion_coupling` of a hand that gives none."""
    return np.array(DEFAULT_COUPLING)


@dataclass(frozen=True)
class HandModel:
    """The hybrid hand: palm spheres and fifteen tapered phalanges, in the palm frame at the zero pose. SI units."""

    palm_spheres_m: Array  # (p, 4)
    joint_m: Array  # (5, 3, 3)
    flexion_axis: Array  # (5, 3, 3)
    abduction_axis: Array  # (5, 3)
    phalanx_m: Array  # (5, 3, 2, 3)
    phalanx_radius_m: Array  # (5, 3, 2)
    flexion_limit_rad: Array  # (5, 3, 2)
    abduction_limit_rad: Array  # (5, 2)
    joint_stiffness_n_m_per_rad: Array  # (5, 3)
    palm_stiffness_n_per_m: Array  # (1,)
    palm_rotation_stiffness_n_m_per_rad: Array  # (1,)
    flexion_coupling: Array = field(default_factory=default_coupling)  # (5, 2), see palmar.coupling
    about: dict[str, Any] = field(default_factory=dict)  # name, side, source, sha256
    mesh: HandMesh | None = None  # the surface that it was fitted to; it follows joints and axes of this hand only


@dataclass(frozen=True)
class Bounds:
    """Balls over the spheres of one level, for search. Each contains what stands below it, in float64 and float32."""

    balls_m: Array  # (m, 4): root first, siblings side by side
    parent: NDArray[np.int32]  # (m,): ball that contains this one; -1 of the root
    sphere_parent: NDArray[np.int32]  # (n,): ball that contains this sphere of the level


@dataclass(frozen=True)
class SphereTree:
    """One body as levels of spheres, coarse to fine, each a shape of its own; the last, the leaves, is the finest."""

    levels: list[Array]  # each (n_k, 4): x, y, z, radius in metres
    bounds: list[Bounds]  # over each level
    vertices_m: Array  # (v, 3) the true mesh
    faces: NDArray[np.int32]  # (f, 3)
    about: dict[str, Any] = field(default_factory=dict)  # source, sha256, parameters, errors of each level

    @property
    def leaves(self) -> Array:
        return self.levels[-1]


@dataclass(frozen=True)
class AssetPack:
    """One HandModel and named objects."""

    hand: HandModel
    objects: dict[str, SphereTree]
    manifest: dict[str, Any]
    sha256: str = ""


def save_pack(path: str | Path, pack: AssetPack) -> str:
    """Write a pack and return its sha256. The file appears whole or not at all.

    The manifest's "hand" and "objects" are taken from `about` of each part. Raises BadPack if the content breaks the
    format.
    """
    from safetensors.numpy import save

    tensors: dict[str, NDArray[Any]] = {}
    for name in HAND_SHAPES:
        tensors[f"hand/{name}"] = np.ascontiguousarray(getattr(pack.hand, name), dtype=np.float64)
    for name, (_, dtype) in HAND_MESH.items():
        if pack.hand.mesh is not None:
            tensors[f"hand/mesh/{name}"] = np.ascontiguousarray(getattr(pack.hand.mesh, name), dtype=dtype)
    for name, tree in pack.objects.items():
        for k, (spheres, bounds) in enumerate(zip(tree.levels, tree.bounds, strict=True)):
            level = f"object/{name}/level_{k}"
            tensors[f"{level}/spheres_m"] = np.ascontiguousarray(spheres, dtype=np.float64)
            tensors[f"{level}/parent"] = np.ascontiguousarray(bounds.sphere_parent, dtype=np.int32)
            tensors[f"{level}/bounds_m"] = np.ascontiguousarray(bounds.balls_m, dtype=np.float64)
            tensors[f"{level}/bounds_parent"] = np.ascontiguousarray(bounds.parent, dtype=np.int32)
        tensors[f"object/{name}/vertices_m"] = np.ascontiguousarray(tree.vertices_m, dtype=np.float64)
        tensors[f"object/{name}/faces"] = np.ascontiguousarray(tree.faces, dtype=np.int32)
    manifest = dict(pack.manifest)
    manifest["schema"] = PACK_SCHEMA
    manifest["hand"] = pack.hand.about
    manifest["objects"] = {name: tree.about for name, tree in pack.objects.items()}
    check_pack(str(path), tensors, manifest)
    manifest["crc32"] = "00000000"
    content = save(tensors, {"palmar": json.dumps(manifest, sort_keys=True, allow_nan=False)})
    at, digits = _crc32_of(content)
    content = content[:at] + digits + content[at + len(digits) :]
    write_whole(path, content)
    return hashlib.sha256(content).hexdigest()


def load_pack(path: str | Path) -> AssetPack:
    """Read a pack. Raises BadPack that names the file, the tensor and what is allowed."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    where = str(path)
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise BadPack(
            "E-PACK-MISSING", where, f"{error.strerror}; a file written by `palmar build` is needed"
        ) from None
    try:
        tensors = load(content)
        length = int.from_bytes(content[:8], "little")
        metadata = json.loads(content[8 : 8 + length]).get("__metadata__", {})
    except (SafetensorError, ValueError) as error:
        raise BadPack("E-PACK-FORMAT", where, f"not a whole safetensors file ({error})") from None
    try:
        manifest = json.loads(metadata["palmar"])
    except (KeyError, ValueError):
        raise BadPack("E-PACK-FORMAT", where, "no manifest under the metadata key `palmar`") from None
    at, digits = _crc32_of(content)
    if content[at : at + len(digits)] != digits:
        raise BadPack("E-PACK-CRC", where, "the file is damaged: its bytes do not fit their checksum")
    check_pack(where, tensors, manifest)
    manifest.pop("crc32", None)

    parts = {name: tensors[f"hand/{name}"] for name in HAND_SHAPES if f"hand/{name}" in tensors}
    mesh = None
    if "hand/mesh/faces" in tensors:
        mesh = HandMesh(**{name: tensors[f"hand/mesh/{name}"] for name in HAND_MESH})
    hand = HandModel(**parts, about=manifest["hand"], mesh=mesh)
    objects = {}
    for name, about in manifest["objects"].items():
        count = len(about["levels"])
        objects[name] = SphereTree(
            levels=[tensors[f"object/{name}/level_{k}/spheres_m"] for k in range(count)],
            bounds=[
                Bounds(
                    *(tensors[f"object/{name}/level_{k}/{part}"] for part in ("bounds_m", "bounds_parent", "parent"))
                )
                for k in range(count)
            ],
            vertices_m=tensors[f"object/{name}/vertices_m"],
            faces=tensors[f"object/{name}/faces"],
            about=about,
        )
    return AssetPack(hand, objects, manifest, hashlib.sha256(content).hexdigest())


def _crc32_of(content: bytes) -> tuple[int, bytes]:
    """Where a pack's eight digits of `crc32` stand, and what they must be: the CRC of the file with zeros there.

    Packs of other tools may have none: then no digits.
    """
    mark = rb"\"crc32\": \""  # in JSON inside JSON
    start = content.find(mark, 0, 8 + int.from_bytes(content[:8], "little"))
    if start < 0:
        return 0, b""
    at = start + len(mark)
    crc = zlib.crc32(content[at + 8 :], zlib.crc32(b"00000000", zlib.crc32(content[:at])))
    return at, f"{crc:08x}".encode()


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file so that it appears under its name only when it is complete."""
    path = Path(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(content)
        # mkstemp makes files private; a result is shared like any other file.
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
