"""What a mesh file claims, held against its bytes before a reader sees it.

Readers accept broken files in silence: a cut STL becomes an empty scene, an index out of range a triangle to nowhere, a
count of four thousand million an allocation. Here every count, length and index that a file declares is checked first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from palmar.errors import BadMesh
from palmar.tools.mesh_glb import count_glb_triangles

MAX_FACES = 5_000_000

PLY_SCALARS = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1"},
    **{"short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2"},
    **{"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}


def count_triangles(where: str, extension: str, content: bytes) -> int:
    """Triangles that the file must give, from its own declarations. Raises BadMesh where they contradict its bytes.

    extension: a key of CHECKS, lower case.
    """
    if not content.strip():
        raise BadMesh("E-MESH-EMPTY", where, "the file is empty; at least one face is needed")
    triangles = CHECKS[extension](where, content)
    if triangles == 0:
        raise BadMesh("E-MESH-EMPTY", where, "no faces in the file; a mesh needs at least 4")
    if triangles > MAX_FACES:
        raise BadMesh("E-MESH-LIMIT", where, f"{triangles} faces; at most {MAX_FACES} are read")
    return triangles


def _cut(where: str, found: str) -> NoReturn:
    raise BadMesh("E-MESH-TRUNC", where, f"{found}: the file is cut off or damaged")


def _stl(where: str, content: bytes) -> int:
    declared = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    if declared >= 0 and len(content) == 84 + 50 * declared:
        # Normals are recomputed by every consumer; only the nine coordinates count.
        records = np.frombuffer(
            content, np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")]), declared, 84
        )
        bad = np.flatnonzero(~np.isfinite(records["corners"]).all(axis=1))
        if len(bad):
            corner = int(np.flatnonzero(~np.isfinite(records["corners"][bad[0]]))[0]) // 3
            raise BadMesh("E-MESH-NAN", f"{where}:vertex {3 * int(bad[0]) + corner}", "not a finite number")
        return declared
    if content.lstrip()[:5].lower() == b"solid" and b"\0" not in content:
        return _ascii_stl(where, content)
    if declared < 0:
        _cut(where, f"{len(content)} bytes; the header of a binary STL alone has 84")
    wanted = 84 + 50 * declared
    if len(content) < wanted:
        _cut(where, f"the header declares {declared} triangles, {wanted} bytes; the file has {len(content)}")
    raise BadMesh("E-MESH-HEADER", where, f"{declared} triangles take {wanted} bytes; the file has {len(content)}")


def _ascii_stl(where: str, content: bytes) -> int:
    rows = [row.split() for row in _lines(content)]
    corners = [(row, number) for number, row in enumerate(rows, 1) if row and row[0] == "vertex"]
    facets = sum(1 for row in rows if row and row[0] == "facet")
    ended = sum(1 for row in rows if row and row[0] == "endfacet")
    if not any(row and row[0] == "endsolid" for row in rows):
        _cut(where, f"{facets} facets begin and no `endsolid` follows")
    if len(corners) != 3 * facets or ended != facets:
        _cut(where, f"{facets} facets, {len(corners)} vertices, {ended} `endfacet`; 3 vertices a facet are needed")
    for vertex, (row, number) in enumerate(corners):
        _check_coordinates(f"{where}:{number}", vertex, row[1:])
    return facets


def _obj(where: str, content: bytes) -> int:
    vertices = triangles = 0
    # A line that ends in a backslash goes on in the next one.
    for number, row in enumerate(_lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")), 1):
        words = row.split()
        if not words or words[0] not in ("v", "f"):
            continue
        at = f"{where}:{number}"
        if words[0] == "v":
            _check_coordinates(at, vertices + 1, words[1:])
            vertices += 1
            continue
        if len(words) < 4:
            _cut(at, f"a face of {len(words) - 1} corners")
        for word in words[1:]:
            index = _integer(at, word.partition("/")[0])
            if index == 0 or index < -vertices:
                raise BadMesh("E-MESH-INDEX", at, f"vertex {index}; 1 to {vertices}, or -1 to -{vertices}, are there")
        triangles += len(words) - 3
    # Faces may stand before their vertices, so the highest index is known to be wrong only now.
    for number, row in enumerate(_lines(content), 1):
        if row[:2] in ("f ", "f\t"):
            for word in row.split()[1:]:
                digits = word.partition("/")[0]
                if digits.isdecimal() and int(digits) > vertices:
                    raise BadMesh("E-MESH-INDEX", f"{where}:{number}", f"vertex {digits}; the file has {vertices}")
    return triangles


def _off(where: str, content: bytes) -> int:
    rows = [(n, row.partition("#")[0].split()) for n, row in enumerate(_lines(content), 1)]
    rows = [(n, words) for n, words in rows if words]
    number, words = rows[0]
    if not words[0].endswith("OFF") or "BINARY" in words:
        raise BadMesh("E-MESH-HEADER", f"{where}:{number}", f"{words[0][:20]!r}; a text OFF file begins with `OFF`")
    counts, body = (words[1:], rows[1:]) if len(words) > 1 else (rows[1][1] if len(rows) > 1 else [], rows[2:])
    if len(counts) < 2:
        _cut(where, "no counts of vertices and faces")
    vertices, faces = (_integer(where, word) for word in counts[:2])
    if min(vertices, faces) < 0:
        raise BadMesh("E-MESH-HEADER", where, f"{vertices} vertices and {faces} faces declared")
    if len(body) < vertices + faces:
        _cut(where, f"{vertices} vertices and {faces} faces declared, {len(body)} lines follow")
    for vertex, (number, words) in enumerate(body[:vertices]):
        _check_coordinates(f"{where}:{number}", vertex, words)
    return sum(_corners(f"{where}:{n}", words, vertices) - 2 for n, words in body[vertices : vertices + faces])


def _corners(at: str, words: list[str], vertices: int) -> int:
    """Corners of a face given as `k i1 ... ik`, all in range."""
    corners = _integer(at, words[0])
    if corners < 3:
        raise BadMesh("E-MESH-HEADER", at, f"a face of {corners} corners; 3 or more are needed")
    if len(words) < 1 + corners:
        _cut(at, f"a face of {corners} corners with {len(words) - 1} indices")
    for word in words[1 : 1 + corners]:
        if not 0 <= _integer(at, word) < vertices:
            raise BadMesh("E-MESH-INDEX", at, f"vertex {word}; 0 to {vertices - 1} are there")
    return corners


def _ply(where: str, content: bytes) -> int:
    begin = content.find(b"end_header")
    if content[:3] != b"ply" or (begin >= 0 and b"\n" not in content[begin:]):
        raise BadMesh("E-MESH-HEADER", where, "a PLY file begins with `ply` and a header that `end_header` ends")
    if begin < 0:
        _cut(where, "the header has no `end_header`")
    body = content[content.index(b"\n", begin) + 1 :]
    kind, elements = _ply_header(where, content[:begin])
    if kind == "ascii":
        return _ply_text(where, elements, body)
    return _ply_binary(where, elements, body, ">" if kind == "binary_big_endian" else "<")


# An element: name, how many, and its properties as (name, type, type of the length or "" for a single number).
Element = tuple[str, int, list[tuple[str, str, str]]]


def _ply_header(where: str, header: bytes) -> tuple[str, list[Element]]:
    kind = ""
    elements: list[Element] = []
    for number, row in enumerate(_lines(header), 1):
        words = row.split()
        at = f"{where}:{number}"
        known = True
        if words[:1] == ["format"] and len(words) == 3:
            kind = words[1]
            known = kind in ("ascii", "binary_little_endian", "binary_big_endian")
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], _integer(at, words[2]), []))
            known = elements[-1][1] >= 0
        elif words[:1] == ["property"] and elements and len(words) in (3, 5):
            types = words[2:4] if words[1] == "list" and len(words) == 5 else ["", words[1]]
            known = types[1] in PLY_SCALARS and (types[0] in PLY_SCALARS or not types[0])
            elements[-1][2].append((words[-1], types[1], types[0]))
        elif words and words[0] not in ("ply", "comment", "obj_info"):
            known = False
        if not known:
            raise BadMesh("E-MESH-HEADER", at, f"{row.strip()[:60]!r} is not a PLY header line")
    names = [name for name, _, _ in elements]
    if not kind or names.count("vertex") != 1 or names.count("face") != 1:
        raise BadMesh(
            "E-MESH-HEADER", where, f"format {kind!r}, elements {names}; one `vertex` and one `face` are needed"
        )
    return kind, elements


def _ply_text(where: str, elements: list[Element], body: bytes) -> int:
    rows = [row.split() for row in _lines(body) if row.strip()]
    total = sum(count for _, count, _ in elements)
    if len(rows) < total:
        _cut(where, f"{total} elements declared, {len(rows)} lines follow")
    vertices = next(count for name, count, _ in elements if name == "vertex")
    first = triangles = 0
    for name, count, properties in elements:
        for index, words in enumerate(rows[first : first + count]):
            at = f"{where}:{name} {index}"
            if name == "face" and properties and properties[0][2]:
                triangles += _corners(at, words, vertices) - 2
            elif len(words) < len(properties):
                _cut(at, f"{len(words)} of {len(properties)} numbers")
            elif name == "vertex":
                # A number too many is a number torn in two: which of them are the coordinates, nobody knows.
                if len(words) > len(properties):
                    raise BadMesh("E-MESH-HEADER", at, f"{len(words)} numbers; the header declares {len(properties)}")
                _check_coordinates(f"{where}", index, words[:3])
        first += count
    return triangles


def _ply_binary(where: str, elements: list[Element], body: bytes, order: str) -> int:
    vertices = next(count for name, count, _ in elements if name == "vertex")
    offset = triangles = 0
    for name, count, properties in elements:
        least = sum(np.dtype(PLY_SCALARS[length or kind]).itemsize for _, kind, length in properties)
        if count * least > len(body) - offset:
            _cut(where, f"{count} x {name} take {count * least} bytes or more; {len(body) - offset} are left")
        rows = _ply_rows(f"{where}:{name}", count, properties, body, offset, order)
        offset += rows.nbytes
        for key, _, length in properties:
            if name == "face" and length and key in ("vertex_indices", "vertex_index") and count:
                lowest, highest = int(rows[key].min()), int(rows[key].max())
                if lowest < 0 or highest >= vertices:
                    wrong = highest if lowest >= 0 else lowest
                    raise BadMesh("E-MESH-INDEX", where, f"vertex {wrong}; 0 to {vertices - 1} are there")
                triangles += count * (rows[key].shape[1] - 2)
    if offset != len(body):
        raise BadMesh("E-MESH-HEADER", where, f"{len(body) - offset} bytes follow the last element")
    return triangles


def _ply_rows(
    at: str, count: int, properties: list[tuple[str, str, str]], body: bytes, offset: int, order: str
) -> np.ndarray:
    """The rows of one element as a structured array. The reader wants lists as long as those of the first row."""
    fields: list[tuple[Any, ...]] = []
    place = offset
    for key, kind, length in properties:
        item = np.dtype(order + PLY_SCALARS[kind])
        if length and count:
            size = np.dtype(order + PLY_SCALARS[length])
            if place + size.itemsize > len(body):
                _cut(at, f"element 0 begins at byte {place} of {len(body)}")
            items = int(np.frombuffer(body, size, 1, place)[0])
            if items < (3 if key.startswith("vertex") else 0):
                raise BadMesh("E-MESH-HEADER", f"{at} 0", f"a list of {items}; 3 or more are needed")
            fields += [(f"length of {key}", size), (key, item, (items,))]
            place += size.itemsize + items * item.itemsize
        else:
            fields.append((key, item))
            place += item.itemsize
    layout = np.dtype(fields)
    if count * layout.itemsize > len(body) - offset and not any(length for _, _, length in properties):
        _cut(at, f"{count} take {count * layout.itemsize} bytes; {len(body) - offset} are left")
    fit = min(count, (len(body) - offset) // layout.itemsize) if layout.itemsize else 0
    rows = np.frombuffer(body, layout, fit, offset)
    for key, _, length in properties:
        if length and count:
            other = np.flatnonzero(rows[f"length of {key}"] != layout[key].shape[0])
            if len(other):
                raise BadMesh("E-MESH-FORMAT", f"{at} {other[0]}", "lists of different length; export triangles only")
    if fit < count:
        _cut(at, f"{count} declared, {fit} are there")
    return rows


def _lines(content: bytes) -> list[str]:
    return content.decode("ascii", "replace").splitlines()


def _integer(at: str, word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise BadMesh("E-MESH-FORMAT", at, f"{word[:20]!r} where a whole number is needed") from None


def _check_coordinates(at: str, vertex: int, words: list[str]) -> None:
    if len(words) < 3:
        _cut(at, f"vertex {vertex} with {len(words)} coordinates")
    for word in words[:3]:
        try:
            finite = math.isfinite(float(word))
        except ValueError:
            raise BadMesh("E-MESH-FORMAT", at, f"vertex {vertex}: {word[:20]!r} where a number is needed") from None
        if not finite:
            raise BadMesh("E-MESH-NAN", f"{at}:vertex {vertex}", f"{word} is not a finite number")
    # Behind them may stand a weight of 1, a colour, a normal. Anything else is a number torn in two.
    if len(words) not in (3, 6, 7, 9, 10) and not (len(words) == 4 and words[3].rstrip("0") in ("1", "1.")):
        found = f"vertex {vertex} of {len(words)} numbers, {' '.join(words)[:40]!r}"
        raise BadMesh("E-MESH-FORMAT", at, f"{found}; 3 are needed, with a weight of 1, a colour or a normal at most")


CHECKS: dict[str, Callable[[str, bytes], int]] = {
    "obj": _obj,
    "stl": _stl,
    "ply": _ply,
    "glb": count_glb_triangles,
    "off": _off,
}
