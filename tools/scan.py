"""A scan of a hand -> a rig: cleaned (open3d), a rigged hand warped onto it, and how far the two are apart."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.errors import BadMesh, BadPack, PalmarError
from palmar.files import sha256_of
from palmar.model import FINGERS, load_pack
from palmar.skin import HandMesh
from palmar.tools.gltf_skin import SkinnedMesh
from palmar.tools.hand_joints import read_joints
from palmar.tools.hand_quality import PARTS
from palmar.tools.mesh import METRES_PER_UNIT, read_mesh
from palmar.tools.rig import NEEDED, Rig, link_of, make_rig, role_of
from palmar.tools.scan_match import Marks, beyond_wrist, is_skin, warp_to_landmarks, warp_to_points
from palmar.tools.scan_moved import move_onto
from palmar.tools.scan_warp import SCALE, SHIFT, TURN, Warp, make_warp
from palmar.tools.solid import make_solid, signed_distance
from palmar.tools.surface import spread

Array = NDArray[np.float64]

CLOUDS = (".xyz", ".pts", ".pcd")  # and .ply without faces
LANDMARKS = ("wrist", *(f"{finger}-tip" for finger in FINGERS))
# What may be given of each finger: joints, which stand as they are, and the tip.
CHAINS = [[f"thumb-{part}" for part in ("metacarpal", "proximal", "distal", "tip")]] + [
    [f"{finger}-{part}" for part in ("proximal", "intermediate", "distal", "tip")] for finger in FINGERS[1:]
]
VOXEL_M = 1.5e-3
LEAST_POINTS = 2000
LEAST_OF_PART = 15  # points of a phalanx
LARGEST_P99_MM = 4.0  # hands of other shapes leave up to 3.2, swapped fingers or a mirrored hand 5 and more
MM = 1e3


def rig_of_scan(path: str | Path, to: str | Path, landmarks: str | Path, units: str) -> tuple[Rig, dict[str, Any]]:
    """The rigged hand of the pack `to`, bent and stretched until it lies on a scan, as a rig in the scan's frame.

    path: a mesh, or points alone; landmarks: wrist and fingertips, in its frame and unit (`read_joints`). The surface
    is that of the rigged hand moved onto the scan: it is closed where the scan has holes, and its skin weights are
    known; joints that are given among the landmarks stand. Returns the rig and {"to", "to_sha256", "points",
    "residual_mm": {part: {"p50", "p99", "max"}}, "left_mm": {"p50", ...}}: of the scan's points to the warped hand
    before and after its surface was moved. Raises BadMesh, BadPack or PalmarError.
    """
    where, scale = str(path), METRES_PER_UNIT[units]
    hand = load_pack(to).hand
    if hand.mesh is None:
        raise BadPack(
            "E-CONF", str(to), "a hand without a mesh; one that `palmar fit-hand` made of a rigged mesh is needed"
        )
    marks = _landmarks(landmarks, scale)
    points, normals = clean_scan(where, _read_points(where, units))
    warp = make_warp(hand)
    numbers = warp_to_landmarks(warp, marks)
    near = is_skin(numbers, points)
    if near.sum() < LEAST_POINTS:
        raise BadMesh(
            "E-SCAN", where, f"{near.sum()} points beyond the wrist; the landmarks are of another frame or unit"
        )
    numbers = warp_to_points(warp, marks, numbers, points, normals)
    near = is_skin(numbers, points)
    points, normals = points[near], normals[near]
    vertices, chains = move_onto(warp, numbers, points, normals)
    hand_points = points[beyond_wrist(numbers, points) > 0]
    residual = _residual(where, hand.mesh, warp.vertices(numbers), hand_points)
    left = _residual(where, hand.mesh, vertices, hand_points)["all"]
    if left["p99"] > LARGEST_P99_MM:
        what = f"{left['p99']:.1f} mm (p99) are left to the warped hand; {LARGEST_P99_MM:g} mm are allowed"
        raise BadMesh("E-SCAN-FIT", where, f"{what}: check landmarks, side and --units")
    joints = marks.given & (np.arange(4) < 3)
    chains[joints] = marks.chains[joints]
    rig = _rig(where, warp, numbers, vertices, chains, scale)
    return rig, {
        "to": Path(to).name,
        "to_sha256": sha256_of(Path(to)),
        "points": len(points),
        "residual_mm": residual,
        "left_mm": left,
    }


def clean_scan(where: str, points: Array) -> tuple[Array, Array]:
    """Points (n, 3) thinned, without strays and smaller pieces, and outward normals (n, 3). Raises BadMesh."""
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud = cloud.remove_non_finite_points().voxel_down_sample(VOXEL_M)
    if len(cloud.points) >= LEAST_POINTS:
        cloud, _ = cloud.remove_statistical_outlier(nb_neighbors=20, std_ratio=2.5)
        label = np.asarray(cloud.cluster_dbscan(eps=4 * VOXEL_M, min_points=6))
        largest = np.bincount(label[label >= 0]).argmax() if (label >= 0).any() else 0
        cloud = cloud.select_by_index(np.flatnonzero(label == largest))
    if len(cloud.points) < LEAST_POINTS:
        found = f"{len(cloud.points)} points are left of {len(points)}, one for each {MM * VOXEL_M:g} mm and no strays"
        raise BadMesh("E-SCAN", where, f"{found}; at least {LEAST_POINTS} are needed, in the unit of --units")
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(24))
    cloud.orient_normals_consistent_tangent_plane(16)
    clean, normals = np.array(cloud.points), np.array(cloud.normals)
    outward = np.einsum("na,na->", clean - clean.mean(axis=0), normals)
    return clean, normals if outward > 0 else -normals


def _open3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as error:
        found = " ".join(str(error).split())
        raise PalmarError("E-CONF", "--to", f'scans need open3d ({found}): pip install "palmar[scan]"') from None
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


def _read_points(where: str, units: str) -> Array:
    """Points of a cloud, or even points on the triangles of a mesh, in metres."""
    if not _is_cloud(Path(where)):
        mesh = read_mesh(where, units=units)
        face, mix, _ = spread(mesh.vertices_m, mesh.faces, VOXEL_M / 2)
        return np.einsum("nk,nka->na", mix, mesh.vertices_m[mesh.faces[face]])
    return METRES_PER_UNIT[units] * np.asarray(_open3d().io.read_point_cloud(where).points)


def _is_cloud(path: Path) -> bool:
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() in CLOUDS
    with path.open("rb") as stream:
        header = stream.read(1 << 16).split(b"end_header")[0]
    return re.search(rb"element\s+face\s+[1-9]", header) is None


def _landmarks(path: str | Path, scale: float) -> Marks:
    """In metres."""
    roles = {role_of(name)[0]: place for name, place in read_joints(path).items()}
    missing = [name for name in LANDMARKS if name not in roles]
    if missing:
        found = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        raise BadPack("E-CONF", str(path), f"{found}; needed are {', '.join(LANDMARKS)}")
    unknown = [np.nan] * 3
    chains = [[roles.get(name, unknown) for name in chain] for chain in CHAINS]
    return Marks(scale * np.array(roles["wrist"]), scale * np.array(chains))


def _residual(where: str, mesh: HandMesh, vertices: Array, points: Array) -> dict[str, dict[str, float]]:
    """Distance of the scan's points to a warped mesh by part and of all. Raises BadMesh where a part has no points."""
    distance, _, face = signed_distance(make_solid(vertices, mesh.faces), points)
    distance, link = MM * np.abs(distance), mesh.weights[mesh.faces[face]].sum(axis=1).argmax(axis=1)
    found = {}
    for number, part in enumerate((*PARTS, "all")):
        of = distance if part == "all" else distance[link == number]
        if len(of) < LEAST_OF_PART:
            raise BadMesh(
                "E-SCAN-FIT", where, f"{len(of)} points of {part}; the scan lacks it or its landmarks are wrong"
            )
        found[part] = {"p50": float(np.median(of)), "p99": float(np.quantile(of, 0.99)), "max": float(of.max())}
    return found


