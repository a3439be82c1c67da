"""The pack's format as a table, and the one check of it: after reading and before writing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.skin import LINKS

PACK_SCHEMA = "palmar.pack/2"
MAX_NAME = 100  # bytes of an object's name
HAND_SHAPES: dict[str, tuple[int | None, ...]] = {
    "palm_spheres_m": (None, 4),
    "joint_m": (5, 3, 3),
    "flexion_axis": (5, 3, 3),
    "abduction_axis": (5, 3),
    "phalanx_m": (5, 3, 2, 3),
    "phalanx_radius_m": (5, 3, 2),
    "flexion_limit_rad": (5, 3, 2),
    "abduction_limit_rad": (5, 2),
    "joint_stiffness_n_m_per_rad": (5, 3),
    "palm_stiffness_n_per_m": (1,),
    "palm_rotation_stiffness_n_m_per_rad": (1,),
    "flexion_coupling": (5, 2),
}
# A hand without a coupling gets the default.
MAY_BE_MISSING = {"hand/flexion_coupling"}
# All of them or none.
HAND_MESH: dict[str, tuple[tuple[int | None, ...], str]] = {
    "vertices_m": ((None, 3), "float64"),
    "faces": ((None, 3), "int32"),
    "weights": ((None, LINKS), "float64"),
    "flexion_rad": ((5, 3), "float64"),
}
# Of an object that was tuned (docs/formats.md): what stands in its part of the manifest.
TUNED = "tuned"
TUNED_SCHEMA = "palmar.tuned/1"
TUNED_FIELDS: dict[str, type | tuple[type, ...]] = {
    "full_sha256": str,
    "full_spheres": int,
    "traces": list,
    "guard_mm": (int, float),
    "fine_mm": (int, float),
    "rest_mm": (int, float),
    "share_seen": (int, float),
    "left_out": list,
    "settings": dict,
    "seen": list,
}
PARTS = ("palm", "thumb", "index", "middle", "ring", "little")  # of a hand, that a lean pack may leave out
# Balls are made to contain what is below them in float32 too; rounding of this check is far below.
CONTAINED_M = 1e-12


def is_object_name(name: str) -> bool:
    """True for 1 to 100 bytes that can be printed, without /: a name becomes part of a file's name."""
    return bool(name) and "/" not in name and name.isprintable() and len(name.encode()) <= MAX_NAME


def check_pack(where: str, tensors: dict[str, NDArray[Any]], manifest: Any) -> None:
    """Raise BadPack unless names, shapes, values and trees are what docs/formats.md says."""
    check_manifest(where, manifest)
    expected: dict[str, tuple[tuple[int | None, ...], str]] = {
        f"hand/{name}": (shape, "float64") for name, shape in HAND_SHAPES.items()
    }
    for name, about in manifest["objects"].items():
        for k in range(len(about["levels"])):
            expected[f"object/{name}/level_{k}/spheres_m"] = ((None, 4), "float64")
            expected[f"object/{name}/level_{k}/parent"] = ((None,), "int32")
            expected[f"object/{name}/level_{k}/bounds_m"] = ((None, 4), "float64")
            expected[f"object/{name}/level_{k}/bounds_parent"] = ((None,), "int32")
        expected[f"object/{name}/vertices_m"] = ((None, 3), "float64")
        expected[f"object/{name}/faces"] = ((None, 3), "int32")
    for name in MAY_BE_MISSING - tensors.keys():
        del expected[name]
    if any(name.startswith("hand/mesh/") for name in tensors):
        expected |= {f"hand/mesh/{name}": shape_and_type for name, shape_and_type in HAND_MESH.items()}
    for name in expected.keys() - tensors.keys():
        raise BadPack("E-PACK-MISSING", f"{where}:{name}", "tensor is not in the file")
    for name in tensors.keys() - expected.keys():
        raise BadPack("E-PACK-EXTRA", f"{where}:{name}", "tensor is not part of the format")
    for name, (shape, dtype) in expected.items():
        check_tensor(f"{where}:{name}", tensors[name], shape, dtype)
    for name, about in manifest["objects"].items():
        place = f"object/{name}"
        check_faces(f"{where}:{place}/faces", tensors[f"{place}/faces"], len(tensors[f"{place}/vertices_m"]))
        for k in range(len(about["levels"])):
            level = f"{place}/level_{k}"
            parts = (tensors[f"{level}/{part}"] for part in ("spheres_m", "parent", "bounds_m", "bounds_parent"))
            check_bounds(f"{where}:{level}", *parts)


def check_manifest(where: str, manifest: Any) -> None:
    """Raise BadPack unless hand, objects and their levels are there in the form that all readers rely on."""
    schema = manifest.get("schema") if isinstance(manifest, dict) else None
    if schema != PACK_SCHEMA:
        raise BadPack("E-PACK-VERSION", where, f"schema {schema!r}; this version reads {PACK_SCHEMA!r}")
    for key in ("hand", "objects"):
        if not isinstance(manifest.get(key), dict):
            raise BadPack("E-PACK-FORMAT", f"{where}:{key}", "the manifest has no table of this name")
    for name, about in manifest["objects"].items():
        if not is_object_name(name):
            found = f"{name[:40]!r}; 1 to {MAX_NAME} bytes that can be printed, no /, are allowed"
            raise BadPack("E-PACK-NAME", f"{where}:objects", found)
        if not isinstance(about, dict) or not isinstance(about.get("levels"), list) or not about["levels"]:
            raise BadPack("E-PACK-FORMAT", f"{where}:{name}", "the manifest names no levels of this object")
        if TUNED in about:
            check_tuned(f"{where}:{name}/{TUNED}", about[TUNED])


