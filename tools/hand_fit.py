"""The `fit-hand` verb: a rigged hand mesh -> HandModel with its own mesh, and how well the two agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from palmar.errors import BadMesh, PalmarError
from palmar.files import require_own_folder
from palmar.model import FINGERS, AssetPack, HandModel, save_pack
from palmar.skin import HandMesh
from palmar.tools.capsule_fit import FingerSkin, fit_finger
from palmar.tools.cover import weighted_quantile
from palmar.tools.gltf_skin import read_skin
from palmar.tools.hand_file import STIFFNESS, default_hand
from palmar.tools.hand_frame import HandFrame, make_frame
from palmar.tools.hand_joints import rig_of_joints
from palmar.tools.hand_palm import drop_useless, palm_solid, palm_spheres
from palmar.tools.hand_quality import gap_samples, hand_quality, hybrid_gap, protrusion_samples
from palmar.tools.hand_report import FILES, WHAT, write_fit_report
from palmar.tools.hand_shape import PosedHand, SkinPoints, pose_hand, skin_points, sweep_angles
from palmar.tools.mesh import METRES_PER_UNIT
from palmar.tools.pack import PACKAGES, version_of
from palmar.tools.rig import Rig, make_rig
from palmar.tools.solid import Solid, make_solid, signed_distance
from palmar.tools.surface import cap, keep_above, mixed

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

SPHERES = 250
SPACING_M = 3e-3  # between the skin points that the capsules are fitted to
SWEEP_DEG = (30.0, 60.0, 90.0)  # poses of the fit beside rest
SHARE = 0.3  # what a gap in the sweep counts beside one at rest: the sweep may be 2.5 times worse


def fit_hand(
    path: str | Path,
    out: str | Path,
    *,
    name_map: str | Path | None = None,
    joints_path: str | Path | None = None,
    scan_to: str | Path | None = None,
    landmarks: str | Path | None = None,
    report: str | Path | None = None,
    units: str = "m",
    spheres: int = SPHERES,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Fit a rigged hand and write it as a pack without objects, which `build` takes as a hand.

    joints_path: places of joints, for a mesh without a skin (`rig_of_joints`); scan_to, landmarks: a fitted hand that
    is warped onto a scan, and where the scan's wrist and fingertips are (`rig_of_scan`); report: a folder for
    `write_fit_report`.
    Returns {"out", "sha256", "hand": what the pack says of it, "poses": its errors pose by pose (`hand_quality`)}.
    Raises BadMesh, BadPack or PalmarError; nothing is written then.
    """
    where, say = str(path), progress or (lambda text, fraction: None)
    if units not in METRES_PER_UNIT:
        raise PalmarError("E-CONF", "--units", f"{units!r}; known are {', '.join(METRES_PER_UNIT)}")
    if report is not None:
        require_own_folder(Path(report), FILES, WHAT)
    say("reading", 0.0)
    with threadpool_limits(1):
        rig, registered = _read_rig(path, name_map, joints_path, scan_to, landmarks, units)
    frame = make_frame(where, rig, METRES_PER_UNIT[units])
    mesh = hand_mesh(where, rig, frame, METRES_PER_UNIT[units])
    # Small matrices: a second thread of the linear algebra would only wait for the first.
    with threadpool_limits(1):
        hand = fit_model(where, frame, mesh, spheres, seed, say)
        say("measuring", 0.9)
        quality = hand_quality(hand, seed)
    about = {
        "name": Path(path).stem,
        "side": frame.side,
        "source": rig.mesh.source,
        "sha256": rig.mesh.sha256,
        "units": units,
        "axes": frame.axis_source,
        "axis_error_deg": frame.axis_error_deg.tolist(),
        **registered,
        **hand.about,
        "error": {"rest": quality["rest"], "sweep": quality["sweep"], "volume_ratio": quality["volume_ratio"]},
    }
    tools = {package: version_of(package) for package in PACKAGES}
    sha256 = save_pack(out, AssetPack(replace(hand, about=about), {}, {"tools": tools, "seed": seed}))
    answer = {"out": str(out), "sha256": sha256, "hand": about, "poses": quality["poses"]}
    if report is not None:
        say("drawing", 0.95)
        write_fit_report(report, replace(hand, about=about), answer)
    return answer


