"""How well a hybrid hand stands for its own mesh: protrusion and gap of palm and phalanges, at rest and bent.

Gap: from points of the mesh's skin out to the whole hybrid hand, positive part; it counts for the link that moves the
point most. Protrusion: from the exposed skin of the palm's spheres or of a capsule out to the mesh, positive part. Skin
in folds and on the cap of the wrist does not count. All by area.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.model import FINGERS, HandModel
from palmar.tools.capsule_fit import capsule_gap
from palmar.tools.cover import PROBE_M, exposed_skin, union_gap, weighted_quantile
from palmar.tools.hand_shape import PosedHand, SkinPoints, pose_hand, skin_points, sweep_angles
from palmar.tools.solid import signed_distance

Array = NDArray[np.float64]

SPACING_M = 1.2e-3
SWEEP_DEG = (0, 15, 30, 45, 60, 75, 90)
PARTS = ("palm", *(f"{finger} {phalanx}" for finger in FINGERS for phalanx in (1, 2, 3)))
MM = 1e3

# Values in mm and their areas, of each of the 16 links.
Samples = list[tuple[Array, Array]]


def hand_quality(hand: HandModel, seed: int = 0) -> dict[str, Any]:
    """Errors of the hand against `hand.mesh`, as JSON-able values.

    {"poses": {"rest" or degrees: {part: {"protrusion_mm", "gap_mm"}}}, "rest": the first of them, "sweep": of each part
    the worst figure of all poses, "volume_ratio"}; a figure is {"max", "p99", "mean"}, a part one of PARTS or
    "phalanges", all fifteen together.
    """
    assert hand.mesh is not None
    skin = skin_points(hand.mesh, SPACING_M)
    capsules = capsules_of(hand)
    angles = {"rest": hand.mesh.flexion_rad} | {f"{d} deg": sweep_angles(hand, d) for d in SWEEP_DEG}
    poses = {}
    for name, flexion in angles.items():
        posed = pose_hand(skin, hand, flexion)
        gap = gap_samples(skin, posed, hand.palm_spheres_m, capsules)
        out = protrusion_samples(posed, hand.palm_spheres_m, capsules, seed)
        poses[name] = {
            **{part: _figures([out[k]], [gap[k]]) for k, part in enumerate(PARTS)},
            "phalanges": _figures(out[1:], gap[1:]),
        }
    return {
        "poses": poses,
        "rest": poses["rest"],
        "sweep": {part: _worst([figures[part] for figures in poses.values()]) for part in (*PARTS, "phalanges")},
        "volume_ratio": _volume_ratio(pose_hand(skin, hand, hand.mesh.flexion_rad), hand.palm_spheres_m, capsules),
    }


def capsules_of(hand: HandModel) -> Array:
    """Tapered capsules (15, 8) at the zero pose, ends and radii, from the model's frusta."""
    phalanx, radius = hand.phalanx_m.reshape(15, 2, 3), hand.phalanx_radius_m.reshape(15, 2)
    back = phalanx[:, 0] - phalanx[:, 1]
    length = np.linalg.norm(back, axis=1)[:, None]
    tan = (radius[:, :1] - radius[:, 1:]) / length
    ends = phalanx + (radius * tan)[..., None] * (back / length)[:, None]
    return np.hstack([ends.reshape(15, 6), radius * np.sqrt(1 + tan * tan)])


def hybrid_gap(posed: PosedHand, palm: Array, capsules: Array, points: Array, without: int = -1) -> Array:
    """Signed gap (n,) of points (n, 3) to palm and capsules, but for the capsule of link `without`."""
    gap = union_gap(palm, points)
    for link in range(1, 16):
        if link != without:
            capsule = capsules[link - 1]
            own, _ = capsule_gap(capsule[:6].reshape(2, 3), capsule[6:], posed.local(link, points))
            gap = np.minimum(gap, own)
    return gap


def gap_samples(skin: SkinPoints, posed: PosedHand, palm: Array, capsules: Array) -> Samples:
    """Gap of the exposed skin points of each link, mm."""
    gap = MM * np.maximum(hybrid_gap(posed, palm, capsules, posed.points_m), 0)
    counts = posed.open_air & skin.real
    return [(gap[of], skin.area_m2[of]) for of in (counts & (skin.link == link) for link in range(16))]


