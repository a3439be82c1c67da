"""The Adroit hand (24 joints) as a hand model of 20 angles: its chain, the model made from it, the model as hand TOML.

The chain is the file `adroit_hand.json` that lies beside the door recordings. Two joints have no place in our model,
the little finger's metacarpal flexion and the thumb's MCP abduction; the model keeps them at FROZEN_RAD, what the
recordings command while they grasp, and `fit_angles` folds what they do into the other angles of their finger.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS, HandModel
from palmar.traces.inverse import fit_finger
from palmar.traces.kinematics import Array, finger_points

# Abduction, then flexions, and the sign that makes a positive flexion close the finger.
FINGER_JOINTS: dict[str, tuple[tuple[str, int], ...]] = {
    "thumb": (("thumb_cmc_rot", 1), ("thumb_cmc_flex", 1), ("thumb_mcp_flex", -1), ("thumb_ip_flex", -1)),
    "index": (("index_mcp_abd", 1), ("index_mcp_flex", 1), ("index_pip_flex", 1), ("index_dip_flex", 1)),
    "middle": (("middle_mcp_abd", 1), ("middle_mcp_flex", 1), ("middle_pip_flex", 1), ("middle_dip_flex", 1)),
    "ring": (("ring_mcp_abd", 1), ("ring_mcp_flex", 1), ("ring_pip_flex", 1), ("ring_dip_flex", 1)),
    "little": (("little_mcp_abd", 1), ("little_mcp_flex", 1), ("little_pip_flex", 1), ("little_dip_flex", 1)),
}
FROZEN_RAD = {"little_cmc_flex": 0.20, "thumb_mcp_abd": 0.20}
JOINTS = [joint for joints in FINGER_JOINTS.values() for joint, _ in joints] + list(FROZEN_RAD)
PHALANX_LETTERS = {"thumb": "th", "index": "ff", "middle": "mf", "ring": "rf", "little": "lf"}
PALM_BODIES = ("palm", "lfmetacarpal")
PALM_PITCH_M = (
    0.006  # between palm balls: at most 0.9 mm shallow between four of them, and few enough to search quickly
)

Chain = list[dict[str, Any]]
Pose = tuple[Array, Array]


def load_chain(path: str | Path) -> tuple[Chain, str]:
    """Bodies of the chain, parents first, and the file's sha256. Raises BadTrace E-TRACE-MISSING or E-TRACE-FORMAT."""
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadTrace("E-TRACE-MISSING", str(path), f"{error.strerror}; the Adroit hand's chain is needed") from None
    try:
        chain = json.loads(content)["bodies"]
        placed: set[str | None] = {None}
        joints = set()
        for body in chain:
            numbers = [body["pos"], body["quat"]]
            numbers += [[*joint["axis"], *joint["range"]] for joint in body["joints"]]
            numbers += [[*geom["size"], *geom["pos"], *geom["quat"]] for geom in body["collision_geoms"]]
            if [len(n) for n in numbers[:2]] != [3, 4] or not all(np.isfinite(n).all() for n in numbers):
                raise ValueError(f"body {body['name']} has a pose or number that is none")
            if body["parent"] not in placed:
                raise ValueError(f"body {body['name']} comes before its parent {body['parent']}")
            placed.add(body["name"])
            joints |= {joint["column"].removeprefix("q_") for joint in body["joints"]}
        if joints != set(JOINTS):
            raise ValueError(f"joints {', '.join(sorted(joints ^ set(JOINTS)))} are missing or unknown")
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"not the Adroit hand's chain ({error})") from None
    return chain, hashlib.sha256(content).hexdigest()


def chain_poses(chain: Chain, angles_rad: dict[str, Array]) -> dict[str, Pose]:
    """Pose of every body in the palm frame: rotation (n, 3, 3) and position (n, 3).

    angles_rad: (n,) by joint name; a joint left out stays at zero. Body pose = parent pose, offset, turns in order.
    """
    count = len(next(iter(angles_rad.values())))
    poses: dict[str | None, Pose] = {None: (np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3)))}
    for body in chain:
        rotation, position = poses[body["parent"]]
        position = position + rotation @ np.array(body["pos"])
        rotation = rotation @ Rotation.from_quat(np.roll(body["quat"], -1)).as_matrix()
        for joint in body["joints"]:
            angle = angles_rad.get(joint["column"].removeprefix("q_"), np.zeros(count))
            rotation = rotation @ Rotation.from_rotvec(angle[:, None] * _unit(joint["axis"])).as_matrix()
        poses[body["name"]] = (rotation, position)
    return {name: pose for name, pose in poses.items() if name is not None}


