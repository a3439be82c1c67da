"""Mesh files in: bytes -> vertices in metres and triangles, or one clear line that says what is wrong."""

from __future__ import annotations

import gzip
import hashlib
import io
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmar.errors import BadMesh
from palmar.tools.apart import read_apart
from palmar.tools.mesh_files import CHECKS, count_triangles

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
# A hand works on objects of this size; anything else is a wrong unit.
SMALLEST_M, LARGEST_M = 0.001, 2.0
# Without a unit, metres are believed only where the object is then of a size that a hand holds.
BELIEVED_M = (0.01, 1.0)
MAX_BYTES = 512 * 2**20
# A reader may take this much beside what it reads, and so many times that: a text of 100 MB becomes Python's objects.
READER_BYTES, READER_SHARE = 2**30, 20
READER_CPU_S, READER_BYTES_A_SECOND = 60, 10**6
MAX_RATIO = 100  # unpacked to packed, above 16 MiB

# Readers fail in as many ways as files are broken; each of these becomes one E-MESH-FORMAT.
READER_FAILURES: tuple[type[Exception], ...] = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, NameError),
    *(NotImplementedError, RuntimeError, TypeError, ValueError, ImportError, struct.error),
)


@dataclass(frozen=True)
class Mesh:
    """Triangles as a file gave them, equal vertices welded, in metres."""

    vertices_m: NDArray[np.float64]  # (v, 3)
    faces: NDArray[np.int32]  # (f, 3)
    source: str  # file name without its folder, or `shape:NAME`
    sha256: str  # of the file's bytes
    units: str  # "m", "cm", "mm", "in", or "size" where the longest side was given
    metres_per_unit: float

    @property
    def size_m(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.vertices_m, axis=0).max())


def read_mesh(path: str | Path, *, units: str | None = None, size_mm: float | None = None) -> Mesh:
    """Read an OBJ, STL, PLY, GLB or OFF file (or one of these with .gz) as one triangle mesh in metres.

    units: a key of METRES_PER_UNIT; size_mm: what the longest side shall be, instead of a unit. Without either a GLB is
    in metres, as its format says, and others are taken for metres where that gives 1 cm to 1 m.
    Scenes are flattened with their transforms. Nothing but this file is opened: materials, textures and buffers that it
    names are ignored or refused. Raises BadMesh with a code E-MESH-*.
    """
    where = str(path)
    if units is not None and size_mm is not None:
        raise BadMesh("E-MESH-UNITS", where, "both units and the longest side given; one of them settles the scale")
    if units is not None and units not in METRES_PER_UNIT:
        raise BadMesh("E-MESH-UNITS", where, f"units {units!r}; known are {', '.join(METRES_PER_UNIT)}")
    raw = _read_bytes(where, Path(path))
    name = Path(path).name
    packed = name.lower().endswith(".gz")
    extension = Path(name[:-3] if packed else name).suffix.lower().lstrip(".")
    if extension not in CHECKS:
        known = ", ".join(f".{known}" for known in CHECKS)
        raise BadMesh("E-MESH-FORMAT", where, f"{extension or 'no'!r} extension; {known} are read, also with .gz")
    content = _unpack(where, raw) if packed else raw
    expected = count_triangles(where, extension, content)
    points, corners = _read_triangles(where, extension, content)
    check_mesh(where, points, corners, expected)
    vertices, faces = weld(points, corners)
    if len(faces) == 0:
        raise BadMesh("E-MESH-EMPTY", where, f"all {expected} faces have two equal corners; none has an area")
    longest = float(np.ptp(vertices, axis=0).max())
    scale, units = _choose_scale(where, longest, extension, units, size_mm)
    return Mesh(vertices * scale, faces, name, hashlib.sha256(raw).hexdigest(), units, scale)