def _rig(where: str, warp: Warp, numbers: Array, vertices: Array, chains: Array, scale: float) -> Rig:
    """The warped hand as a rigged file would give it; its rim goes down the forearm, to be cut at the wrist."""
    mesh = warp.hand.mesh
    assert mesh is not None
    flexion = warp.links(numbers[None]).flexion[0]
    down = -np.exp(numbers[SCALE]) * Rotation.from_rotvec(numbers[TURN]).as_matrix()[:, 1]
    rim = np.zeros(len(vertices), dtype=bool)
    rim[mesh.faces[mesh.is_cap]] = True
    joints, turns, weights = [], [], np.zeros((len(vertices), len(NEEDED)))
    for k, role in enumerate(NEEDED):
        link = link_of(role)
        finger, phalanx = divmod(link - 1, 3)
        if link == 0:
            joints.append(numbers[SHIFT])
            turns.append(np.eye(3))
        else:
            joints.append(chains[finger, phalanx + role.endswith("-tip")])
            turns.append(_turn_with(flexion[finger, phalanx]))
        if not role.endswith("-tip"):
            weights[:, k] = mesh.weights[:, link]
    skinned = SkinnedMesh(
        vertices=(vertices + 2e-3 * rim[:, None] * down) / scale,
        faces=mesh.faces[~mesh.is_cap],
        uv=None,
        weights=weights,
        names=NEEDED,
        parents=(-1,) * len(NEEDED),
        joint=np.array(joints) / scale,
        turn=np.array(turns),
        source=Path(where).name,
        sha256=sha256_of(Path(where)),
    )
    return make_rig(where, skinned)


def _turn_with(axis: Array) -> Array:
    """A turn (3, 3) whose x is the axis."""
    other = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    other /= np.linalg.norm(other)
    return np.stack([axis, other, np.cross(axis, other)], axis=1)