def check_tuned(where: str, tuned: Any) -> None:
    """Raise BadPack unless what a lean pack says of its tuning has every field. What settings mean the core checks."""
    schema = tuned.get("schema") if isinstance(tuned, dict) else None
    if schema != TUNED_SCHEMA:
        raise BadPack("E-PACK-VERSION", where, f"schema {schema!r}; this version reads {TUNED_SCHEMA!r}")
    for key, kind in TUNED_FIELDS.items():
        if not isinstance(tuned.get(key), kind) or isinstance(tuned[key], bool):
            raise BadPack("E-PACK-FORMAT", f"{where}:{key}", f"{str(tuned.get(key))[:40]!r}; see docs/formats.md")
    tables = [trace if isinstance(trace, dict) else {} for trace in tuned["traces"]]
    of_traces = [table.get(key) for table in tables for key in ("name", "sha256")]
    seen = tuned["seen"]
    if not all(isinstance(text, str) for text in of_traces):
        raise BadPack("E-PACK-FORMAT", f"{where}:traces", "a name and a sha256 of each are needed, as texts")
    for part in tuned["left_out"]:
        if part not in PARTS:
            raise BadPack("E-PACK-FORMAT", f"{where}:left_out", f"{str(part)[:40]!r}; there are {', '.join(PARTS)}")
    if len(seen) % 4 or not all(type(number) is int and abs(number) < 2**31 for number in seen):
        raise BadPack("E-PACK-FORMAT", f"{where}:seen", "four whole numbers a ball are needed")


def check_tensor(where: str, tensor: NDArray[Any], shape: tuple[int | None, ...], dtype: str) -> None:
    """Raise BadPack unless shape (None: any) and type fit, numbers are finite and radii of spheres above 0."""
    fits = tensor.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(tensor.shape, shape, strict=True)
    )
    if not fits or tensor.dtype != dtype:
        raise BadPack("E-PACK-SHAPE", where, f"{tensor.dtype} {tensor.shape}; {dtype} {shape} is needed")
    if dtype == "float64" and not np.isfinite(tensor).all():
        at = np.argwhere(~np.isfinite(tensor))[0]
        raise BadPack("E-PACK-VALUE", f"{where}{at.tolist()}", "not a finite number")
    if where.endswith("spheres_m") and not (tensor[:, 3] > 0).all():
        at = int(np.argmin(tensor[:, 3]))
        raise BadPack("E-PACK-VALUE", f"{where}[{at}]", f"radius {tensor[at, 3]:g} m; radii are above 0")


def check_faces(where: str, faces: NDArray[Any], vertices: int) -> None:
    """Raise BadPack unless every corner is one of the vertices."""
    if len(faces) and not (faces.min() >= 0 and faces.max() < vertices):
        at = int(np.flatnonzero(((faces < 0) | (faces >= vertices)).any(axis=1))[0])
        raise BadPack("E-PACK-VALUE", f"{where}[{at}]", f"{faces[at].tolist()}; vertices 0 to {vertices - 1} are there")


def check_bounds(
    where: str, spheres: NDArray[Any], sphere_parent: NDArray[Any], balls: NDArray[Any], ball_parent: NDArray[Any]
) -> None:
    """Raise BadPack E-PACK-TREE unless the balls are a tree, root first, and contain what stands below them."""
    if len(sphere_parent) != len(spheres) or len(ball_parent) != len(balls) or len(balls) == 0:
        raise BadPack("E-PACK-SHAPE", where, "each sphere and each ball needs one parent, and there is a root")
    if ball_parent[0] != -1:
        raise BadPack("E-PACK-TREE", f"{where}/bounds_parent[0]", f"parent {ball_parent[0]}; -1 of the root is needed")
    # A parent before its child: then there are no cycles either.
    rows = (("bounds_parent", ball_parent[1:], np.arange(1, len(balls))), ("parent", sphere_parent, len(balls)))
    for name, parent, limit in rows:
        wrong = np.flatnonzero((parent < 0) | (parent >= limit))
        if len(wrong):
            at = int(wrong[0]) + (name == "bounds_parent")
            raise BadPack(
                "E-PACK-TREE", f"{where}/{name}[{at}]", f"parent {parent[wrong[0]]}; an earlier ball is needed"
            )
    for name, below, parent in (("bounds_m", balls[1:], ball_parent[1:]), ("spheres_m", spheres, sphere_parent)):
        above = balls[parent]
        out = np.linalg.norm(below[:, :3] - above[:, :3], axis=1) + below[:, 3] - above[:, 3]
        if len(out) and not out.max() <= CONTAINED_M:
            at = int(np.argmax(out))
            found = f"reaches {out[at] * 1e3:.3g} mm out of the ball that must contain it"
            raise BadPack("E-PACK-TREE", f"{where}/{name}[{at + (name == 'bounds_m')}]", found)