def check_mesh(where: str, vertices: NDArray[np.float64], faces: NDArray[np.int64], expected: int) -> None:
    """Raise BadMesh unless a reader's triangles are whole: as many as declared, indices in range, numbers finite."""
    if len(faces) == 0:
        raise BadMesh("E-MESH-EMPTY", where, "no faces were read; a mesh needs at least 4")
    if len(faces) != expected:
        raise BadMesh("E-MESH-TRUNC", where, f"{len(faces)} triangles were read; the file declares {expected}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.max() if faces.min() >= 0 else faces.min()
        raise BadMesh("E-MESH-INDEX", where, f"vertex {wrong}; 0 to {len(vertices) - 1} are there")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise BadMesh("E-MESH-NAN", f"{where}:vertex {bad[0]}", f"{vertices[bad[0]].tolist()} is not finite")


def weld(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Give equal vertices one number; drop unused vertices and faces of which two corners are now equal."""
    # + 0.0 turns -0.0 into 0.0, which unique would keep apart.
    unique, number = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    faces = number.reshape(-1)[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    used, faces_of_used = np.unique(faces, return_inverse=True)
    return unique[used], faces_of_used.reshape(-1, 3).astype(np.int32)


def _read_bytes(where: str, path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadMesh("E-MESH-LIMIT", where, f"{path.stat().st_size} bytes; at most {MAX_BYTES} are read")
        return path.read_bytes()
    except OSError as error:
        raise BadMesh("E-MESH-MISSING", where, f"{error.strerror}; a mesh file is needed") from None


def _unpack(where: str, raw: bytes) -> bytes:
    allowed = min(MAX_BYTES, max(16 * 2**20, MAX_RATIO * len(raw)))
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as packed:
            content = packed.read(allowed + 1)
    except EOFError:
        raise BadMesh("E-MESH-TRUNC", where, "the gzip stream ends early: the file is cut off") from None
    except (OSError, zlib.error) as error:
        raise BadMesh("E-MESH-HEADER", where, f"not a gzip file ({error})") from None
    if len(content) > allowed:
        raise BadMesh(
            "E-MESH-LIMIT", where, f"{len(raw)} bytes unpack to more than {allowed}; {MAX_RATIO}:1 is allowed"
        )
    return content


def _read_triangles(where: str, extension: str, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """What the format's reader makes of the content, in a process of its own."""
    import trimesh

    if extension in ("obj", "off") or b"\0" not in content:
        # Names and comments in any encoding; the numbers are ASCII.
        content = content.decode("ascii", "replace").encode("ascii", "replace")
    options: dict[str, Any] = (
        {"split_object": False, "group_material": False, "skip_materials": True} if extension == "obj" else {}
    )

    def read() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        stream = io.BytesIO(content)
        try:
            mesh = trimesh.load_scene(stream, file_type=extension, process=False, resolver=None, **options).to_mesh()
        except READER_FAILURES as error:
            raise BadMesh("E-MESH-FORMAT", where, f"the {extension.upper()} reader gave up ({error})") from None
        return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)

    points, corners = read_apart(
        where,
        read,
        memory_bytes=READER_BYTES + READER_SHARE * len(content),
        cpu_s=READER_CPU_S + len(content) // READER_BYTES_A_SECOND,
    )
    return points, corners


def _choose_scale(
    where: str, longest: float, extension: str, units: str | None, size_mm: float | None
) -> tuple[float, str]:
    """Metres per file unit, and its name. Raises BadMesh unless the longest side becomes 1 mm to 2 m."""
    if size_mm is not None:
        scale, units = size_mm * 0.001 / longest, "size"
    elif units is not None or extension == "glb":
        units = units or "m"
        scale = METRES_PER_UNIT[units]
    elif BELIEVED_M[0] <= longest <= BELIEVED_M[1]:
        scale, units = 1.0, "m"
    else:
        readings = ", ".join(f"{longest * metres * 1000:.4g} mm in {name}" for name, metres in METRES_PER_UNIT.items())
        raise BadMesh(
            "E-MESH-UNITS",
            where,
            f"the longest side is {longest:.4g} units of unknown length ({readings}); give --units m, cm, mm or in, "
            "or --size-mm for the longest side",
        )
    if not SMALLEST_M <= longest * scale <= LARGEST_M:
        raise BadMesh(
            "E-MESH-UNITS",
            where,
            f"the longest side becomes {longest * scale * 1000:.4g} mm; 1 mm to 2000 mm is allowed: "
            "give the right --units, or --size-mm for the longest side",
        )
    return scale, units