def _read_rig(
    path: str | Path,
    name_map: str | Path | None,
    joints_path: str | Path | None,
    scan_to: str | Path | None,
    landmarks: str | Path | None,
    units: str,
) -> tuple[Rig, dict[str, Any]]:
    """The rig, and what `about` says of how it was registered."""
    given = {"--names": name_map, "--joints": joints_path, "--to": scan_to}
    flags = [flag for flag, value in given.items() if value is not None]
    if len(flags) > 1:
        raise PalmarError("E-CONF", flags[0], f"together with {flags[1]}; one of them says where the joints are")
    if (scan_to is None) != (landmarks is None):
        what = "--to HAND.pack and --landmarks, a CSV or JSON with wrist and five fingertips"
        raise PalmarError("E-CONF", "--landmarks" if scan_to is None else "--to", f"alone; a scan needs both {what}")
    if scan_to is not None and landmarks is not None:
        from palmar.tools.scan import rig_of_scan

        rig, scan = rig_of_scan(path, scan_to, landmarks, units)
        return rig, {"scan": scan}
    if joints_path is not None:
        return rig_of_joints(path, joints_path), {}
    return make_rig(str(path), read_skin(path), name_map), {}


def hand_mesh(where: str, rig: Rig, frame: HandFrame, metres_per_unit: float) -> HandMesh:
    """The rig's mesh in the palm frame, equal vertices welded, cut at the wrist and closed there."""
    vertices = (metres_per_unit * rig.mesh.vertices - frame.origin) @ frame.rotation.T
    weights = np.zeros((len(vertices), 16))
    np.add.at(weights.T, rig.link, rig.mesh.weights.T)
    vertices, weights, faces = _weld(vertices, weights, rig.mesh.faces)
    mix, faces = keep_above(vertices[:, 1], faces, 0.0)
    if not len(faces):
        raise BadMesh("E-RIG-EMPTY", where, "no triangle beyond the wrist; a hand is needed")
    vertices, weights = mixed(mix, vertices), mixed(mix, weights)
    closed, faces = cap(vertices, faces)
    palm_only = np.zeros((len(closed) - len(vertices), 16))
    palm_only[:, 0] = 1
    return HandMesh(closed, faces.astype(np.int32), np.vstack([weights, palm_only]), frame.rest_flexion_rad)


def fit_model(where: str, frame: HandFrame, mesh: HandMesh, spheres: int, seed: int, progress: Progress) -> HandModel:
    """Capsules, then palm spheres for what they leave of a mesh; `about` holds what was done."""
    palm_surface = palm_solid(where, mesh)
    palm_body = make_solid(*palm_surface)
    skin = skin_points(mesh, SPACING_M)
    bare = _model(frame, mesh, np.empty((0, 4)), _start(frame))
    rest = pose_hand(skin, bare, mesh.flexion_rad)
    bent = [pose_hand(skin, bare, sweep_angles(bare, degrees)) for degrees in SWEEP_DEG]
    capsules = _start(frame, skin, rest)
    for f in range(5):
        progress(FINGERS[f], 0.05 + 0.06 * f)
        poses = [_finger_skin(skin, posed, palm_body, f) for posed in (rest, *bent)]
        capsules[f] = fit_finger(poses, [1.0] + [SHARE] * len(bent), capsules[f])
    palm, parameters = palm_spheres(
        *palm_surface, spheres, seed, lambda text, part: progress(f"palm: {text}", 0.35 + 0.5 * part)
    )
    rows = capsules.reshape(15, 8)
    out = np.max([signed_distance(posed.solid, palm[:, :3])[0] + palm[:, 3] for posed in bent], axis=0)
    by_fingers = hybrid_gap(rest, np.empty((0, 4)), rows, rest.points_m)
    palm = palm[drop_useless(palm, rest.points_m[skin.real], by_fingers[skin.real], out)]
    palm = _balanced(skin, rest, palm, rows, seed)
    return replace(_model(frame, mesh, palm, capsules), about={"palm": {**parameters, "kept": len(palm)}})


def _finger_skin(skin: SkinPoints, posed: PosedHand, palm: Solid, finger: int) -> FingerSkin:
    at = np.isin(skin.link, 1 + 3 * finger + np.arange(3)) & posed.open_air
    points = posed.points_m[at]
    local = np.array([posed.local(1 + 3 * finger + j, points) for j in range(3)])
    return FingerSkin(local, signed_distance(palm, points)[0], np.sqrt(skin.area_m2[at] / skin.area_m2.mean()))


