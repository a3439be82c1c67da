"""Scenes by keys -> Trace: a hand, and where asked for the object, from key to key, with what goes wrong on the way."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palmar.errors import PalmarError
from palmar.model import FINGERS, HandModel
from palmar.records import Trace
from palmar.traces.disturb import disturb
from palmar.traces.kinematics import Array, phalanges_in_palm
from palmar.traces.scene_file import Key, KeysScene, Noise, RandomScene, Sampled

MEMBERS = {
    **{name: [number] for number, name in enumerate(FINGERS)},
    "fingers": [1, 2, 3, 4],
    "all": [0, 1, 2, 3, 4],
}
LONGEST_S = 600.0


@dataclass(frozen=True)
class Postures:
    """n postures of hand and object; rotations as (n, 4) quaternions x y z w, positions of the palm frame."""

    position_m: Array  # (n, 3)
    rotation: Array  # (n, 4)
    flexion_rad: Array  # (n, 5, 3)
    abduction_rad: Array  # (n, 5)
    object_position_m: Array  # (n, 3)
    object_rotation: Array  # (n, 4)

    def __getitem__(self, rows: Any) -> Postures:
        return Postures(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def key_trace(scene: Sampled, hand: HandModel, start: int = 0) -> Trace:
    """The samples of one case of a scene. start: which of the scene's starts; it also draws noise and random targets.

    Raises PalmarError E-CONF where the keys make no motion.
    """
    generator = np.random.default_rng([getattr(scene, "seed", 0), start])
    keys = random_keys(scene, generator) if isinstance(scene, RandomScene) else _keys(scene)
    times, ways = key_times(keys)
    place = place_keys(keys, hand, scene)
    sample_s = 1.0 / (scene.hold_hz or scene.rate_hz)
    # A scene of one start is not shifted; of several, each starts at a random place in its own share of a sample.
    late_s = sample_s * (start % scene.starts + generator.random()) / scene.starts if scene.starts > 1 else 0.0
    count = int(np.floor(times[-1] * scene.rate_hz + 1e-6)) + 1
    time_s = np.arange(count) / scene.rate_hz
    # The first sample at or before each step, as a device of that rate delivers it.
    held_s = np.floor(time_s / sample_s + 1e-6) * sample_s if scene.hold_hz else time_s
    moved = move_between(place, times, ways, np.minimum(held_s + late_s, times[-1]))
    moved = add_noise(moved, scene.noise, scene.rate_hz, generator, held_s if scene.hold_hz else None)
    has_object = any(key.object_position_m is not None or key.object_turn_rad is not None for key in keys)
    header = {
        "device": "script",
        "hand": str(hand.about.get("name", "")),
        "side": str(hand.about.get("side", "right")),
        "rate_hz": f"{scene.rate_hz:g}",
        "seed": str(start),
        "assumptions": json.dumps([f"The motion starts {1e3 * late_s:.4g} ms late."] if late_s else []),
        "phases": json.dumps(_phases(keys, times, late_s)),
    }
    if scene.limits:
        header["limits"] = json.dumps({name: limit.model_dump() for name, limit in scene.limits.items()})
    if scene.far_side:
        header["far_side"] = json.dumps([region.model_dump(exclude_none=True) for region in scene.far_side])
    trace = Trace(
        header=header,
        time_s=time_s,
        palm_position_m=moved.position_m,
        palm_rotation_wxyz=_wxyz(moved.rotation),
        flexion_rad=moved.flexion_rad,
        abduction_rad=moved.abduction_rad,
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.full(count, has_object),
        object_position_m=moved.object_position_m,
        object_rotation_wxyz=_wxyz(moved.object_rotation),
    )
    return disturb(trace, scene.disturbance, generator)


def min_jerk(u: Array) -> Array:
    """10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan 1985): 0 at u = 0, 1 at u = 1, at rest at both.

    Slope at most 1.875, curvature at most 5.774.
    """
    return u**3 * (10.0 + u * (6.0 * u - 15.0))


def key_times(keys: list[Key]) -> tuple[Array, list[str]]:
    """When each key is reached, (k,) seconds from 0, and how. Raises PalmarError E-CONF if a key has no time."""
    times, point = [0.0], _point(keys[0], np.zeros(3))
    for number, key in enumerate(keys[1:], 1):
        there = _point(key, point)
        way = float(np.linalg.norm(there - point))
        if key.after_s is None and (key.speed_m_per_s is None or way == 0.0):
            raise PalmarError("E-CONF", f"key.{number}", "no after_s, and no way with a speed_m_per_s; one is needed")
        times.append(times[-1] + (key.after_s if key.after_s is not None else way / (key.speed_m_per_s or 1.0)))
        point = there
    if not 0.0 < times[-1] <= LONGEST_S:
        raise PalmarError("E-CONF", "key", f"the motion lasts {times[-1]:g} s; up to {LONGEST_S:g} s is allowed")
    return np.array(times), [key.move for key in keys]


def place_keys(keys: list[Key], hand: HandModel, scene: Sampled) -> Postures:
    """The posture at each key. Positions of keys are those of the scene's `point` in the posture of the first key."""
    k = len(keys)
    rotation, object_rotation = Rotation.identity(), Rotation.identity()
    flexion, abduction = np.zeros((5, 3)), np.zeros(5)
    point, object_position = np.zeros(3), np.zeros(3)
    out = Postures(*(np.zeros((k, *shape)) for shape in ((3,), (4,), (5, 3), (5,), (3,), (4,))))
    for number, key in enumerate(keys):
        point = _point(key, point)
        rotation = rotation if key.turn_rad is None else Rotation.from_rotvec(key.turn_rad)
        for which, angles in key.flexion_rad.items():
            flexion[MEMBERS[which]] = angles
        for which, angle in key.abduction_rad.items():
            abduction[MEMBERS[which]] = angle
        if key.object_position_m is not None:
            object_position = np.array(key.object_position_m)
        if key.object_turn_rad is not None:
            object_rotation = Rotation.from_rotvec(key.object_turn_rad)
        out.position_m[number] = point
        out.rotation[number], out.object_rotation[number] = rotation.as_quat(), object_rotation.as_quat()
        out.flexion_rad[number], out.abduction_rad[number] = flexion, abduction
        out.object_position_m[number] = object_position
    out.position_m[:] -= extreme_point(hand, out[0:1], scene.point, np.array(scene.towards))
    return out