def chain_points(chain: Chain, poses: dict[str, Pose], finger: str) -> Array:
    """Second joint, third joint and tip of one finger of the true chain, (n, 3, 3) metres in the palm frame."""
    letters = PHALANX_LETTERS[finger]
    distal = next(body for body in chain if body["name"] == f"{letters}distal")
    rotation, position = poses[f"{letters}distal"]
    tip = position + rotation @ _capsule_ends(distal)[0][1]
    return np.stack([poses[f"{letters}middle"][1], position, tip], axis=1)


def hand_model(chain: Chain, sha256: str, pitch_m: float = PALM_PITCH_M) -> HandModel:
    """The chain as a HandModel; its palm frame is the palm body's, its stiffness that of a hand TOML without one."""
    poses = chain_poses(chain, {name: np.array([angle]) for name, angle in FROZEN_RAD.items()})
    where = {joint["column"].removeprefix("q_"): (body, joint) for body in chain for joint in body["joints"]}
    joint_m, flexion_axis, flexion_limit = np.zeros((5, 3, 3)), np.zeros((5, 3, 3)), np.zeros((5, 3, 2))
    abduction_axis, abduction_limit = np.zeros((5, 3)), np.zeros((5, 2))
    phalanx_m, radius_m = np.zeros((5, 3, 2, 3)), np.zeros((5, 3, 2))
    for f, finger in enumerate(FINGERS):
        for k, (name, sign) in enumerate(FINGER_JOINTS[finger]):
            body, joint = where[name]
            rotation, position = poses[body["name"]]
            axis = sign * (rotation[0] @ _unit(joint["axis"]))
            limit = sorted(sign * value for value in joint["range"])
            if k == 0:
                abduction_axis[f], abduction_limit[f] = axis, limit
            else:
                joint_m[f, k - 1], flexion_axis[f, k - 1], flexion_limit[f, k - 1] = position[0], axis, limit
        for k, phalanx in enumerate(("proximal", "middle", "distal")):
            body = next(body for body in chain if body["name"] == PHALANX_LETTERS[finger] + phalanx)
            rotation, position = poses[body["name"]]
            ends, radius = _capsule_ends(body)
            phalanx_m[f, k] = ends @ rotation[0].T + position[0]
            radius_m[f, k] = radius
    return HandModel(
        palm_spheres_m=_palm_spheres(chain, poses, pitch_m),
        joint_m=joint_m,
        flexion_axis=flexion_axis,
        abduction_axis=abduction_axis,
        phalanx_m=phalanx_m,
        phalanx_radius_m=radius_m,
        flexion_limit_rad=flexion_limit,
        abduction_limit_rad=abduction_limit,
        joint_stiffness_n_m_per_rad=np.full((5, 3), 0.5),
        palm_stiffness_n_per_m=np.array([1000.0]),
        palm_rotation_stiffness_n_m_per_rad=np.array([10.0]),
        about={"name": "adroit", "side": "right", "source": "adroit_hand.json", "sha256": sha256},
    )


def fit_angles(chain: Chain, hand: HandModel, angles_rad: dict[str, Array]) -> tuple[Array, Array, Array]:
    """The chain's 22 finger angles as the model's 20.

    Index, middle and ring are the same angles. Thumb and little finger are fitted to the chain's joints and tip, inside
    the limits. Returns flexion (n, 5, 3), abduction (n, 5), and how far the tip is from the chain's (n, 5), metres.
    """
    poses = chain_poses(chain, angles_rad)
    fitted, tip_error_m = [], []
    for f, finger in enumerate(FINGERS):
        angles = np.stack([sign * angles_rad[name] for name, sign in FINGER_JOINTS[finger]], axis=1)
        points = chain_points(chain, poses, finger)
        if finger in ("thumb", "little"):
            angles = fit_finger(hand, f, points, near_rad=angles)
        fitted.append(angles)
        tip_error_m.append(np.linalg.norm(finger_points(hand, f, angles)[:, 2] - points[:, 2], axis=1))
    angles = np.stack(fitted, axis=1)
    return angles[:, :, 1:], angles[:, :, 0], np.stack(tip_error_m, axis=1)


