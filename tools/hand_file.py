"""A hand as TOML -> HandModel. The keys are written down in docs/hand_toml.md."""

from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadPack
from palmar.model import DEFAULT_COUPLING, FINGERS, JOINTS, HandModel
from palmar.tools.spheres_csv import read_spheres_csv
from palmar.tools.toml_file import check_keys, get_number, get_text, is_number, read_toml

Array = NDArray[np.float64]

# From the farthest point of the hand to its opposite; outside of this the numbers are not metres.
SMALLEST_M, LARGEST_M = 0.05, 0.5
MAX_RADIUS_M = 0.05
MAX_PALM_SPHERES = 5000
LARGEST = 1e6  # of any number, as in a pack: squares of it are still far from overflow

STIFFNESS = {"palm_n_per_m": 1000.0, "palm_rotation_n_m_per_rad": 10.0, "joint_n_m_per_rad": 0.5}
SHORT_KEYS = ("base_m", "direction", "length_m")
LONG_KEYS = ("joint_m", "phalanx_m")
AXIS_KEYS = ("flexion_axis", "bends_towards")
FINGER_KEYS = (*SHORT_KEYS, *LONG_KEYS, *AXIS_KEYS, "name", "abduction_axis", "radius_m", "coupling")
LIMIT_KEYS = tuple(f"{kind}_limit_{unit}" for kind in ("flexion", "abduction") for unit in ("deg", "rad"))


def read_hand(path: str | Path) -> HandModel:
    """Read a hand. Raises BadPack E-CONF with the file and key, what was found and what is allowed."""
    table, content = read_toml(path)
    return _make_hand(str(path), Path(path).parent, table, content)


def default_hand() -> HandModel:
    """The right hand of a median adult: tools/default_hand.toml, where its sources are cited."""
    with resources.as_file(resources.files("palmar.tools") / "default_hand.toml") as path:
        table, content = read_toml(path)
        return _make_hand(path.name, path.parent, table, content)


def side_of(hand: HandModel) -> str:
    """Which side a hand's geometry is of: right if distal x palmar points to the thumb's side."""
    distal = hand.phalanx_m[1:, 0, 1] - hand.phalanx_m[1:, 0, 0]
    distal = distal.sum(axis=0) / np.linalg.norm(distal.sum(axis=0))
    palmar = np.cross(hand.flexion_axis[2, 0], distal)
    return "right" if np.cross(distal, palmar) @ _radial(hand.joint_m) > 0 else "left"


def _make_hand(file: str, folder: Path, table: dict[str, Any], content: bytes) -> HandModel:
    check_keys(
        file, table, ("name", "side", "source", "palm", "stiffness", "finger"), ("name", "side", "palm", "finger")
    )
    fingers = table["finger"]
    if not isinstance(fingers, list) or len(fingers) != 5:
        count = len(fingers) if isinstance(fingers, list) else 0
        raise BadPack("E-CONF", f"{file}:finger", f"{count} fingers; five are needed: {', '.join(FINGERS)}")
    parts = [_read_finger(f"{file}:finger[{k}]", finger, FINGERS[k]) for k, finger in enumerate(fingers)]
    joint = np.stack([part["joint_m"] for part in parts])
    flexion_axis = np.stack([part["flexion_axis"] for part in parts])
    for part in parts:
        if part["abduction_axis"] is None:
            part["abduction_axis"] = _default_abduction_axis(part, _radial(joint))
    palm, csv_sha256 = _read_palm(f"{file}:palm", folder, table["palm"])
    stiffness = _read_stiffness(f"{file}:stiffness", table.get("stiffness", {}))
    side = get_text(file, table, "side", ("right", "left"))
    about = {
        "name": get_text(file, table, "name"),
        "side": side,
        "source": get_text(file, table, "source") if "source" in table else Path(file).name,
        "sha256": hashlib.sha256(content + csv_sha256.encode()).hexdigest(),
    }
    hand = HandModel(
        palm_spheres_m=palm,
        joint_m=joint,
        flexion_axis=flexion_axis,
        abduction_axis=np.stack([part["abduction_axis"] for part in parts]),
        phalanx_m=np.stack([part["phalanx_m"] for part in parts]),
        phalanx_radius_m=np.stack([part["radius_m"] for part in parts]),
        flexion_limit_rad=np.stack([part["flexion_limit_rad"] for part in parts]),
        abduction_limit_rad=np.stack([part["abduction_limit_rad"] for part in parts]),
        joint_stiffness_n_m_per_rad=np.full((5, 3), stiffness["joint_n_m_per_rad"]),
        palm_stiffness_n_per_m=np.array([stiffness["palm_n_per_m"]]),
        palm_rotation_stiffness_n_m_per_rad=np.array([stiffness["palm_rotation_n_m_per_rad"]]),
        flexion_coupling=np.stack([part["flexion_coupling"] for part in parts]),
        about=about,
    )
    _check_hand(file, hand)
    return hand


