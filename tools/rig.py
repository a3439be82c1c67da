"""Which joint of a rig is which joint of a hand: by name, by a name map, or by the hierarchy below the wrist."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh, BadPack
from palmar.model import FINGERS
from palmar.tools.gltf_skin import SkinnedMesh
from palmar.tools.toml_file import check_keys, nearest, read_toml

Array = NDArray[np.float64]

# The parts of a chain from the wrist outwards; "tip" is a place, not a joint, and the thumb has no "intermediate".
PARTS = ("metacarpal", "proximal", "intermediate", "distal", "tip")
ROLES = ("wrist", "palm", "forearm", *(f"{finger}-{part}" for finger in FINGERS for part in PARTS))
NEEDED = (
    "wrist",
    *(f"{finger}-{part}" for finger in FINGERS for part in ("proximal", "distal", "tip")),
    "thumb-metacarpal",
    *(f"{finger}-intermediate" for finger in FINGERS[1:]),
)
WORDS = {"pinky": "little", "pinkie": "little", "carpal": "metacarpal", "end": "tip", "forearm": "forearm"}
SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
BODY = {"hips", "pelvis", "spine", "chest", "neck", "head", "leg", "foot", "toe", "shoulder", "clavicle", "thigh"}


@dataclass(frozen=True)
class Rig:
    """A skinned mesh whose joints have names of a hand. Metres, in the file's world frame."""

    mesh: SkinnedMesh
    index: dict[str, int]  # role -> joint of the mesh; "wrist", "thumb-metacarpal", "index-proximal", ...
    link: NDArray[np.int64]  # (j,) link that each joint of the skin moves: 0 the palm, 1 + 3 finger + phalanx
    side: str | None  # as the names say it

    def place(self, role: str) -> Array:
        return self.mesh.joint[self.index[role]]


def read_roles(path: str | Path, names: tuple[str, ...]) -> dict[str, int]:
    """A name map in TOML: role = "name of the joint in the rig". Raises BadPack E-CONF."""
    where = str(path)
    table, _ = read_toml(path)
    check_keys(where, table, ROLES)
    roles = {}
    for role, name in table.items():
        if not isinstance(name, str) or name not in names:
            found = f"{name!r} is no joint of the rig{nearest(str(name), list(names))}"
            raise BadPack("E-CONF", f"{where}:{role}", f"{found}; its joints are {', '.join(names)[:300]}")
        roles[role] = names.index(name)
    return roles


def make_rig(where: str, mesh: SkinnedMesh, name_map: str | Path | None = None) -> Rig:
    """Find the joints of the hand. Raises BadMesh E-RIG-* that says which is missing or what else was found."""
    given = {} if name_map is None else read_roles(name_map, mesh.names)
    roles: dict[str, int] = dict(given)
    sides: set[str] = set()
    if name_map is None:
        for number, name in enumerate(mesh.names):
            role, side = role_of(name)
            if role is None:
                continue
            if role in roles:
                found = f"{mesh.names[roles[role]]!r} and {name!r} are both {role}"
                what = "two hands, or a whole body" if len({*sides, side} - {None}) > 1 else "two joints for one place"
                raise BadMesh("E-RIG-HANDS", where, f"{found}: {what}; export one hand alone, or give a name map")
            roles[role] = number
            if side:
                sides.add(side)
        if len(sides) > 1:
            raise BadMesh("E-RIG-HANDS", where, "joints of a left and of a right hand; export one hand alone")
    _check_complete(where, mesh, roles)
    return Rig(mesh, roles, _links(where, mesh, roles), sides.pop() if sides else None)


def role_of(name: str) -> tuple[str | None, str | None]:
    """Role and side that a joint's name tells: "Little_Proximal_R" is little-proximal of the right hand.

    Words may be parted by anything but letters and digits, or by capitals. Number instead of a part count outwards:
    1 is the first phalanx (of a thumb its metacarpal), 0 a metacarpal, the last the tip.
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z0-9])|(?<=[0-9])(?=[A-Za-z])", " ", name)
    words = [WORDS.get(word, word) for word in re.split(r"[^A-Za-z0-9]+", spaced.lower()) if word]
    side = next((SIDES[word] for word in words if word in SIDES), None)
    finger = next((word for word in words if word in FINGERS), None)
    if finger is None:
        for role in ("wrist", "palm", "forearm"):
            if role in words:
                return role, side
        return ("forearm", side) if "elbow" in words or "lowerarm" in words else (None, side)
    part = next((word for word in words if word in PARTS), None)
    if part is None:
        numbers = [int(word) for word in words if word.isdecimal()]
        parts = ("metacarpal", "proximal", "distal", "tip") if finger == "thumb" else PARTS
        at = numbers[-1] - (1 if finger == "thumb" else 0) if numbers else -1
        part = parts[at] if 0 <= at < len(parts) else None
    return (f"{finger}-{part}" if part else None), side


def _check_complete(where: str, mesh: SkinnedMesh, roles: dict[str, int]) -> None:
    missing = [role for role in NEEDED if role not in roles]
    if not missing:
        return
    names = ", ".join(mesh.names)
    words = {word for name in mesh.names for word in re.split(r"[^a-z]+", re.sub(r"([A-Z])", r" \1", name).lower())}
    if words & BODY:
        found = f"{len(mesh.names)} joints such as {', '.join(sorted(words & BODY)[:3])}: a body"
        raise BadMesh("E-RIG-BODY", where, f"{found}; export one hand with its joints alone")
    gone = [finger for finger in FINGERS if all(m in missing for m in NEEDED if m.startswith(finger))]
    what = ", ".join([*gone, *(role for role in missing if role.split("-")[0] not in gone)][:6])
    if len(missing) == len(NEEDED):
        what = "any joint of a hand"
    raise BadMesh("E-RIG-JOINT", where, f"{what} is missing by name among {names[:200]}; a name map can tell them")


def _links(where: str, mesh: SkinnedMesh, roles: dict[str, int]) -> NDArray[np.int64]:
    """The link that each joint moves: its own, or that of the nearest joint above that has one; else the palm."""
    own = np.full(len(mesh.names), -1)
    for role, number in roles.items():
        own[number] = link_of(role)
    link = np.empty(len(mesh.names), dtype=np.int64)
    for number in range(len(mesh.names)):
        at = number
        while at >= 0 and own[at] < 0:
            at = mesh.parents[at]
        link[number] = own[at] if at >= 0 else 0
    carried = np.array([mesh.weights[:, link == k].any() for k in range(16)])
    if not carried.all():
        empty = int(np.argmin(carried))
        what = "the palm" if empty == 0 else f"the {FINGERS[(empty - 1) // 3]}'s phalanx {(empty - 1) % 3 + 1}"
        raise BadMesh("E-RIG-JOINT", where, f"no vertex has a skin weight of {what}; every phalanx needs some")
    return link


def link_of(role: str) -> int:
    """0 for the palm with all metacarpals but the thumb's, else 1 + 3 finger + phalanx; a tip moves with the last."""
    finger, _, part = role.partition("-")
    if not part or (part == "metacarpal" and finger != "thumb"):
        return 0
    order = ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
    return 1 + 3 * FINGERS.index(finger) + (2 if part == "tip" else order.index(part))