def _unit(axis: list[float]) -> Array:
    return np.array(axis) / np.linalg.norm(axis)


def _capsule_ends(body: dict[str, Any]) -> tuple[Array, float]:
    """Ends (2, 3), inner first, and radius of a body's capsule, in its frame: half the length along z of the geom."""
    geom = next(geom for geom in body["collision_geoms"] if geom["type"] == "capsule")
    along = Rotation.from_quat(np.roll(geom["quat"], -1)).apply([0.0, 0.0, geom["size"][1]])
    ends = np.array(geom["pos"]) + np.stack([-along, along])
    return ends[np.argsort(np.linalg.norm(ends, axis=1))], float(geom["size"][0])


def _palm_spheres(chain: Chain, poses: dict[str, Pose], pitch_m: float) -> Array:
    """Balls filling the palm's boxes from inside: as thick as the thinnest side, on a grid no wider than the pitch."""
    balls = []
    for body in chain:
        if body["name"] not in PALM_BODIES:
            continue
        rotation, position = poses[body["name"]]
        for geom in body["collision_geoms"]:
            half = np.array(geom["size"])
            radius = half.min()
            reach = half - radius
            lines = [
                np.linspace(-r, r, int(np.ceil(2 * r / pitch_m - 1e-9)) + 1) if r > 0 else np.zeros(1) for r in reach
            ]
            grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
            in_body = Rotation.from_quat(np.roll(geom["quat"], -1)).apply(grid) + geom["pos"]
            in_palm = in_body @ rotation[0].T + position[0]
            balls.append(np.column_stack([in_palm, np.full(len(in_palm), radius)]))
    return np.concatenate(balls)


def adroit_hand_toml(path: str | Path, *, pitch_m: float = PALM_PITCH_M) -> str:
    """The hand of an `adroit_hand.json` as hand TOML (docs/hand_toml.md), assumptions in comments at the top.

    pitch_m: largest distance of neighbouring palm balls. Raises BadTrace if the file is not the chain, PalmarError
    E-CONF for the pitch.
    """
    if not isinstance(pitch_m, int | float) or not 0.001 <= pitch_m <= 0.02:
        raise PalmarError("E-CONF", "pitch_m", f"{pitch_m!r}; allowed is 0.001 to 0.02 m")
    chain, sha256 = load_chain(path)
    hand = hand_model(chain, sha256, pitch_m)
    frozen = ", ".join(f"{name} {angle:g} rad" for name, angle in FROZEN_RAD.items())
    lines = [
        f"# Adroit hand from {Path(path).name}, sha256 {sha256}.",
        "# The palm frame is the palm body's: x towards the thumb, -y out of the palm, z towards the fingertips.",
        f"# Fixed, since the model has no such joints: {frozen}. Wrist and forearm are left out.",
        f"# {len(hand.palm_spheres_m)} balls fill the palm's boxes from inside, at most {pitch_m * 1e3:g} mm apart.",
        "# Stiffness is left at the default: the Adroit hand's says nothing about a user's.",
        'name = "adroit"',
        'side = "right"',
        f"source = {json.dumps(f'{Path(path).name}, sha256 {sha256}')}",
        "",
        "[palm]",
        "spheres_m = [",
        *[f"    {_numbers(ball)}," for ball in hand.palm_spheres_m],
        "]",
    ]
    for f, finger in enumerate(FINGERS):
        lines += [
            "",
            "[[finger]]",
            f'name = "{finger}"',
            f"joint_m = {_numbers(hand.joint_m[f])}",
            f"abduction_axis = {_numbers(hand.abduction_axis[f])}",
            f"flexion_axis = {_numbers(hand.flexion_axis[f])}",
            f"phalanx_m = {_numbers(hand.phalanx_m[f])}",
            f"radius_m = {_numbers(hand.phalanx_radius_m[f])}",
            f"abduction_limit_rad = {_numbers(hand.abduction_limit_rad[f])}",
            f"flexion_limit_rad = {_numbers(hand.flexion_limit_rad[f])}",
        ]
    return "\n".join(lines) + "\n"


def _numbers(values: Array | float) -> str:
    """A number or nested lists of numbers, as TOML, with every bit kept."""
    if np.ndim(values) == 0:
        return repr(float(values) + 0.0)  # + 0.0 turns -0.0 into 0.0
    return "[" + ", ".join(_numbers(v) for v in np.asarray(values)) + "]"