def _check_hand(file: str, hand: HandModel) -> None:
    points = np.concatenate([hand.palm_spheres_m[:, :3], hand.joint_m.reshape(-1, 3), hand.phalanx_m.reshape(-1, 3)])
    size = float(np.ptp(points, axis=0).max())
    if not SMALLEST_M <= size <= LARGEST_M:
        allowed = f"{SMALLEST_M:g} to {LARGEST_M:g} m is allowed: every length is in metres"
        raise BadPack("E-CONF", file, f"the hand is {size:.3g} m long; {allowed}")
    if side_of(hand) != hand.about["side"]:
        found = f"{hand.about['side']!r}, but thumb, fingers and palm are placed as on a {side_of(hand)} hand"
        raise BadPack(
            "E-CONF", f"{file}:side", f"{found}: looking along the fingers, palm up, the right thumb is right"
        )


def _read_finger(where: str, table: Any, name: str) -> dict[str, Any]:
    """Joints, axes, phalanges, radii and limits of one finger; "abduction_axis" is None if it is not given."""
    check_keys(where, table, (*FINGER_KEYS, *LIMIT_KEYS), ("radius_m",))
    if table.get("name", name) != name:
        raise BadPack("E-CONF", f"{where}.name", f"{table['name']!r}; here stands the {name}: {', '.join(FINGERS)}")
    given = _choose(where, table, LONG_KEYS[:1], SHORT_KEYS[:1])
    if given == "joint_m":
        check_keys(where, table, set((*FINGER_KEYS, *LIMIT_KEYS)) - set(SHORT_KEYS), LONG_KEYS)
        joint = _numbers(where, table, "joint_m", (3, 3))
        phalanx = _numbers(where, table, "phalanx_m", (3, 2, 3))
    else:
        check_keys(where, table, set((*FINGER_KEYS, *LIMIT_KEYS)) - set(LONG_KEYS), SHORT_KEYS)
        direction = _unit(where, table, "direction", (3,))
        lengths = _numbers(where, table, "length_m", (3,))
        if not (lengths > 0).all():
            raise BadPack("E-CONF", f"{where}.length_m", f"{table['length_m']}; lengths above 0 are needed")
        ends = np.cumsum([0.0, *lengths])
        line = _numbers(where, table, "base_m", (3,)) + ends[:, None] * direction
        joint, phalanx = line[:3], np.stack([line[:3], line[1:]], axis=1)
    length = np.linalg.norm(phalanx[:, 1] - phalanx[:, 0], axis=1)
    radius = _read_radii(where, table)
    for k, joint_name in enumerate(JOINTS):
        r1, r2 = radius[k]
        if not 0 < min(r1, r2) <= max(r1, r2) <= MAX_RADIUS_M:
            raise BadPack("E-CONF", f"{where}.radius_m[{k}]", f"{r1:g}, {r2:g}; above 0 and up to {MAX_RADIUS_M:g} m")
        if not length[k] > abs(r1 - r2):
            text = f"{joint_name} phalanx of length {length[k]:g} m between radii {r1:g} and {r2:g} m"
            raise BadPack("E-CONF", f"{where}.length_m[{k}]", f"{text}; it must be longer than they differ")
    axis = _read_flexion_axes(where, table, phalanx)
    return {
        "joint_m": joint,
        "phalanx_m": phalanx,
        "radius_m": radius,
        "flexion_axis": axis,
        "abduction_axis": _unit(where, table, "abduction_axis", (3,)) if "abduction_axis" in table else None,
        "flexion_limit_rad": _read_limits(where, table, "flexion", (3, 2)),
        "abduction_limit_rad": _read_limits(where, table, "abduction", (2,)),
        "flexion_coupling": _read_coupling(where, table, FINGERS.index(name)),
    }