def extreme_point(hand: HandModel, posture: Postures, part: str, towards: Array) -> Array:
    """The point of a part of the hand that reaches farthest in a direction: from the palm frame, in world axes.

    part: frame (the origin itself), palm, a finger or hand. posture: one row. Metres (3,).
    """
    if part == "frame":
        return np.zeros(3)
    direction = towards / np.linalg.norm(towards)
    ends = phalanges_in_palm(hand, posture.flexion_rad, posture.abduction_rad)[0]  # (5, 3, 2, 3)
    back = ends[:, :, :1] - ends[:, :, 1:]
    length = np.linalg.norm(back, axis=-1, keepdims=True)
    slope = ((hand.phalanx_radius_m[..., :1] - hand.phalanx_radius_m[..., 1:]) / length[..., 0])[..., None]
    # The two spheres of a tapered capsule: docs/formats.md.
    centres = ends + hand.phalanx_radius_m[..., None] * slope * back / length
    radii = hand.phalanx_radius_m * np.sqrt(1.0 + slope[..., 0] ** 2)
    fingers = np.concatenate([centres, radii[..., None]], axis=-1)
    balls = {"palm": hand.palm_spheres_m, "hand": np.vstack([hand.palm_spheres_m, fingers.reshape(-1, 4)])}
    chosen = balls[part] if part in balls else fingers[FINGERS.index(part)].reshape(-1, 4)
    placed = Rotation.from_quat(posture.rotation[0]).apply(chosen[:, :3])
    first = int(np.argmax(placed @ direction + chosen[:, 3]))
    return placed[first] + chosen[first, 3] * direction


def move_between(place: Postures, times: Array, ways: list[str], at_s: Array) -> Postures:
    """The postures at given times, (n,) seconds inside the keys' times."""
    last = len(times) - 1
    k = np.clip(np.searchsorted(times, at_s, side="right") - 1, 0, last)
    after = np.minimum(k + 1, last)
    span = np.where(after > k, times[after] - times[k], 1.0)
    u = np.clip((at_s - times[k]) / span, 0.0, 1.0)
    way = np.array(ways)[after]
    s = np.where(way == "hold", 0.0, np.where(way == "min_jerk", min_jerk(u), u))
    s[after == k] = 0.0

    def between(values: Array) -> Array:
        return values[k] + s.reshape(-1, *(1,) * (values.ndim - 1)) * (values[after] - values[k])

    def turned(values: Array) -> Array:
        start, end = Rotation.from_quat(values[:-1]), Rotation.from_quat(values[1:])
        turns = np.vstack([(start.inv() * end).as_rotvec(), np.zeros(3)])
        return (Rotation.from_quat(values[k]) * Rotation.from_rotvec(s[:, None] * turns[k])).as_quat()

    return Postures(
        between(place.position_m),
        turned(place.rotation),
        between(place.flexion_rad),
        between(place.abduction_rad),
        between(place.object_position_m),
        turned(place.object_rotation),
    )


