"""GLB (binary glTF 2): chunks, accessors and nodes, held against the bytes before a reader sees them."""

from __future__ import annotations

import json
import struct
from typing import Any, NoReturn

import numpy as np

from palmar.errors import BadMesh

MAX_NODES = 10_000

GLB_SCALARS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
GLB_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def count_glb_triangles(where: str, content: bytes) -> int:
    """Triangles drawn by the scene of a GLB. Raises BadMesh where its lengths, ranges or nodes contradict its bytes."""
    if len(content) < 20:
        _raise_cut(where, f"{len(content)} bytes; the header of a GLB has 20")
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2:
        raise BadMesh("E-MESH-HEADER", where, f"magic {magic!r}, version {version}; b'glTF' and 2 are read")
    if length > len(content):
        _raise_cut(where, f"the header declares {length} bytes; the file has {len(content)}")
    chunks: dict[bytes, bytes] = {}
    offset = 12
    while offset + 8 <= length == len(content):
        size, kind = struct.unpack_from("<I4s", content, offset)
        if size > length - offset - 8:
            raise BadMesh("E-MESH-HEADER", where, f"a chunk of {size} bytes where {length - offset - 8} are left")
        chunks.setdefault(kind, content[offset + 8 : offset + 8 + size])
        offset += 8 + size
    if offset != len(content) or b"JSON" not in chunks:
        raise BadMesh(
            "E-MESH-HEADER", where, f"{len(content)} bytes do not divide into chunks with one JSON among them"
        )
    try:
        tree = json.loads(chunks[b"JSON"])
        return _glb_triangles(where, tree, chunks.get(b"BIN\0", b""))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise BadMesh("E-MESH-HEADER", where, f"its JSON is not that of a glTF 2 scene ({error!r})") from None


def _glb_triangles(where: str, tree: dict[str, Any], binary: bytes) -> int:
    packed = [name for name in tree.get("extensionsRequired", []) if "compression" in name or "quantization" in name]
    if packed:
        raise BadMesh("E-MESH-FORMAT", where, f"{packed[0]} is not read; export without compression")
    for buffer in tree.get("buffers", []):
        if "uri" in buffer:
            raise BadMesh("E-MESH-PATH", where, f"a buffer in {str(buffer['uri'])[:40]!r}; side files are never opened")
        if int(buffer["byteLength"]) > len(binary):
            _raise_cut(where, f"a buffer of {buffer['byteLength']} bytes; {len(binary)} are there")
    for number in range(len(tree.get("accessors", []))):
        glb_values(where, tree, binary, number)
    triangles_of = []
    for number, mesh in enumerate(tree.get("meshes", [])):
        at = f"{where}:mesh {number}"
        triangles_of.append(sum(_glb_primitive(at, tree, binary, primitive) for primitive in mesh["primitives"]))
    return sum(triangles_of[mesh] for mesh in _glb_drawn(where, tree))


def _glb_primitive(at: str, tree: dict[str, Any], binary: bytes, primitive: dict[str, Any]) -> int:
    mode = primitive.get("mode", 4)
    if mode < 4:
        return 0  # points and lines have no surface
    if mode != 4:
        raise BadMesh("E-MESH-FORMAT", at, "triangle strips and fans are not read; export plain triangles")
    points = glb_values(at, tree, binary, primitive["attributes"]["POSITION"])
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise BadMesh("E-MESH-NAN", f"{at}:vertex {bad[0]}", f"{points[bad[0]].tolist()} is not finite")
    if "indices" not in primitive:
        corners = len(points)
    else:
        index = glb_values(at, tree, binary, primitive["indices"])
        corners = len(index)
        if corners and int(index.max()) >= len(points):
            raise BadMesh("E-MESH-INDEX", at, f"vertex {int(index.max())}; 0 to {len(points) - 1} are there")
    if corners % 3:
        raise BadMesh("E-MESH-HEADER", at, f"{corners} corners; triangles take 3 each")
    return corners // 3


def glb_values(where: str, tree: dict[str, Any], binary: bytes, number: int) -> np.ndarray:
    """The values of an accessor, (count, columns), after its ranges are checked."""
    accessor = tree["accessors"][number]
    at = f"{where}:accessor {number}"
    kind = np.dtype("<" + GLB_SCALARS[accessor["componentType"]])
    columns, count = GLB_COLUMNS[accessor["type"]], accessor["count"]
    if not isinstance(count, int) or count < 0 or number < 0:
        raise BadMesh("E-MESH-HEADER", at, f"count {count!r}; a whole number from 0 is needed")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise BadMesh("E-MESH-FORMAT", at, "sparse accessors are not read; export plain arrays")
    view = tree["bufferViews"][accessor["bufferView"]]
    stride = view.get("byteStride", kind.itemsize * columns)
    start, skip, length = view.get("byteOffset", 0), accessor.get("byteOffset", 0), view["byteLength"]
    needed = skip + stride * (count - 1) + kind.itemsize * columns if count else 0
    if min(start, skip, length) < 0 or stride < kind.itemsize * columns:
        raise BadMesh("E-MESH-HEADER", at, f"offsets {start} and {skip}, length {length}, stride {stride}")
    if needed > length or start + length > len(binary):
        raise BadMesh(
            "E-MESH-HEADER", at, f"{count} elements need {needed} bytes of a view of {length} in {len(binary)}"
        )
    return np.ndarray((count, columns), kind, binary, start + skip, (stride, kind.itemsize))


def _glb_drawn(where: str, tree: dict[str, Any]) -> list[int]:
    """The mesh of every node that has one. Raises BadMesh unless the nodes are a forest of a reasonable size."""
    nodes = tree.get("nodes", [])
    if len(nodes) > MAX_NODES:
        raise BadMesh("E-MESH-GRAPH", where, f"{len(nodes)} nodes; at most {MAX_NODES} are read")
    parent_of: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            if not 0 <= child < len(nodes) or child in parent_of:
                raise BadMesh("E-MESH-GRAPH", f"{where}:node {number}", f"child {child} is missing or has two parents")
            parent_of[child] = number
    scenes = tree.get("scenes", [])
    roots = (
        scenes[tree.get("scene", 0)].get("nodes", [])
        if scenes
        else [n for n in range(len(nodes)) if n not in parent_of]
    )
    waiting, seen, drawn = list(roots), set(), []
    while waiting:
        number = waiting.pop()
        if number in seen or not 0 <= number < len(nodes):
            raise BadMesh("E-MESH-GRAPH", f"{where}:node {number}", "is missing, or is reached twice")
        seen.add(number)
        waiting += nodes[number].get("children", [])
        drawn += [nodes[number]["mesh"]] if "mesh" in nodes[number] else []
    return drawn


def _raise_cut(where: str, found: str) -> NoReturn:
    raise BadMesh("E-MESH-TRUNC", where, f"{found}: the file is cut off or damaged")