def protrusion_samples(posed: PosedHand, palm: Array, capsules: Array, seed: int) -> Samples:
    """Protrusion of the exposed skin of each link's hybrid shape, mm."""
    owner, direction, angle = exposed_skin(palm, PROBE_M, SPACING_M, seed)
    points, area = palm[owner, :3] + palm[owner, 3:] * direction, angle * palm[owner, 3] ** 2
    shapes = [(points, area, hybrid_gap(posed, np.empty((0, 4)), capsules, points))]
    for link in range(1, 16):
        capsule = capsules[link - 1]
        ends = capsule[:6].reshape(2, 3) @ posed.turn[link].T + posed.shift[link]
        points, area = capsule_skin(ends, capsule[6:])
        shapes.append((points, area, hybrid_gap(posed, palm, capsules, points, without=link)))
    found = []
    for points, area, gap in shapes:
        shown = gap > 0
        out = signed_distance(posed.solid, points[shown])[0] if shown.any() else np.zeros(0)
        found.append((MM * np.maximum(out, 0), area[shown]))
    return found


def capsule_skin(ends: Array, radii: Array) -> tuple[Array, Array]:
    """Even points (n, 3) on a tapered capsule, ends (2, 3), radii (2,), and the area (n,) of each."""
    axis = ends[1] - ends[0]
    length = float(np.linalg.norm(axis))
    axis = axis / length
    sin = float(np.clip((radii[0] - radii[1]) / length, -1, 1))
    cos = np.sqrt(1 - sin * sin)
    points, area = [], []
    for end, radius, first in ((ends[0], radii[0], True), (ends[1], radii[1], False)):
        ball = _even_directions(int(np.ceil(4 * np.pi * radius**2 / SPACING_M**2)))
        mine = (ball @ axis < sin) == first
        points.append(end + radius * ball[mine])
        area.append(np.full(mine.sum(), 4 * np.pi * radius**2 / len(ball)))
    side = np.eye(3)[np.argmin(np.abs(axis))]
    side = np.cross(axis, side) / np.linalg.norm(np.cross(axis, side))
    rows = max(int(np.ceil(length * cos / SPACING_M)), 1)
    columns = max(int(np.ceil(2 * np.pi * radii.max() / SPACING_M)), 8)
    along, round_ = np.meshgrid((np.arange(rows) + 0.5) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    radius = radii[0] + along * (radii[1] - radii[0])
    across = np.cos(round_)[..., None] * side + np.sin(round_)[..., None] * np.cross(axis, side)
    normal = sin * axis + cos * across
    points.append((ends[0] + (along * length)[..., None] * axis + radius[..., None] * normal).reshape(-1, 3))
    area.append((2 * np.pi * radius * cos * length / (rows * columns)).ravel())
    return np.concatenate(points), np.concatenate(area)


def _even_directions(count: int) -> Array:
    """Unit directions (count, 3) along a golden spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z * z)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


def _volume_ratio(posed: PosedHand, palm: Array, capsules: Array) -> float:
    """Volume of the hybrid hand by that of the mesh, both counted on a grid of 1.5 mm."""
    low, high = posed.points_m.min(axis=0) - 0.005, posed.points_m.max(axis=0) + 0.005
    axes = [np.arange(a, b, 1.5e-3) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    corners = posed.solid.vertices[posed.solid.faces]
    volume = np.einsum("fa,fa->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return float((hybrid_gap(posed, palm, capsules, grid) < 0).sum() * 1.5e-3**3 / volume)


def _figures(out: Sequence[tuple[Array, Array]], gap: Sequence[tuple[Array, Array]]) -> dict[str, dict[str, float]]:
    def together(samples: Sequence[tuple[Array, Array]]) -> dict[str, float]:
        values, areas = (np.concatenate(part) for part in zip(*samples, strict=True))
        mean = float(np.average(values, weights=areas)) if len(values) else 0.0
        return {"max": float(values.max(initial=0.0)), "p99": weighted_quantile(values, areas, 0.99), "mean": mean}

    return {"protrusion_mm": together(out), "gap_mm": together(gap)}


def _worst(rows: Sequence[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    return {
        error: {stat: max(row[error][stat] for row in rows) for stat in ("max", "p99", "mean")}
        for error in ("protrusion_mm", "gap_mm")
    }
