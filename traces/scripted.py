"""Scene script + seed -> Trace: a hand grasps whatever object it is given, or does what the scene says by keys.

The `script` verb. A scene is a TOML file in `traces/scenes`; its keys are the fields of a model in `scene_file`. The
motion of a grasp is made of minimum-jerk moves (Flash and Hogan 1985).
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.model import HandModel, SphereTree, load_pack
from palmar.records import Trace, write_trace
from palmar.traces.columns import nearest
from palmar.traces.device import summarise
from palmar.traces.keyframes import MEMBERS, key_trace, min_jerk
from palmar.traces.kinematics import Array
from palmar.traces.place import Closing, Grasp, place_grasp
from palmar.traces.scene_file import GraspScene, Sampled, cases_of, check_scene

SCENES = Path(__file__).parent / "scenes"


def script(
    scene: str | Path, pack_path: str | Path, out: str | Path, *, object: str | None = None, seed: int = 0
) -> dict[str, Any]:
    """Write the trace of a scene on an object of a pack; returns scene, object, seed, out and what `summarise` says.

    scene: a name in `traces/scenes` or a TOML file. object: a name in the pack; may be left out if it holds one. Raises
    PalmarError E-CONF for a scene or object that is not there or a key that is not right, BadPack for the pack.
    """
    parameters, where, sha256 = load_scene(scene)
    pack = load_pack(pack_path)
    names = list(pack.objects)
    if object is None and len(names) != 1:
        raise PalmarError("E-CONF", "object", f"{pack_path} holds {len(names)} objects; name one of {', '.join(names)}")
    name = names[0] if object is None else object
    if name not in pack.objects:
        raise PalmarError(
            "E-CONF", "object", f"{name!r} is not in {pack_path}{nearest(name, names)}; it holds {', '.join(names)}"
        )
    trace = script_trace(parameters, pack.hand, pack.objects[name], seed)
    header = trace.header | {"object": name, "scene": where.stem, "source": where.name, "source_sha256": sha256}
    trace = Trace(
        **{field: getattr(trace, field) for field in Trace.__dataclass_fields__ if field != "header"}, header=header
    )
    write_trace(out, trace)
    return {"scene": where.stem, "object": name, "seed": seed, "out": str(out), **summarise(trace)}


def load_scene(scene: str | Path) -> tuple[dict[str, Any], Path, str]:
    """A scene's keys, its file and the file's sha256. Raises PalmarError E-CONF with file, key and what is allowed."""
    path = Path(scene)
    if path.suffix != ".toml":
        path = SCENES / f"{scene}.toml"
    try:
        content = path.read_bytes()
    except OSError:
        known = sorted(file.stem for file in SCENES.glob("*.toml"))
        raise PalmarError(
            "E-CONF",
            str(scene),
            f"no such scene{nearest(str(scene), known)}; known are {', '.join(known)}, or a .toml file",
        ) from None
    try:
        keys = tomllib.loads(content.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PalmarError("E-CONF", str(path), f"not TOML ({error})") from None
    check_scene(keys, str(path))
    return keys, path, hashlib.sha256(content).hexdigest()


def script_trace(scene: dict[str, Any], hand: HandModel, tree: SphereTree, seed: int) -> Trace:
    """The haptic hand of a scene; same input and seed, same bytes.

    A grasp is made to fit the object, which stands still at the origin. Of any other scene it is the first case, and
    the seed is its start. Raises PalmarError E-CONF if the scene is not right (see `check_scene`).
    """
    p = check_scene(scene, "scene")
    if not isinstance(p, GraspScene):
        first = check_scene(cases_of(scene, "scene")[0][1], "scene")
        assert isinstance(first, Sampled)
        return key_trace(first, hand, seed)
    opened = np.array([p.thumb_open_rad, *[p.open_rad] * 4])
    fist = np.array([p.thumb_fist_rad, *[p.fist_rad] * 4])
    stays = sorted({0, 1, 2, 3, 4} - {finger for which in p.fingers for finger in MEMBERS[which]})
    fist[stays] = opened[stays]
    opened, fist = (np.clip(a, hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1]) for a in (opened, fist))
    abduction = np.clip(np.zeros(5), hand.abduction_limit_rad[:, 0], hand.abduction_limit_rad[:, 1])
    generator = np.random.default_rng(seed)
    vary_m = p.vary_position_m * generator.uniform(-1.0, 1.0, 2)
    vary_rad = p.vary_turn_rad * generator.uniform(-1.0, 1.0, 3)
    sense = generator.choice([-1.0, 1.0], 3)
    closing = Closing(hand, opened, fist, abduction, p.press_m, p.squeeze_m)
    grasp = place_grasp(closing, tree.leaves, vary_m, vary_rad)

    back = -(p.start_m + p.press_m) * grasp.palmar
    parts = [_phase(name, p, grasp, back, sense, closed) for name, closed in _closed_before(p.phases)]
    position, turn, closed = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    rotation = np.roll((Rotation.from_rotvec(turn) * Rotation.from_matrix(grasp.rotation)).as_quat(), 1, axis=1)
    # One half of the quaternions, so that neighbours never differ by their sign.
    rotation *= np.where(rotation @ rotation[0] < 0, -1.0, 1.0)[:, None]
    flexion = opened + closed[:, :, None] * (grasp.flexion_rad - opened)

    count = len(position)
    ends = np.cumsum([len(part[0]) for part in parts])
    phases = [
        {
            "name": name,
            "start_s": float((end - len(part[0])) / p.rate_hz),
            "end_s": float(min(end, count - 1) / p.rate_hz),
        }
        for name, part, end in zip(p.phases, parts, ends, strict=True)
    ]
    header = {
        "device": "script",
        "hand": str(hand.about.get("name", "")),
        "side": str(hand.about.get("side", "right")),
        "rate_hz": f"{p.rate_hz:g}",
        "scene": p.kind,
        "seed": str(seed),
        "assumptions": json.dumps(_sentences(p, grasp)),
        "phases": json.dumps(phases),
    }
    return Trace(
        header=header,
        time_s=np.arange(count) / p.rate_hz,
        palm_position_m=position,
        palm_rotation_wxyz=rotation,
        flexion_rad=flexion,
        abduction_rad=np.tile(abduction, (count, 1)),
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )


def _closed_before(phases: Sequence[str]) -> list[tuple[str, float]]:
    """Each phase, and whether the hand is closed (1) or open (0) when it begins."""
    closed, found = 0.0, []
    for name in phases:
        found.append((name, closed))
        closed = {"close": 1.0, "open": 0.0}.get(name, closed)
    return found


def _phase(
    name: str, p: GraspScene, grasp: Grasp, back: Array, sense: Array, closed: float
) -> tuple[Array, Array, Array]:
    """Palm position (n, 3), turn about the grasp (n, 3, rotation vector) and closing (n, 1) from 0, open, to 1."""
    count = round(getattr(p, f"{name}_s") * p.rate_hz)
    s = min_jerk((np.arange(count) / count)[:, None])
    position, turn, closing = np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 1), closed)
    if name == "approach":
        position = back * (1.0 - s)
    elif name == "close":
        closing = s
    elif name == "open":
        closing = 1.0 - s
    elif name == "slide":
        position, turn = _slide(p, grasp, sense, s)
    elif name == "leave":
        position, closing = back * s, closed * (1.0 - s)
    shapes = ((grasp.position_m + position, 3), (turn, 3), (closing, 1))
    made = [np.broadcast_to(part, (count, width)) for part, width in shapes]
    return made[0], made[1], made[2]


def _slide(p: GraspScene, grasp: Grasp, sense: Array, s: Array) -> tuple[Array, Array]:
    """Once round a figure of eight along the surface, with a turn to and fro about the palm's normal; (n, 3) m and rad.

    The turn is about the palm's middle, not about the frame's origin, which may lie at the wrist.
    """
    once, twice = np.sin(2 * np.pi * s), np.sin(4 * np.pi * s)
    turn = sense[2] * p.slide_turn_rad * once * grasp.palmar
    arm = grasp.middle_m - grasp.position_m
    swing = arm - Rotation.from_rotvec(turn).apply(arm)
    along = sense[0] * p.slide_radial_m * once * grasp.radial + sense[1] * p.slide_distal_m * twice * grasp.distal
    return along + swing, turn


def _sentences(p: GraspScene, grasp: Grasp) -> list[str]:
    closes = {finger for which in p.fingers for finger in MEMBERS[which]}
    pressed = (
        f"The haptic palm is pressed {p.press_m * 1e3:g} mm into the leaf spheres"
        if p.press_m >= 0
        else f"The palm stays {-p.press_m * 1e3:g} mm off the leaf spheres"
    )
    return [
        f"The palm starts {p.start_m * 1e3:g} mm from first contact, on the side where most fingers get hold.",
        f"{pressed}; {int((grasp.hold > 0).sum())} of {len(closes)} "
        f"fingers reach the object by closing, until {p.squeeze_m * 1e3:g} mm deep or to the full fist.",
        "The object stands still at the origin.",
    ]
