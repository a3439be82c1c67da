"""Broken and hostile mesh files: row of the bad-input table -> what it is, file name, bytes, code that it must get."""

import gzip
import json
import struct

import numpy as np
import trimesh

BOX = trimesh.creation.box((0.04, 0.06, 0.1))
OBJ = BOX.export(file_type="obj")
OFF = BOX.export(file_type="off")
STL = BOX.export(file_type="stl")
PLY = BOX.export(file_type="ply", encoding="ascii")
GLB = BOX.export(file_type="glb")


def other_glb(change) -> bytes:
    """The box as GLB with its JSON changed."""
    size = int.from_bytes(GLB[12:16], "little")
    tree, rest = json.loads(GLB[20 : 20 + size]), GLB[20 + size :]
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def deep(tree: dict) -> None:
    n = 20_000
    tree["nodes"] = [{"children": [k + 1]} for k in range(n)] + [{"mesh": 0}]
    tree["scenes"] = [{"nodes": [0]}]


def many(tree: dict) -> None:
    tree["nodes"] = [{"children": [k + 1, k + 1]} for k in range(22)] + [{"mesh": 0}]
    tree["scenes"] = [{"nodes": [0]}]


def cycle(tree: dict) -> None:
    tree["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]
    tree["scenes"] = [{"nodes": [0]}]


def index_beyond() -> bytes:
    size = int.from_bytes(GLB[12:16], "little")
    tree = json.loads(GLB[20 : 20 + size])
    view = tree["bufferViews"][tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]["bufferView"]]
    at = 20 + size + 8 + view.get("byteOffset", 0)
    return GLB[:at] + struct.pack("<I", 4_000_000) + GLB[at + 4 :]


def facet(vertex: bytes) -> bytes:
    """The ASCII STL of the box with its first vertex said otherwise."""
    text = BOX.export(file_type="stl_ascii").encode()
    at = text.index(b"vertex ") + 7
    return text[:at] + vertex + text[text.index(b"\n", at) :]


def faces(change) -> str:
    mesh = BOX.copy()
    change(mesh)
    return mesh.export(file_type="obj")


def scaled(factor: float) -> str:
    return trimesh.Trimesh(BOX.vertices * factor, BOX.faces, process=False).export(file_type="obj", digits=40)


def flip_one(mesh: trimesh.Trimesh) -> None:
    mesh.faces[0] = mesh.faces[0][::-1]


COUNTED_STL = STL[:80] + struct.pack("<I", 4_000_000_000) + STL[84:]
COUNTED_PLY = PLY.replace(b"element vertex 8", b"element vertex 1000000000")
COUNTED_GLB = other_glb(lambda tree: tree["accessors"][0].update(count=2_000_000_000))
LONG_GLB = GLB[:12] + struct.pack("<I", 4_000_000_000) + GLB[16:]
FAR_GLB = other_glb(lambda tree: tree["buffers"][0].update(uri="../../secret.bin"))
FACES_PLY = PLY.rstrip().rsplit(b"\n", 1)[0]  # all but the last

# 600 MB of zeros, packed in pieces: gzip members may follow each other.
BOMB = gzip.compress(bytes(30 * 2**20), mtime=0) * 20

MESHES: list[tuple[str, str, bytes | str, str]] = [
    ("B1 STL cut in half", "cut.stl", STL[: len(STL) // 2], "E-MESH-TRUNC"),
    (
        "B1 STL of 4,000,000,000 faces",
        "count.stl",
        STL[:80] + struct.pack("<I", 4_000_000_000) + STL[84:],
        "E-MESH-TRUNC",
    ),
    ("B1 STL of 0 faces", "none.stl", STL[:80] + bytes(4), "E-MESH-EMPTY"),
    ("B1 empty file", "empty.stl", b"", "E-MESH-EMPTY"),
    ("B1 garbage named .stl", "garbage.stl", bytes(range(256)) * 8, "E-MESH-TRUNC"),
    ("B2 NaN vertex", "nan.obj", OBJ.replace("v ", "v nan ", 1), "E-MESH-NAN"),
    ("B2 infinite vertex", "inf.stl", facet(b"inf 0 0"), "E-MESH-NAN"),
    ("B3 face index out of range (OBJ)", "index.obj", OBJ + "\nf 1 2 99\n", "E-MESH-INDEX"),
    (
        "B3 face index out of range (PLY)",
        "index.ply",
        FACES_PLY + b"\n3 0 1 2000000\n",
        "E-MESH-INDEX",
    ),
    ("B3 index 4,000,000 of 24 vertices (GLB)", "index.glb", index_beyond(), "E-MESH-INDEX"),
    ("B4 open", "open.obj", faces(lambda m: m.update_faces(np.arange(len(m.faces)) > 0)), "E-MESH-OPEN"),
    ("B4 one face flipped", "flipped.obj", faces(flip_one), "E-MESH-WINDING"),
    ("B4 inside out", "inside.obj", faces(lambda m: m.invert()), "E-MESH-INSIDE-OUT"),
    ("B5 1e-12 of its size", "tiny.obj", scaled(1e-12), "E-MESH-UNITS"),
    ("B5 1e30 times its size", "huge.obj", scaled(1e30), "E-MESH-UNITS"),
    (
        "B6 PLY of 1,000,000,000 vertices",
        "count.ply",
        PLY.replace(b"element vertex 8", b"element vertex 1000000000"),
        "E-MESH-TRUNC",
    ),
    ("B6 PLY face of -5 corners", "list.ply", FACES_PLY + b"\n-5 0 1 2\n", "E-MESH-HEADER"),
    (
        "B6 GLB whose JSON is 4 GB long",
        "length.glb",
        GLB[:12] + struct.pack("<I", 4_000_000_000) + GLB[16:],
        "E-MESH-HEADER",
    ),
    (
        "B6 GLB accessor of 2,000,000,000 numbers",
        "accessor.glb",
        other_glb(lambda t: t["accessors"][0].update(count=2_000_000_000)),
        "E-MESH-HEADER",
    ),
    ("B6 GLB cut in half", "cut.glb", GLB[: len(GLB) // 2], "E-MESH-TRUNC"),
    ("B7 OBJ that names ../../../etc/passwd", "path.obj", "mtllib ../../../etc/passwd\n" + OBJ, ""),
    (
        "B7 GLB with a buffer at ../../secret",
        "path.glb",
        other_glb(lambda t: t["buffers"][0].update(uri="../../secret.bin")),
        "E-MESH-PATH",
    ),
    ("B8 GLB nodes in a circle", "cycle.glb", other_glb(cycle), "E-MESH-GRAPH"),
    ("B8 GLB of 20,000 nodes in each other", "deep.glb", other_glb(deep), "E-MESH-GRAPH"),
    ("B8 GLB of 4,194,304 instances", "many.glb", other_glb(many), "E-MESH-GRAPH"),
    ("B9 gzip of 600 kB that unpacks to 600 MB", "bomb.obj.gz", BOMB, "E-MESH-LIMIT"),
    ("B10 an archive (no archive is opened)", "mesh.zip", b"PK\3\4" + bytes(100), "E-MESH-FORMAT"),
    ("B11 a pickle named .npy (none is read)", "mesh.npy", b"\x93NUMPY\1\0" + bytes(100), "E-MESH-FORMAT"),
]
