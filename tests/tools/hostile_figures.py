"""Every truncation and many mutations of a small mesh in each format, and the shared meshes, through `build`.

python tests/tools/hostile_figures.py [--mutations 400] [--format obj] [--meshes]

A file is refused with one line, or gives a pack whose mesh is what another, plain reader sees in the same bytes.
Counted are crashes (anything else than PalmarError), hangs (over 60 s of processor time) and silent wrong packs; exit
code 1 if there is one.
"""

import argparse
import json
import random
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from bad_meshes import BOX, GLB, OBJ, OFF, PLY, STL
from mesh_figures import DATA

from palmar.errors import PalmarError
from palmar.model import load_pack
from palmar.tools.pack import build

SMALL = {"obj": OBJ.encode(), "off": OFF.encode(), "ply": PLY, "stl": STL, "glb": GLB}
HANG_S = 60


class Hang(BaseException):
    """Over the time."""


def end_hang(*_: object) -> None:
    raise Hang


def plain_text(raw: bytes, extension: str) -> tuple[np.ndarray, np.ndarray]:
    lines = [line.split() for line in raw.decode("latin-1").splitlines()]
    if extension == "obj":
        vertices = [row[1:4] for row in lines if row[:1] == ["v"]]
        faces = [[int(corner.split("/")[0]) for corner in row[1:]] for row in lines if row[:1] == ["f"]]
        faces = [[k - 1 if k > 0 else k + len(vertices) for k in face] for face in faces]
    else:
        if extension == "off":
            words = [word for row in lines for word in row][1:]
            counts, rows = (int(words[0]), int(words[1])), words[3:]
        else:
            counts = [int(row[2]) for row in lines if row[:1] == ["element"]]
            end = next(k for k, row in enumerate(lines) if row == ["end_header"])
            rows = [word for row in lines[end + 1 :] for word in row]
        vertices = np.reshape(rows[: 3 * counts[0]], (-1, 3)).tolist()
        at, faces = 3 * counts[0], []
        for _ in range(counts[1]):
            size = int(rows[at])
            faces.append([int(word) for word in rows[at + 1 : at + 1 + size]])
            at += 1 + size
    triangles = [[face[0], face[k], face[k + 1]] for face in faces for k in range(1, len(face) - 1)]
    kind = np.float32 if extension == "ply" else float  # as its header says
    return np.array(vertices, dtype=kind).astype(float), np.array(triangles)


def plain_glb(raw: bytes) -> tuple[np.ndarray, np.ndarray]:
    size = struct.unpack_from("<I", raw, 12)[0]
    tree, data = json.loads(raw[20 : 20 + size]), raw[20 + size + 8 :]
    primitive = tree["meshes"][0]["primitives"][0]

    def numbers(accessor: int, width: int) -> np.ndarray:
        about = tree["accessors"][accessor]
        start = tree["bufferViews"][about["bufferView"]].get("byteOffset", 0) + about.get("byteOffset", 0)
        kind = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[about["componentType"]]
        return np.frombuffer(data, kind, about["count"] * width, start).reshape(about["count"], width)

    vertices = numbers(primitive["attributes"]["POSITION"], 3).astype(float)
    if (matrix := tree["nodes"][-1].get("matrix")) is not None:
        matrix = np.reshape(matrix, (4, 4)).T
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return vertices, numbers(primitive["indices"], 1).reshape(-1, 3)


def plain_triangles(raw: bytes, extension: str) -> np.ndarray:
    """(n, 3, 3) corners as the bytes say, without a check."""
    if extension == "stl":
        count = struct.unpack_from("<I", raw, 80)[0]
        rows = np.frombuffer(raw, np.dtype([("floats", "<f4", 12), ("attribute", "<u2")]), count, 84)
        return rows["floats"][:, 3:].reshape(-1, 3, 3).astype(float)
    vertices, faces = plain_glb(raw) if extension == "glb" else plain_text(raw, extension)
    return vertices[faces]


def in_order(triangles: np.ndarray) -> list[tuple[float, ...]]:
    """Each triangle from its least corner on, all sorted; those without an area are left out."""
    found = []
    for corners in np.round(triangles, 9) + 0.0:
        rows = [tuple(corner) for corner in corners.tolist()]
        if len(set(rows)) == 3:
            first = rows.index(min(rows))
            found.append(tuple(x for k in range(3) for x in rows[(first + k) % 3]))
    return sorted(found)


