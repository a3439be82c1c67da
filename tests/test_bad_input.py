"""Hostile and broken files through the command line, as a user meets them: one line, the exit code, nothing written.

`python tests/test_bad_input.py` prints the table of all rows, each run in a process of its own.
"""

import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from made_trace import make_trace
from safetensors.numpy import load_file, save_file

from palmar import _runtime, cli
from palmar.records import write_trace
from palmar.recover import recover_file
from palmar.traces.wire import Pty

sys.path.append(str(Path(__file__).parent / "tools"))
from bad_meshes import MESHES

HAND = (Path(__file__).parents[1] / "tools" / "default_hand.toml").read_text()
REPLAY = "replay good.pack bad.mcap -o out.run.mcap"
REPLAY_PACK = "replay bad.pack good.mcap -o out.run.mcap"
SET = "replay good.pack good.mcap -o out.run.mcap --set"
RECORD = "record --device opengloves --port glove -o out.mcap --duration-s 0.5"
BUILD_HAND = "build shape:cube --spheres-csv cube.csv -o out.pack --hand hand.toml"


@dataclass(frozen=True)
class Case:
    """A file to make, the command that meets it, and what must come of it."""

    name: str  # its row of the table first: B mesh, R trace, K pack, U device, G settings and hands
    make: Callable[[Path], object]
    command: str
    start: str  # of the line that the user sees; "" if the input is fine after all
    code: int = 2


def make_good(folder: Path) -> None:
    """good.pack of one cube, good.mcap of a second at 1 kHz above it, good.run.mcap of both, other.pack."""
    from palmar.tools.pack import build

    rows = [f"{x},{y},{z},0.012" for x, y, z in product((-0.02, 0.0, 0.02), repeat=3)]
    (folder / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows]))
    build(["shape:cube"], folder / "good.pack", spheres_csv=folder / "cube.csv")
    (folder / "cube.csv").write_text("\n".join(["x_m,y_m,z_m,radius_m", *rows[1:]]))
    build(["shape:cube"], folder / "other.pack", spheres_csv=folder / "cube.csv")
    write_trace(folder / "good.mcap", make_trace(1000))
    names = [str(folder / name) for name in ("good.pack", "good.mcap", "good.run.mcap")]
    _runtime.replay(*names, "", {}, {})


def content(folder: Path, name: str) -> bytearray:
    return bytearray((folder / name).read_bytes())


def bad_trace(change: Callable[[bytearray], bytes]) -> Callable[[Path], object]:
    return lambda folder: (folder / "bad.mcap").write_bytes(change(content(folder, "good.mcap")))


def damaged_pack(change: Callable[[bytearray], bytes]) -> Callable[[Path], object]:
    return lambda folder: (folder / "bad.pack").write_bytes(change(content(folder, "good.pack")))


def run_for_trace(folder: Path) -> None:
    (folder / "bad.mcap").write_bytes(content(folder, "good.run.mcap"))


def without_pack(folder: Path) -> None:
    (folder / "good.pack").unlink()


def flipped(raw: bytearray, at: int) -> bytearray:
    raw[at] ^= 1
    return raw


