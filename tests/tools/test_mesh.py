"""Meshes: what is read, what is refused and with which code."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palmar.errors import BadMesh
from palmar.tools.close import find_faults, require_closed
from palmar.tools.mesh import METRES_PER_UNIT, Mesh, read_mesh

BOX = trimesh.creation.box((0.04, 0.06, 0.1))


def export(mesh: trimesh.Trimesh, extension: str, **options: str) -> bytes:
    content = mesh.export(file_type=extension, **options)
    return content.encode() if isinstance(content, str) else content


FILES = {
    "a.obj": export(BOX, "obj"),
    "a.off": export(BOX, "off"),
    "a.ply": export(BOX, "ply", encoding="binary_little_endian"),
    "text.ply": export(BOX, "ply", encoding="ascii"),
    "a.stl": export(BOX, "stl"),
    "text.stl": export(BOX, "stl_ascii"),
    "a.glb": export(BOX, "glb"),
}


def read(folder: Path, name: str, content: bytes, **options: str | float) -> Mesh:
    path = folder / name
    path.write_bytes(content)
    return read_mesh(path, **options)


def refusal(folder: Path, name: str, content: bytes, **options: str | float) -> BadMesh:
    with pytest.raises(BadMesh) as caught:
        read(folder, name, content, **options)
    assert name in caught.value.where
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_welded_box(tmp_path, name):
    mesh = read(tmp_path, name, FILES[name])
    assert mesh.vertices_m.shape == (8, 3) and mesh.faces.shape == (12, 3) and mesh.faces.dtype == np.int32
    # 1e-8 m: what float32 coordinates of 5 cm can hold.
    np.testing.assert_allclose(np.abs(mesh.vertices_m), np.tile([0.02, 0.03, 0.05], (8, 1)), atol=1e-8)
    require_closed(name, mesh)


@pytest.mark.parametrize("name", FILES)
def test_every_shorter_file_is_refused_or_was_whole(tmp_path, name):
    whole = read(tmp_path, name, FILES[name])
    for length in [*range(0, len(FILES[name]), 11), *range(len(FILES[name]) - 12, len(FILES[name]))]:
        try:
            mesh = read(tmp_path, name, FILES[name][:length])
            require_closed(name, mesh)
        except BadMesh as error:
            assert error.code.startswith("E-MESH-")
        else:
            # Only a final line break, or digits of the last number that say the same, may be cut without harm.
            assert length > len(FILES[name]) - 12 and np.array_equal(mesh.faces, whole.faces)


@pytest.mark.parametrize("name", FILES)
def test_gzip_is_unpacked_and_a_cut_stream_refused(tmp_path, name):
    packed = gzip.compress(FILES[name], mtime=0)
    assert len(read(tmp_path, f"{name}.gz", packed).faces) == 12
    for length in range(0, len(packed), 17):
        assert refusal(tmp_path, f"{name}.gz", packed[:length]).code in (
            "E-MESH-TRUNC",
            "E-MESH-HEADER",
            "E-MESH-EMPTY",
        )


def test_a_gzip_bomb_is_refused(tmp_path):
    assert refusal(tmp_path, "a.obj.gz", gzip.compress(bytes(30 * 2**20))).code == "E-MESH-LIMIT"


@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(sorted(FILES)), at=st.floats(0, 1), value=st.integers(0, 255), junk=st.binary(max_size=6))
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path_factory, name, at, value, junk):
    content = bytearray(FILES[name])
    place = int(at * (len(content) - 1))
    content[place] = value
    content[place + 1 : place + 1 + len(junk)] = junk
    try:
        mesh = read(tmp_path_factory.getbasetemp(), name, bytes(content), size_mm=100)
    except BadMesh as error:
        assert error.code.startswith("E-MESH-") and "\n" not in str(error)
    else:
        assert np.isfinite(mesh.vertices_m).all() and mesh.faces.max() < len(mesh.vertices_m)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("content", [b"", b"  \n\t", bytes(range(256)) * 4, b"solid nothing\nendsolid\n"])
def test_empty_and_foreign_content_is_refused(tmp_path, name, content):
    error = refusal(tmp_path, name, content)
    if not content.strip():
        assert error.code == "E-MESH-EMPTY"


def test_stl_counts_that_lie_are_refused(tmp_path):
    stl = FILES["a.stl"]
    assert refusal(tmp_path, "a.stl", stl[:80] + struct.pack("<I", 4_000_000_000) + stl[84:]).code == "E-MESH-TRUNC"
    assert refusal(tmp_path, "a.stl", stl[:80] + struct.pack("<I", 0)).code == "E-MESH-EMPTY"
    assert refusal(tmp_path, "a.stl", stl + b"x").code == "E-MESH-HEADER"


def test_ply_counts_that_lie_are_refused(tmp_path):
    for name in ("a.ply", "text.ply"):
        more = FILES[name].replace(b"element vertex 8", b"element vertex 1000000000")
        assert refusal(tmp_path, name, more).code == "E-MESH-TRUNC"
        less = FILES[name].replace(b"element vertex 8", b"element vertex 7")
        refusal(tmp_path, name, less)
    text = FILES["text.ply"]
    last = text.rstrip().rsplit(b"\n", 1)
    assert refusal(tmp_path, "text.ply", last[0] + b"\n-5" + last[1][1:]).code == "E-MESH-HEADER"
    assert refusal(tmp_path, "text.ply", text.replace(b"format ascii", b"format morse")).code == "E-MESH-HEADER"


def quads_ply(faces: list[list[int]]) -> bytes:
    header = b"ply\nformat binary_big_endian 1.0\nelement vertex 8\n"
    header += b"property double x\nproperty double y\nproperty double z\n"
    header += b"element face %d\nproperty list uchar int vertex_indices\nend_header\n" % len(faces)
    points = np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.05) for z in (0, 0.05)])
    return header + points.astype(">f8").tobytes() + b"".join(struct.pack(f">B{len(f)}i", len(f), *f) for f in faces)


def test_ply_of_quads_is_read_and_one_of_mixed_faces_refused_by_name(tmp_path):
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    mesh = read(tmp_path, "cube.ply", quads_ply(faces))
    assert len(mesh.faces) == 12
    assert find_faults(mesh).volume_m3 == pytest.approx(0.05**3, rel=1e-12)
    assert refusal(tmp_path, "cube.ply", quads_ply(faces)[:-1]).code == "E-MESH-TRUNC"
    mixed = refusal(tmp_path, "cube.ply", quads_ply([*faces[:5], [1, 5, 7], [1, 7, 3]]))
    assert mixed.code == "E-MESH-FORMAT" and "face 5" in mixed.where


OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n"
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)


@pytest.mark.parametrize("bad", [b"nan", b"inf", b"-inf", b"1e999"])
@pytest.mark.parametrize(
    ("name", "content", "vertex"), [("a.obj", OBJ, 3), ("a.off", OFF, 2), ("a.ply", PLY, 2)], ids=["obj", "off", "ply"]
)
def test_a_vertex_that_is_no_number_is_named(tmp_path, name, content, vertex, bad):
    error = refusal(tmp_path, name, content.replace(b"0 1 0", b"0 " + bad + b" 0"), size_mm=100)
    assert error.code == "E-MESH-NAN" and error.where.endswith(f"vertex {vertex}")


def test_a_vertex_that_is_no_number_is_named_in_binary_files(tmp_path):
    stl = bytearray(FILES["a.stl"])
    stl[84 + 50 * 3 + 12 + 12 : 84 + 50 * 3 + 12 + 16] = struct.pack("<f", np.nan)
    error = refusal(tmp_path, "a.stl", bytes(stl))
    assert error.code == "E-MESH-NAN" and error.where.endswith("vertex 10")
    ply = bytearray(FILES["a.ply"])
    start = ply.index(b"end_header\n") + len(b"end_header\n")
    ply[start + 12 : start + 16] = struct.pack("<f", np.inf)
    error = refusal(tmp_path, "a.ply", bytes(ply))
    assert error.code == "E-MESH-NAN" and error.where.endswith("vertex 1")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", OBJ.replace(b"f 1 4 3", b"f 1 4 9")),
        ("a.obj", OBJ.replace(b"f 1 4 3", b"f 1 4 0")),
        ("a.obj", OBJ.replace(b"f 1 4 3", b"f 1 4 -5")),
        ("a.off", OFF.replace(b"3 0 1 3", b"3 0 1 4")),
        ("a.off", OFF.replace(b"3 0 1 3", b"3 0 1 -1")),
        ("a.ply", PLY.replace(b"3 0 1 2", b"3 0 1 3")),
        ("a.ply", FILES["a.ply"][:-4] + struct.pack("<i", 2_000_000)),
    ],
)
def test_an_index_out_of_range_is_refused(tmp_path, name, content):
    assert refusal(tmp_path, name, content, size_mm=100).code == "E-MESH-INDEX"


def glb_with(change, binary=None) -> bytes:
    """The box as GLB, its JSON changed by `change`."""
    content = FILES["a.glb"]
    length = struct.unpack_from("<I", content, 12)[0]
    tree = json.loads(content[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :] if binary is None else struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def index_accessor(tree):
    return tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]


def test_glb_ranges_nodes_and_paths_are_checked(tmp_path):
    assert len(read(tmp_path, "a.glb", glb_with(lambda tree: None)).faces) == 12
    cases = {
        "E-MESH-HEADER": [
            lambda tree: index_accessor(tree).update(count=2_000_000_000),
            lambda tree: index_accessor(tree).update(byteOffset=10_000),
            lambda tree: index_accessor(tree).update(count=-3),
            lambda tree: tree["meshes"][0]["primitives"][0].update(indices=77),
            lambda tree: tree.update(accessors="none"),
        ],
        "E-MESH-TRUNC": [lambda tree: tree["buffers"][0].update(byteLength=10**9)],
        "E-MESH-PATH": [lambda tree: tree["buffers"][0].update(uri="../../etc/passwd")],
        "E-MESH-GRAPH": [
            lambda tree: tree["nodes"][0].update(children=[0]),
            lambda tree: tree.update(nodes=tree["nodes"] + [{}] * 20_000),
        ],
        "E-MESH-FORMAT": [lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"])],
    }
    for code, changes in cases.items():
        for change in changes:
            assert refusal(tmp_path, "a.glb", glb_with(change)).code == code


def test_glb_index_out_of_range_is_refused(tmp_path):
    content = bytearray(FILES["a.glb"])
    length = struct.unpack_from("<I", content, 12)[0]
    tree = json.loads(content[20 : 20 + length])
    accessor = index_accessor(tree)
    assert accessor["componentType"] == 5125
    start = 28 + length + tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    content[start : start + 4] = struct.pack("<I", 4_000_000)
    assert refusal(tmp_path, "a.glb", bytes(content)).code == "E-MESH-INDEX"


def test_a_scene_is_flattened_with_its_transforms(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(BOX)
    scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([0.2, 0, 0]))
    mesh = read(tmp_path, "two.glb", scene.export(file_type="glb"))
    assert find_faults(mesh).bodies == 2
    np.testing.assert_allclose(np.ptp(mesh.vertices_m, axis=0), [0.24, 0.06, 0.1], atol=1e-7)  # float32 in the file


def test_an_unknown_extension_and_a_missing_file_are_refused(tmp_path):
    error = refusal(tmp_path, "a.fbx", b"anything")
    assert error.code == "E-MESH-FORMAT" and ".glb" in error.message
    with pytest.raises(BadMesh) as caught:
        read_mesh(tmp_path / "nowhere.stl")
    assert caught.value.code == "E-MESH-MISSING"


def test_units_settle_the_scale(tmp_path):
    for units, metres in METRES_PER_UNIT.items():
        big = trimesh.creation.box((0.04 / metres, 0.06 / metres, 0.1 / metres))
        assert read(tmp_path, "a.obj", export(big, "obj"), units=units).size_m == pytest.approx(0.1, rel=1e-6)
    assert read(tmp_path, "a.obj", FILES["a.obj"], size_mm=70).size_m == pytest.approx(0.07, rel=1e-12)
    assert read(tmp_path, "a.obj", FILES["a.obj"]).units == "m"


def test_a_size_that_no_hand_holds_is_refused_and_says_how_to_mend_it(tmp_path):
    big = export(trimesh.creation.box((40, 60, 100)), "obj")
    error = refusal(tmp_path, "a.obj", big)
    assert error.code == "E-MESH-UNITS" and "100 mm in mm" in error.message and "--size-mm" in error.message
    for options in (
        {"units": "m"},
        {"size_mm": 0.5},
        {"size_mm": -100.0},
        {"units": "mile"},
        {"units": "m", "size_mm": 9},
    ):
        assert refusal(tmp_path, "a.obj", big, **options).code == "E-MESH-UNITS"
    for scale in (1e-30, 1e30, 1e300):
        tiny = OBJ.replace(b"1 0 0", f"{scale} 0 0".encode()).replace(b"0 1 0", b"0 0 0").replace(b"0 0 1", b"0 0 0")
        assert refusal(tmp_path, "a.obj", tiny).code in ("E-MESH-UNITS", "E-MESH-EMPTY")