def add_noise(
    moved: Postures, noise: Noise, rate_hz: float, generator: np.random.Generator, held_s: Array | None
) -> Postures:
    """The postures with the sensor's noise. held_s: (n,) when each sample was taken, if several are the same."""
    count = len(moved.position_m)

    def draw(sigma: float, width: int) -> Array:
        if not sigma:
            return np.zeros((count, width))
        white = generator.normal(size=(count, width))
        if noise.band_hz is not None:
            spectrum = np.fft.rfft(white, axis=0)
            frequency = np.fft.rfftfreq(count, 1.0 / rate_hz)
            spectrum[(frequency < noise.band_hz[0]) | (frequency > noise.band_hz[1])] = 0.0
            white = np.fft.irfft(spectrum, count, axis=0)
            white /= max(float(white.std()), 1e-12)
        if held_s is not None:
            _, first = np.unique(held_s, return_index=True)
            white = np.repeat(white[first], np.diff([*first, count]), axis=0)
        return sigma * white

    joints = draw(noise.joint_rad, 20)
    flexion = moved.flexion_rad + joints[:, :15].reshape(-1, 5, 3)
    abduction = moved.abduction_rad + joints[:, 15:]
    if noise.quantum_rad:
        flexion, abduction = (noise.quantum_rad * np.round(x / noise.quantum_rad) for x in (flexion, abduction))
    rotation = moved.rotation
    if noise.turn_rad:
        rotation = (Rotation.from_rotvec(draw(noise.turn_rad, 3)) * Rotation.from_quat(rotation)).as_quat()
    position = moved.position_m + draw(noise.position_m, 3)
    return Postures(position, rotation, flexion, abduction, moved.object_position_m, moved.object_rotation)


def random_keys(scene: RandomScene, generator: np.random.Generator) -> list[Key]:
    """Targets one after the other until the scene's time is over; the first is `start_m` with the hand open."""
    middle = Rotation.from_rotvec(scene.turned_rad)
    keys = [Key(position_m=scene.start_m, turn_rad=scene.turned_rad)]
    passed = 0.0
    while passed < scene.lasts_s:
        after = min(float(generator.uniform(*scene.every_s)), scene.lasts_s - passed)
        passed = scene.lasts_s if scene.lasts_s - passed - after < 1e-6 else passed + after
        turn = Rotation.from_rotvec(generator.uniform(-scene.turn_rad, scene.turn_rad, 3)) * middle
        jumps = generator.random() < scene.jump_share
        flexion = generator.uniform(scene.flexion_rad[0], scene.flexion_rad[1], (5, 3))
        abduction = generator.uniform(scene.abduction_rad[0], scene.abduction_rad[1], 5)
        keys.append(
            Key(
                after_s=after,
                move="hold" if jumps else "linear",
                position_m=tuple(generator.uniform(scene.low_m, scene.high_m)),
                turn_rad=tuple(turn.as_rotvec()),
                flexion_rad={name: tuple(row) for name, row in zip(FINGERS, flexion, strict=True)},
                abduction_rad=dict(zip(FINGERS, abduction.tolist(), strict=True)),
            )
        )
    return keys


def _keys(scene: Sampled) -> list[Key]:
    assert isinstance(scene, KeysScene)
    return [scene.key[0], *scene.key[1:] * scene.repeat]


def _point(key: Key, before: Array) -> Array:
    if key.position_m is not None:
        return np.array(key.position_m)
    return before if key.move_m is None else before + key.move_m


def _phases(keys: list[Key], times: Array, late_s: float) -> list[dict[str, Any]]:
    """Named times between keys, neighbours of one name as one, in the order of their starts."""
    found: list[dict[str, Any]] = []
    for key, start, end in zip(keys[1:], times[:-1] - late_s, times[1:] - late_s, strict=True):
        if key.phase and found and found[-1] == {**found[-1], "name": key.phase, "end_s": max(float(start), 0.0)}:
            found[-1]["end_s"] = float(end)
        elif key.phase:
            found.append({"name": key.phase, "start_s": max(float(start), 0.0), "end_s": float(end)})
    return found


def _wxyz(xyzw: Array) -> Array:
    """Unit quaternions (n, 4) w first, neighbours on one side, so that none differs from the next by its sign alone."""
    wxyz = np.roll(xyzw, 1, axis=1)
    flips = np.cumprod(np.where((wxyz[1:] * wxyz[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    return wxyz * np.concatenate([[1.0], flips])[:, None]
