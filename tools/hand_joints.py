"""A hand mesh without a skin and the places of its joints -> the same rig as from a rigged file."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.model import FINGERS
from palmar.tools.gltf_skin import SkinnedMesh
from palmar.tools.mesh import read_mesh
from palmar.tools.rig import NEEDED, ROLES, Rig, link_of, make_rig, role_of
from palmar.tools.toml_file import is_number

Array = NDArray[np.float64]

BLEND = 0.35  # of a bone's thickness: over which the skin at a joint goes from one bone to the next


def rig_of_joints(path: str | Path, joints_path: str | Path) -> Rig:
    """Skin weights from the nearest bone, blended across the joints; axes are left to the shape.

    The joints' file is in the mesh's frame and unit: a CSV with the columns name, x, y, z, or JSON {name: [x, y, z]};
    names as in a rig, tips needed. Raises BadMesh or BadPack.
    """
    places = read_joints(joints_path)
    mesh = read_mesh(path, size_mm=1000.0)
    in_file = mesh.vertices_m / mesh.metres_per_unit
    names = tuple(places)
    roles = {role_of(name)[0]: name for name in names}
    missing = [role for role in NEEDED if role not in roles]
    if missing:
        found = f"{', '.join(missing[:6])} {'is' if len(missing) == 1 else 'are'} missing"
        raise BadPack("E-CONF", str(joints_path), f"{found}; needed are {', '.join(NEEDED)}")
    joint = np.array([places[name] for name in names])
    weights = np.zeros((len(in_file), len(names)))
    of_link = _link_weights(in_file, {role: np.array(places[name]) for role, name in roles.items() if role})
    for number, name in enumerate(names):
        role = role_of(name)[0]
        if role == "wrist" or (role in NEEDED and not role.endswith("-tip")):
            weights[:, number] = of_link[:, link_of(role)]
    skinned = SkinnedMesh(
        vertices=in_file,
        faces=mesh.faces,
        uv=None,
        weights=weights,
        names=names,
        parents=(-1,) * len(names),
        joint=joint,
        turn=np.full((len(names), 3, 3), np.nan),
        source=mesh.source,
        sha256=mesh.sha256,
    )
    return make_rig(str(path), skinned)


def read_joints(path: str | Path) -> dict[str, list[float]]:
    """Name -> place. Raises BadPack E-CONF with the row that is wrong."""
    where = str(path)
    try:
        text = Path(path).read_text()
        table: Any = json.loads(text) if Path(path).suffix.lower() == ".json" else _rows(where, text)
    except OSError as error:
        raise BadPack("E-CONF-MISSING", where, f"{error.strerror}; a CSV or JSON with joints is needed") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise BadPack("E-CONF", where, f"neither a CSV nor JSON ({error})") from None
    if not isinstance(table, dict):
        raise BadPack("E-CONF", where, 'no table; {"wrist": [x, y, z], ...} is needed')
    for name, place in table.items():
        if role_of(name)[0] is None:
            raise BadPack("E-CONF", f"{where}:{name}", f"no joint of a hand; known are {', '.join(ROLES)}")
        if not isinstance(place, list) or len(place) != 3 or not all(is_number(value) for value in place):
            raise BadPack("E-CONF", f"{where}:{name}", f"{place!r}; three finite numbers are needed")
    return table


def _rows(where: str, text: str) -> dict[str, list[float]]:
    rows = list(csv.DictReader(io.StringIO(text)))
    if not rows or not {"name", "x", "y", "z"} <= rows[0].keys():
        raise BadPack("E-CONF", where, "columns name, x, y, z are needed")
    return {row["name"]: [float(row[axis]) for axis in "xyz"] for row in rows}


def _link_weights(points: Array, place: dict[str, Array]) -> Array:
    """Weights (n, 16): by the nearest bone, and across a joint by how far beyond it the point lies along the bones."""
    chains = [_chain(place, finger) for finger in FINGERS]
    # Bones of the palm: from the wrist to each knuckle.
    palm = np.min([_distance(points, place["wrist"], chain[0])[0] for chain in chains[1:]], axis=0)
    bones = [[_distance(points, chain[j], chain[j + 1])[0] for j in range(3)] for chain in chains]
    nearest_finger = np.argmin([np.min(bone, axis=0) for bone in bones], axis=0)
    weights = np.zeros((len(points), 16))
    for f, chain in enumerate(chains):
        of = np.flatnonzero(nearest_finger == f)
        near = points[of]
        before = place["wrist"] if f else chain[0] - (chain[1] - chain[0])
        joints = [before, *chain]
        # Share beyond each joint: from 0 to 1 across a slab that halves the angle of its two bones.
        beyond = []
        for j in range(3):
            one, two = joints[j + 1] - joints[j], joints[j + 2] - joints[j + 1]
            across = one / np.linalg.norm(one) + two / np.linalg.norm(two)
            across /= np.linalg.norm(across)
            thick = np.median(np.min(bones[f], axis=0)[of]) if len(of) else 0.01
            beyond.append(np.clip((near - joints[j + 1]) @ across / (2 * BLEND * thick) + 0.5, 0, 1))
        if f == 0:  # a thumb's root has no slab: what is nearer to the palm's bones is palm
            beyond[0] = np.clip(0.5 + (palm[of] - np.min(bones[0], axis=0)[of]) / (4 * BLEND * thick), 0, 1)
        first = beyond[0]
        second, third = first * beyond[1], first * beyond[1] * beyond[2]
        weights[of, 0] = 1 - first
        weights[of, 1 + 3 * f : 4 + 3 * f] = np.stack([first - second, second - third, third], axis=1)
    return weights


def _chain(place: dict[str, Array], finger: str) -> list[Array]:
    parts = ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
    return [place[f"{finger}-{part}"] for part in (*parts, "tip")]


def _distance(points: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Distance (n,) to the segment from a to b, and the place on it."""
    axis = b - a
    t = np.clip((points - a) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * axis, axis=1), t