def _read_flexion_axes(where: str, table: dict[str, Any], phalanx: Array) -> Array:
    """Unit axes (3, 3): given for the finger or for each joint, or from the direction in which the finger bends."""
    key = _choose(where, table, AXIS_KEYS[:1], AXIS_KEYS[1:])
    axis = _unit(where, table, key, (3,), (3, 3))
    if key == "flexion_axis":
        return np.tile(axis, (3, 1)) if axis.ndim == 1 else axis
    if axis.ndim != 1:
        raise BadPack("E-CONF", f"{where}.bends_towards", "three directions; one for the finger is needed")
    # A turn about direction x towards moves the tip towards `towards`, less its part along the finger.
    axis = np.cross(phalanx[0, 1] - phalanx[0, 0], axis)
    if np.linalg.norm(axis) < 1e-3 * np.linalg.norm(phalanx[0, 1] - phalanx[0, 0]):
        raise BadPack("E-CONF", f"{where}.bends_towards", "lies along the finger; a direction across it is needed")
    return np.tile(axis / np.linalg.norm(axis), (3, 1))


def _default_abduction_axis(part: dict[str, Any], radial: Array) -> Array:
    """Across the finger and its flexion axis, such that a positive abduction goes to the thumb's side."""
    direction = part["phalanx_m"][0, 1] - part["phalanx_m"][0, 0]
    axis = np.cross(direction, part["flexion_axis"][0])
    axis = axis / np.linalg.norm(axis)
    return axis if np.cross(axis, direction) @ radial > 0 else -axis


def _radial(joint_m: Array) -> Array:
    """From the little finger's first joint to the index finger's."""
    return joint_m[1, 0] - joint_m[4, 0]


def _read_radii(where: str, table: dict[str, Any]) -> Array:
    """Radii (3, 2) from three (cylinders), three pairs, or four at the joints and the tip."""
    radius = _numbers(where, table, "radius_m", (3,), (4,), (3, 2))
    if radius.shape == (3,):
        return np.column_stack([radius, radius])
    return np.column_stack([radius[:3], radius[1:]]) if radius.shape == (4,) else radius


def _read_limits(where: str, table: dict[str, Any], kind: str, shape: tuple[int, ...]) -> Array:
    key = _choose(where, table, (f"{kind}_limit_deg",), (f"{kind}_limit_rad",))
    limit = _numbers(where, table, key, shape)
    limit = np.radians(limit) if key.endswith("deg") else limit
    if not (limit[..., 0] < limit[..., 1]).all() or np.abs(limit).max() > np.pi:
        raise BadPack("E-CONF", f"{where}.{key}", f"{table[key]}; lowest below highest, within half a turn, is needed")
    return limit


def _read_coupling(where: str, table: dict[str, Any], finger: int) -> Array:
    """PIP per MCP and DIP per PIP (2,)."""
    if "coupling" not in table:
        return np.array(DEFAULT_COUPLING[finger])
    coupling = _numbers(where, table, "coupling", (2,))
    if not ((coupling > 0) & (coupling <= 10)).all():
        raise BadPack("E-CONF", f"{where}.coupling", f"{table['coupling']}; above 0 and up to 10 is needed")
    return coupling


