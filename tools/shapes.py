"""The built-in objects, made by constructive solid geometry: closed, outward, hand size, metres, about the origin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, FillRule, Manifold
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int32]]

MM = 1e-3


def sphere() -> Mesh:
    """Radius 40 mm."""
    return _mesh(Manifold.sphere(40, 192))


def cylinder() -> Mesh:
    """Radius 30 mm, 90 mm high."""
    return _mesh(Manifold.cylinder(90, 30, circular_segments=128))


def triangular_prism() -> Mesh:
    """Equilateral, side 80 mm, 80 mm high."""
    return _mesh(Manifold.cylinder(80, 80 / np.sqrt(3), circular_segments=3))


def cube() -> Mesh:
    """Side 70 mm."""
    return _mesh(Manifold.cube((70, 70, 70)))


def hexagonal_prism() -> Mesh:
    """Regular, side 35 mm, 80 mm high."""
    return _mesh(Manifold.cylinder(80, 35, circular_segments=6))


def cup() -> Mesh:
    """Open at the top (+z): outer radius 36 mm, 80 mm high, wall 3.5 mm, floor 5 mm; a handle 8 mm thick at +x."""
    body = Manifold.cylinder(80, 36, circular_segments=96)
    inside = Manifold.cylinder(80, 32.5, circular_segments=96).translate((0, 0, 5))
    ring = CrossSection.circle(4, 24).translate((20, 0)).revolve(64).rotate((90, 0, 0)).translate((36, 0, 40))
    return _mesh((body + ring) - inside)


def shamrock() -> Mesh:
    """Three heart-shaped leaves with notches between and in them, and a stem: 16 mm thick, pillowed to a 6 mm rim."""
    t = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    heart = np.column_stack(
        [16 * np.sin(t) ** 3, 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)]
    )
    leaf = CrossSection([heart[::-1] * 1.3 + [0, 20]], FillRule.Positive)
    stem = CrossSection.square((8, 40), True).translate((0, -22))
    flat = leaf + leaf.rotate(120) + leaf.rotate(-120) + CrossSection.circle(7, 48) + stem
    rim = np.concatenate([_subdivide(ring, 0.5) for ring in flat.to_polygons()])

    def pillow(points: Array) -> Array:
        inwards = np.minimum(cKDTree(rim).query(points[:, :2])[0] / 10, 1)
        height = 3 + 5 * np.sqrt(1 - (1 - inwards) ** 2)
        return np.column_stack([points[:, :2], points[:, 2] * height])

    return _mesh(flat.extrude(2, 1).translate((0, 0, -1)).refine_to_length(2).warp_batch(pillow))


def rock() -> Mesh:
    """A lump of 90 mm: a sphere with cut facets and seeded bumps."""
    rng = np.random.default_rng(7)
    body = Manifold.sphere(45, 96).scale((1.0, 0.85, 0.7))
    for normal in _directions(14, rng):
        body = body.trim_by_plane(tuple(-normal), -float(rng.uniform(29, 37)))
    body = body.refine_to_length(3.0)
    waves = rng.normal(size=(12, 3)) / 14
    phase = rng.uniform(0, 2 * np.pi, 12)

    def bump(points: Array) -> Array:
        swell = np.sin(points @ waves.T + phase).sum(axis=1) / 12
        return points * (1 + 0.1 * swell)[:, None]

    return _mesh(body.warp_batch(bump))


def ears() -> Mesh:
    """A body with a head and two ears, 6 mm thick at their tips: it stands for the bunny."""
    body = Manifold.sphere(27, 72).scale((1.15, 0.95, 0.9)).translate((0, 0, 24))
    head = Manifold.sphere(16, 64).translate((23, 0, 50))
    tail = Manifold.sphere(7, 40).translate((-31, 0, 26))
    solid = body + head + tail
    for side in (-1, 1):
        ear = Manifold.sphere(1, 64).scale((4.5, 8, 21)).rotate((side * -14, -14, 0)).translate((17, side * 10, 74))
        foot = Manifold.sphere(1, 48).scale((13, 6.5, 7)).translate((16, side * 14, 6))
        solid = solid + ear + foot
    return _mesh(solid)


SHAPES: dict[str, Callable[[], Mesh]] = {
    shape.__name__: shape
    for shape in (sphere, cylinder, triangular_prism, cube, hexagonal_prism, cup, shamrock, rock, ears)
}


def _mesh(solid: Manifold) -> Mesh:
    """Vertices (v, 3) in metres about the middle of the bounding box, and faces (f, 3)."""
    box = np.array(solid.bounding_box())
    mesh = solid.translate(tuple(-(box[:3] + box[3:]) / 2)).to_mesh64()
    return np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3] * MM, np.asarray(mesh.tri_verts, dtype=np.int32)


def _subdivide(ring: Array, step: float) -> Array:
    """Points (n, 2) along a closed polygon, about `step` apart."""
    parts = []
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        parts.append(a + np.linspace(0, 1, count, endpoint=False)[:, None] * (b - a))
    return np.concatenate(parts)


def _directions(count: int, rng: np.random.Generator) -> Array:
    """Unit directions (count, 3), spread evenly and then jittered."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    direction = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z]) + rng.normal(size=(count, 3)) * 0.15
    return direction / np.linalg.norm(direction, axis=1)[:, None]