def _balanced(skin: SkinPoints, rest: PosedHand, palm: Array, capsules: Array, seed: int) -> Array:
    """Palm spheres that stand out as far as they leave bare, at the 99th percentile: capsules cover their seams."""
    gap = gap_samples(skin, rest, palm, capsules)[0]
    out = protrusion_samples(rest, palm, capsules, seed)[0]
    more = (weighted_quantile(*gap, 0.99) - weighted_quantile(*out, 0.99)) / 2000
    return palm + np.array([0, 0, 0, max(more, -0.5 * float(palm[:, 3].min()))])


def _start(frame: HandFrame, skin: SkinPoints | None = None, rest: PosedHand | None = None) -> Array:
    """Capsules (5, 3, 8) from joint to joint, as thick as the skin stands off the bone."""
    joints = np.concatenate([frame.joint_m, frame.tip_m[:, None]], axis=1)
    capsules = np.empty((5, 3, 8))
    for f in range(5):
        for j in range(3):
            bone = joints[f, j + 1] - joints[f, j]
            length = float(np.linalg.norm(bone))
            radius, end = 0.25 * length, length
            if skin is not None and rest is not None:
                offset = rest.local(1 + 3 * f + j, rest.points_m[skin.link == 1 + 3 * f + j]) - joints[f, j]
                along = offset @ (bone / length)
                radius = float(np.median(np.linalg.norm(offset - along[:, None] * (bone / length), axis=1)))
                end = max(float(along.max()) - radius, 0.2 * length) if j == 2 else length
            capsules[f, j] = [*joints[f, j], *(joints[f, j] + bone * end / length), radius, radius]
    return capsules


def _model(frame: HandFrame, mesh: HandMesh, palm: Array, capsules: Array) -> HandModel:
    """Limits and stiffness of the default hand, the limits wide enough for the pose of the mesh."""
    usual = default_hand()
    flexion = usual.flexion_limit_rad.copy()
    flexion[..., 0] = np.minimum(flexion[..., 0], mesh.flexion_rad)
    flexion[..., 1] = np.maximum(flexion[..., 1], mesh.flexion_rad)
    phalanx, radius = frusta_of(capsules)
    return HandModel(
        palm_spheres_m=palm,
        joint_m=frame.joint_m,
        flexion_axis=frame.flexion_axis,
        abduction_axis=frame.abduction_axis,
        phalanx_m=phalanx,
        phalanx_radius_m=radius,
        flexion_limit_rad=flexion,
        abduction_limit_rad=usual.abduction_limit_rad,
        joint_stiffness_n_m_per_rad=np.full((5, 3), STIFFNESS["joint_n_m_per_rad"]),
        palm_stiffness_n_per_m=np.array([STIFFNESS["palm_n_per_m"]]),
        palm_rotation_stiffness_n_m_per_rad=np.array([STIFFNESS["palm_rotation_n_m_per_rad"]]),
        mesh=mesh,
    )


def frusta_of(capsules: Array) -> tuple[Array, Array]:
    """D and E (..., 2, 3) and their radii (..., 2) of the frusta whose tapered capsules are given (..., 8)."""
    c1, c2, r = capsules[..., :3], capsules[..., 3:6], capsules[..., 6:]
    length = np.linalg.norm(c2 - c1, axis=-1, keepdims=True)
    sin = (r[..., :1] - r[..., 1:]) / length
    forward = (c2 - c1) / length
    # The sphere meets the cone where its radius, seen from the axis, is r cos(phi), r sin(phi) ahead of its centre.
    ends = np.stack([c1 + r[..., :1] * sin * forward, c2 + r[..., 1:] * sin * forward], axis=-2)
    return ends, r * np.sqrt(1 - sin * sin)


def _weld(vertices: Array, weights: Array, faces: NDArray[np.integer]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Vertices in one place become one: seams of a texture part them in the file."""
    size = 1e-6 * np.ptp(vertices, axis=0).max()
    _, first, number = np.unique(np.round(vertices / size), axis=0, return_index=True, return_inverse=True)
    welded = number.reshape(-1)[faces].astype(np.int64)
    whole = (welded[:, 0] != welded[:, 1]) & (welded[:, 1] != welded[:, 2]) & (welded[:, 2] != welded[:, 0])
    return vertices[first], weights[first], welded[whole]