def _read_palm(where: str, folder: Path, table: Any) -> tuple[Array, str]:
    """Palm spheres (p, 4), and the sha256 of the CSV they are from or ""."""
    kinds = ("spheres_m", "spheres_csv", "grid")
    check_keys(where, table, kinds)
    if len(table) != 1:
        raise BadPack("E-CONF", where, f"{', '.join(table) or 'nothing'} given; one of {', '.join(kinds)} is needed")
    sha256 = ""
    if "spheres_csv" in table:
        spheres, sha256 = read_spheres_csv(folder / get_text(where, table, "spheres_csv"))
    elif "grid" in table:
        spheres = _read_grid(f"{where}.grid", table["grid"])
    else:
        count = len(table["spheres_m"]) if isinstance(table["spheres_m"], list) else 0
        spheres = _numbers(where, table, "spheres_m", (max(count, 1), 4))
    if len(spheres) > MAX_PALM_SPHERES:
        raise BadPack("E-CONF", where, f"{len(spheres)} spheres; at most {MAX_PALM_SPHERES} are allowed")
    bad = np.flatnonzero((spheres[:, 3] <= 0) | (spheres[:, 3] > MAX_RADIUS_M))
    if len(bad):
        found = f"sphere {bad[0]} with radius {spheres[bad[0], 3]:g} m"
        raise BadPack("E-CONF", where, f"{found}; above 0 and up to {MAX_RADIUS_M:g} m is allowed")
    return spheres, sha256


def _read_grid(where: str, table: Any) -> Array:
    """Equal spheres on a grid: x quickest."""
    keys = ("x_m", "y_m", "z_m", "counts", "radius_m")
    check_keys(where, table, keys, keys)
    x, y = (_numbers(where, table, key, (2,)) for key in ("x_m", "y_m"))
    counts = table["counts"]
    if not isinstance(counts, list) or len(counts) != 2 or not all(type(n) is int and 1 <= n <= 100 for n in counts):
        raise BadPack("E-CONF", f"{where}.counts", f"{counts!r}; two whole numbers from 1 to 100 are needed")
    grid_y, grid_x = np.meshgrid(np.linspace(y[0], y[1], counts[1]), np.linspace(x[0], x[1], counts[0]), indexing="ij")
    z, radius = _numbers(where, table, "z_m", ()), get_number(where, table, "radius_m", 0.0, MAX_RADIUS_M)
    flat = np.ones(grid_x.size)
    return np.column_stack([grid_x.ravel(), grid_y.ravel(), z * flat, radius * flat])


def _read_stiffness(where: str, table: Any) -> dict[str, float]:
    check_keys(where, table, STIFFNESS)
    return {key: get_number(where, {key: value, **table}, key, 0.0, 1e6) for key, value in STIFFNESS.items()}


def _choose(where: str, table: dict[str, Any], one: tuple[str, ...], other: tuple[str, ...]) -> str:
    """The one key of two that is given."""
    given = [key for key in (*one, *other) if key in table]
    if len(given) != 1:
        found = " and ".join(given) or "neither"
        raise BadPack("E-CONF", where, f"{found} given; one of {', '.join((*one, *other))} is needed")
    return given[0]


def _numbers(where: str, table: dict[str, Any], key: str, *shapes: tuple[int, ...]) -> Array:
    """Finite numbers in one of the shapes."""

    def flat(value: Any) -> list[Any]:
        return [part for item in value for part in flat(item)] if isinstance(value, list) else [value]

    value = table[key]
    wanted = " or ".join(" x ".join(map(str, shape)) or "1" for shape in shapes)
    if not all(is_number(part) for part in flat(value)):
        wrong = next(part for part in flat(value) if not is_number(part))
        raise BadPack("E-CONF", f"{where}.{key}", f"{wrong!r}; {wanted} finite numbers are needed")
    try:
        numbers = np.array(value, dtype=np.float64)
    except ValueError:
        raise BadPack("E-CONF", f"{where}.{key}", f"rows of different length; {wanted} numbers are needed") from None
    if numbers.shape not in shapes:
        found = " x ".join(map(str, numbers.shape)) or "1"
        raise BadPack("E-CONF", f"{where}.{key}", f"{found} numbers; {wanted} are needed")
    if np.abs(numbers).max() > LARGEST:
        raise BadPack("E-CONF", f"{where}.{key}", f"{np.abs(numbers).max():g}; at most {LARGEST:g} in size is allowed")
    return numbers


def _unit(where: str, table: dict[str, Any], key: str, *shapes: tuple[int, ...]) -> Array:
    vectors = _numbers(where, table, key, *shapes)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (length > 1e-6).all():
        raise BadPack("E-CONF", f"{where}.{key}", f"{table[key]}; a direction is needed, not zero")
    return vectors / length