def outcome(raw: bytes, extension: str, folder: Path) -> str:
    """The code of a refusal, "built", or what must not be: "CRASH ...", "HANG", "WRONG ..."."""
    source, pack = folder / f"small.{extension}", folder / "small.pack"
    source.write_bytes(raw)
    pack.unlink(missing_ok=True)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        build([source], pack, spheres=8)
    except PalmarError as error:
        left = sorted(path.name for path in folder.iterdir())
        return error.code if left == [source.name] else f"WRONG: left {left}"
    except Hang:
        return "HANG"
    except Exception as error:  # what else comes out is what is looked for
        return f"CRASH {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    tree = load_pack(pack).objects["small"]
    try:
        expected = plain_triangles(raw, extension) * tree.about["metres_per_unit"]
    except (ValueError, IndexError, KeyError, StopIteration, TypeError, struct.error) as error:
        return f"WRONG: the plain reader reads nothing: {error!r}"
    same = in_order(expected) == in_order(tree.vertices_m[tree.faces])
    return "built" if same else "WRONG: another mesh than the file's"


def changed(raw: bytes, rng: random.Random) -> bytes:
    """The bytes with one to three of them changed, put in, left out, or a number made large."""
    out = bytearray(raw)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(out))
        match rng.randrange(5):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                out[at] = rng.choice(b"0123456789.-e \n/")
            case 2:
                out.insert(at, rng.randrange(256))
            case 3:
                del out[at : at + rng.randint(1, 8)]
            case _:
                out[at : at + 4] = rng.choice([b"\xff" * 4, bytes(4), b"9999"])
    return bytes(out)


def cases(options: argparse.Namespace) -> list[tuple[str, str, list[bytes]]]:
    """(what, format, files)"""
    rng = random.Random(options.seed)
    rows = []
    for extension in options.format or SMALL:
        raw = SMALL[extension]
        cut = [raw[:k] for k in range(0, len(raw) + 1, options.step)]
        rows.append((f"{extension} cut at every byte", extension, cut))
        rows.append((f"{extension} mutated", extension, [changed(raw, rng) for _ in range(options.mutations)]))
    return rows


def shared() -> list[Path]:
    paths = sorted([*(DATA / "spheres_objects").glob("*.obj"), *(DATA / "meshes").glob("*.*")])
    return [path for path in paths if path.suffix != ".json"]


def build_shared(path: Path, folder: Path) -> str:
    """As `outcome`, of a large file: refused or built, and then built closed."""
    said = []
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    for close in (False, True):
        try:
            about = build([path], folder / "x.pack", size_mm=90.0, error_mm=2.0, close=close)
            tree = load_pack(folder / "x.pack").objects[path.stem]
            said.append(f"{len(tree.leaves)} leaves, {len(about['warnings'])} warnings")
            break
        except PalmarError as error:
            said.append(error.code)
        except Hang:
            said.append("HANG")
        except Exception as error:
            said.append(f"CRASH {type(error).__name__}: {error}")
    signal.setitimer(signal.ITIMER_PROF, 0)
    return ", closed: ".join(said)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=400, help="of each format")
    parser.add_argument("--step", type=int, default=1, help="cut at every so many bytes")
    parser.add_argument("--format", action="append", choices=list(SMALL), help="one of them; all if left out")
    parser.add_argument("--meshes", action="store_true", help="the shared meshes as well")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    signal.signal(signal.SIGPROF, end_hang)
    assert len(BOX.faces) == 12
    bad, tried, worst_s = [], 0, 0.0
    print("| files | tried | built | refused |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        for what, extension, files in cases(options):
            counts: Counter[str] = Counter()
            for number, raw in enumerate(files):
                start = time.process_time()
                said = outcome(raw, extension, Path(name))
                worst_s = max(worst_s, time.process_time() - start)
                counts[said] += 1
                if said != "built" and not said.startswith("E-"):
                    bad.append(f"{what} {number}: {said}")
                    if len(bad) < 20:
                        Path(f"hostile_{len(bad)}.{extension}").write_bytes(raw)
                for path in Path(name).iterdir():
                    path.unlink()
            tried += len(files)
            refused = ", ".join(f"{code} {count}" for code, count in counts.most_common() if code.startswith("E-"))
            print(f"| {what} | {len(files)} | {counts['built']} | {refused} |", flush=True)
        for path in shared() if options.meshes else []:
            start = time.process_time()
            said = build_shared(path, Path(name))
            worst_s = max(worst_s, time.process_time() - start)
            tried += 1
            if "HANG" in said or "CRASH" in said:
                bad.append(f"{path.name}: {said}")
            print(f"| {path.name} | 1 | {said} | |", flush=True)
    crashes, hangs, wrong = (sum(f": {kind}" in line for line in bad) for kind in ("CRASH", "HANG", "WRONG"))
    print(
        f"\n{tried} files: {crashes} crashes, {hangs} hangs, {wrong} wrong packs; the slowest took {worst_s:.1f} CPU s"
    )
    print(*bad, sep="\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