SHORT = bad_trace(lambda raw: raw[: len(raw) * 6 // 10])
FLIPPED = bad_trace(lambda raw: flipped(raw, len(raw) // 2))
FLIPPED_PACK = damaged_pack(lambda raw: flipped(raw, -9))
NAN = float("nan")


def foreign_trace(schema: str = "", version: str = "palmar.trace/1", **values: object) -> Callable[[Path], object]:
    """A trace that another program wrote by the book, with values that no trace may have."""

    def make(folder: Path) -> None:
        from mcap.reader import make_reader
        from mcap.writer import CompressionType
        from mcap_ros2.decoder import DecoderFactory
        from mcap_ros2.writer import Writer

        with (folder / "good.mcap").open("rb") as stream, (folder / "bad.mcap").open("wb") as out:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            with Writer(out, compression=CompressionType.NONE) as writer:
                (metadata,) = reader.iter_metadata()
                header = {k: v for k, v in metadata.metadata.items() if k != "crc32"}
                writer.add_metadata("palmar.trace", header | {"schema": version})
                kind = None
                for k, (known, _, message, decoded) in enumerate(reader.iter_decoded_messages()):
                    kind = kind or writer.register_msgdef(known.name, schema or known.data.decode())
                    row = {name: getattr(decoded, name) for name in decoded.__slots__}
                    if k == 500:
                        row |= values
                    writer.write_message("/haptic_hand", kind, row, log_time=message.log_time)

    return make


def bad_pack(change: Callable[[dict, dict], object]) -> Callable[[Path], object]:
    """A pack changed by somebody who left its checksum out: the checks behind it must hold alone."""

    def make(folder: Path) -> None:
        tensors, raw = load_file(folder / "good.pack"), content(folder, "good.pack")
        header = json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])
        manifest = json.loads(header["__metadata__"]["palmar"])
        del manifest["crc32"]
        change(tensors, manifest)
        save_file(tensors, folder / "bad.pack", {"palmar": json.dumps(manifest)})

    return make


def set_value(name: str, at: tuple[int, ...], value: float) -> Callable[[Path], object]:
    """One number of the leaves, or of the balls over them, said otherwise."""

    def change(tensors: dict, manifest: dict) -> None:
        leaves = len(manifest["objects"]["cube"]["levels"]) - 1
        tensors[f"object/cube/level_{leaves}/{name}"][at] = value

    return bad_pack(change)


def renamed(tensors: dict, manifest: dict, name: str) -> None:
    manifest["objects"][name] = manifest["objects"].pop("cube")
    for key in [key for key in tensors if key.startswith("object/cube/")]:
        tensors[key.replace("object/cube/", f"object/{name}/")] = tensors.pop(key)


def hand(old: str, new: str) -> Callable[[Path], object]:
    assert old in HAND, old
    return lambda folder: (folder / "hand.toml").write_text(HAND.replace(old, new, 1))


def nothing(folder: Path) -> None:
    pass


def glove(content: bytes, *, once: bool = False, unplugged: bool = False) -> Callable[[Path], object]:
    """A serial port `glove` whose other end says this as soon as it is opened, again and again or once, or is gone."""

    def make(folder: Path) -> None:
        wire = Pty(folder / "glove")

        def play() -> None:
            end = time.monotonic() + 60
            while not wire.heard() and time.monotonic() < end:
                time.sleep(0.001)
            said = False
            while wire.heard() and time.monotonic() < end and not unplugged:
                said = (said and once) or wire.send(content)
                time.sleep(0.005)
            wire.close()

        threading.Thread(target=play, daemon=True).start()

    return make


def recovered(folder: Path) -> None:
    SHORT(folder)
    recover_file(folder / "bad.mcap", folder / "sound.mcap")
    (folder / "sound.mcap").replace(folder / "bad.mcap")


def meshes() -> list[Case]:
    def write(name: str, raw: bytes | str) -> Callable[[Path], object]:
        return lambda folder: (folder / name).write_bytes(raw.encode() if isinstance(raw, str) else raw)

    return [
        Case(row, write(name, raw), f"build {name} --error-mm 5 -o out.pack", start, 2 if start else 0)
        for row, name, raw, start in MESHES
    ]


CASES = [
    *meshes(),
    Case("R1 trace cut at 60 %", SHORT, REPLAY, "E-TRACE-LOSS", 3),
    Case("R1 the same, shown", SHORT, "show bad.mcap", "E-TRACE-LOSS", 3),
    Case("R1 trace cut in its header", bad_trace(lambda raw: raw[:60]), REPLAY, "E-TRACE-SCHEMA"),
    Case("R2 one bit of a sample flipped", FLIPPED, REPLAY, "E-TRACE-LOSS", 3),
    Case("R2 the same, loss accepted", FLIPPED, REPLAY + " --accept-loss", "E-TRACE-LOSS", 3),
    Case(
        "R2 one bit of the header flipped",
        bad_trace(lambda raw: flipped(raw, raw.index(b"right"))),
        REPLAY,
        "E-TRACE-CRC",
    ),
    Case("R3 trace of a newer version", foreign_trace(version="palmar.trace/7"), REPLAY, "E-TRACE-SCHEMA"),
    Case("R3 a run where a trace belongs", run_for_trace, REPLAY, "E-TRACE-SCHEMA"),
    Case(
        "R3 samples with other fields",
        foreign_trace("float64 time_s\nfloat64[3] palm_position_m\n"),
        REPLAY,
        "E-TRACE-SCHEMA",
    ),
    Case("R4 time that goes back", foreign_trace(time_s=0.1), REPLAY, "E-TRACE-LOSS", 3),
    Case("R4 time that is no number", foreign_trace(time_s=NAN), REPLAY, "E-TRACE-VALUE"),
    Case("R4 an angle that is no number", foreign_trace(flexion_rad=[NAN] * 15), REPLAY, "E-TRACE-VALUE"),
    Case("R4 a rotation of length 2", foreign_trace(palm_rotation_wxyz=[2.0, 0, 0, 0]), REPLAY, "E-TRACE-VALUE"),
    Case("R5 what was recovered of a cut trace", recovered, REPLAY, "", 0),
    Case("R5 nothing to recover", bad_trace(lambda raw: raw[:2000]), "recover bad.mcap -o out.mcap", "E-TRACE-EMPTY"),
    Case("K1 one bit of a pack flipped", FLIPPED_PACK, REPLAY_PACK, "E-PACK-CRC"),
    Case("K1 the same, shown", FLIPPED_PACK, "show bad.pack", "E-PACK-CRC"),
    Case("K1 pack cut short", damaged_pack(lambda raw: raw[:-100]), REPLAY_PACK, "E-PACK-FORMAT"),
    Case("K1 a run's pack is another", without_pack, "report good.run.mcap -o out", "E-PACK-HASH"),
    Case("K1 pack that is not there", nothing, REPLAY_PACK, "E-FILE-MISSING"),
    Case("K1 tensor missing", bad_pack(lambda tensors, _: tensors.pop("hand/joint_m")), REPLAY_PACK, "E-PACK-MISSING"),
    Case(
        "K1 tensor too many",
        bad_pack(lambda tensors, _: tensors.update(evil=np.zeros(3))),
        "show bad.pack",
        "E-PACK-EXTRA",
    ),
    Case(
        "K1 pack of a newer version",
        bad_pack(lambda _, manifest: manifest.update(schema="palmar.pack/9")),
        REPLAY_PACK,
        "E-PACK-VERSION",
    ),
    Case("K2 ball outside its parent", set_value("bounds_m", (-1, 0), 0.9), "show bad.pack", "E-PACK-TREE"),
    Case("K2 balls in a circle", set_value("bounds_parent", (1,), 1), "show bad.pack", "E-PACK-TREE"),
    Case("K2 sphere without a ball", set_value("parent", (3,), 9999), "show bad.pack", "E-PACK-TREE"),
    Case("K2 radius that is no number", set_value("spheres_m", (3, 3), NAN), REPLAY_PACK, "E-PACK-VALUE"),
    Case("K2 negative radius", set_value("spheres_m", (3, 3), -0.01), REPLAY_PACK, "E-PACK-VALUE"),
    Case(
        "B10 object named ../../evil",
        bad_pack(lambda tensors, manifest: renamed(tensors, manifest, "../../evil")),
        "export bad.pack -o out",
        "E-PACK-NAME",
    ),
    Case(
        "K2 manifest without levels",
        bad_pack(lambda _, manifest: manifest["objects"].update(cube=3)),
        "show bad.pack",
        "E-PACK-FORMAT",
    ),
    Case(
        "K2 lean pack that says of its tuning nothing that can be read",
        bad_pack(lambda _, manifest: manifest["objects"]["cube"].update(tuned={"schema": "palmar.tuned/1", "seen": 3})),
        "replay bad.pack good.mcap -o out.run.mcap",
        "E-PACK-FORMAT",
    ),
    Case("U1 a port that sends garbage", glove(bytes(range(256))), RECORD, "E-GLOVE-SILENT"),
    Case("U1 a port at another baud rate", glove(b"\xe6\x00\x98\x7e" * 8), RECORD, "E-GLOVE-SILENT"),
    Case("U1 half a line and no more", glove(b"A100B2", once=True), RECORD, "E-GLOVE-SILENT"),
    # E-GLOVE-SILENT or E-GLOVE-PORT, by how far the recorder had come in opening it.
    Case("U2 a glove unplugged as it is opened", glove(b"", unplugged=True), RECORD, "E-GLOVE-"),
    Case("U2 a port that is not there", nothing, RECORD, "E-GLOVE-PORT"),
    Case("G1 unknown setting", nothing, f"{SET} iteratons=3", "E-CONF-KEY"),
    Case("G1 setting of another type", nothing, f"{SET} iterations=many", "E-CONF-TYPE"),
    Case("G1 setting below its range", nothing, f"{SET} reach_least_m=-1", "E-CONF-VALUE"),
    Case("G1 setting that is no number", nothing, f"{SET} rate_hz=nan", "E-CONF"),
    Case("G1 the same setting twice", nothing, f"{SET} rate_hz=90 --set rate_hz=100", "E-USAGE"),
    Case("G1 hand with an unknown key", hand("[palm", "colour = 3\n[palm"), BUILD_HAND, "E-CONF"),
    Case("G1 TOML with a key twice", hand("name =", 'name = "x"\nname ='), BUILD_HAND, "E-CONF"),
]


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    make_good(folder)
    return folder


def prepare(case: Case, good: Path, folder: Path) -> None:
    for path in good.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    case.make(folder)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bad_input_is_one_line_and_writes_nothing(case, good, tmp_path, monkeypatch, capsys):
    prepare(case, good, tmp_path)
    before = {path.name for path in tmp_path.iterdir()}
    monkeypatch.chdir(tmp_path)
    code = cli.run(case.command.split())
    captured = capsys.readouterr()
    assert code == case.code, captured.err
    written = {path.name for path in tmp_path.iterdir()} - before - {"glove"}
    if case.start:
        (line,) = captured.err.splitlines()
        assert re.fullmatch(r"E-[A-Z0-9-]+ [^:].*: .+", line) and line.startswith(case.start)
        assert written == ({"out.run.mcap"} if "--accept-loss" in case.command else set())
    else:
        assert captured.err == "" and written == {case.command.split("-o ")[1].split()[0]}


def print_table() -> int:
    """Each case as a user runs it. Gives 1 if one is not as it must be."""
    wrong = 0
    print("| input | exit | seconds | what the user saw |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        good = Path(name) / "good"
        good.mkdir()
        make_good(good)
        for k, case in enumerate(CASES):
            folder = Path(name) / str(k)
            folder.mkdir()
            prepare(case, good, folder)
            start = time.monotonic()
            command = [Path(sys.executable).parent / "palmar", *case.command.split()]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            seconds = time.monotonic() - start
            fits = done.returncode == case.code and done.stderr.startswith(case.start)
            wrong += not fits
            said = done.stderr.strip() or "(nothing: it is fine)"
            print(
                f"| {case.name} | {done.returncode}{'' if fits else ' WRONG'} | {seconds:.1f} | `{said}` |", flush=True
            )
    print(f"\n{len(CASES)} inputs, {wrong} not as they must be")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(print_table())
