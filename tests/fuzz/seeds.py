"""Small sound files for the fuzz targets to begin from, with CRCs that the fuzz build takes: python seeds.py FOLDER."""

import json
import re
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from palmar import _runtime
from palmar.model import AssetPack, SphereTree, save_pack
from palmar.pack_check import HAND_SHAPES
from palmar.records import Trace, write_trace
from palmar.tools.default_hands import find_hand
from palmar.tools.hierarchy import bounds_over

CHUNK, METADATA, DATA_END, FOOTER = 0x06, 0x0C, 0x0F, 0x02
ONE = (1).to_bytes(4, "little")


def with_crcs_of_one(raw: bytes) -> bytes:
    """An MCAP file with each of its CRCs as the fuzz build works it out: 1."""
    out, at = bytearray(raw), 8
    while at + 9 <= len(out) - 8:
        opcode, size = out[at], int.from_bytes(out[at + 1 : at + 9], "little")
        content, end = at + 9, at + 9 + size
        place = {CHUNK: content + 24, DATA_END: content, FOOTER: end - 4}.get(opcode)
        if place is not None:
            out[place : place + 4] = ONE
        if opcode == METADATA:
            out[content:end] = re.sub(rb"(crc32\x08\0\0\0)[0-9a-f]{8}", rb"\g<1>00000001", out[content:end])
        at = end
    return bytes(out)


def trace(count: int, object_pose: bool) -> Trace:
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return Trace(
        header={"device": "d", "hand": "h", "side": "left"},
        time_s=0.3 * np.arange(count),
        palm_position_m=np.linspace([0.0, 0.0, 0.06], [0.0, 0.0, 0.0], count),
        palm_rotation_wxyz=turn,
        flexion_rad=np.full((count, 5, 3), 0.3),
        abduction_rad=np.zeros((count, 5)),
        tracked=np.arange(count) != 1,
        has_object_pose=np.full(count, object_pose),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=turn,
    )


def pressing() -> Trace:
    """Two samples between which the fingers meet the spheres of `make_pack`, so that a run of them has contacts."""
    palm = np.array([[0.0, -0.12, 0.0], [0.0, -0.02, 0.0]])
    return replace(trace(2, True), palm_position_m=palm, tracked=np.ones(2, dtype=bool))


def make_pack(path: Path) -> None:
    hand = find_hand("default")
    few = {name: getattr(hand, name) for name in HAND_SHAPES} | {"palm_spheres_m": hand.palm_spheres_m[:2]}
    corners = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]], dtype=float)
    spheres = np.column_stack([corners, np.full(4, 0.01)])
    about = {"levels": [{"spheres": len(spheres)}]}
    tree = SphereTree(
        [spheres],
        [bounds_over(spheres)],
        corners,
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
        about,
    )
    save_pack(path, AssetPack(type(hand)(**few, about={"name": "h", "side": "left"}), {"o": tree}, {}))


def write_recording(path: Path) -> None:
    """One of each message that a glove's recording has."""
    recording = _runtime.DeviceRecording(str(path), {"device": "d", "hand": "h", "side": "left"})
    recording.add_device_bytes(0.1, b"A1\n")
    recording.add_pose_bytes(0.1, b"{}")
    recording.add_reading(0.1, [0.5] * 15, [np.nan] * 5, [0.0, 0.0], 0.0, 1)
    recording.add_sample(0.1, True, [0, 0, 0], [1, 0, 0, 0], [0.3] * 15, [0.0] * 5)
    recording.close({"end": "e"})


def main(folder: Path) -> None:
    for name in ("trace", "pack", "cdr", "settings"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    pack, source, run = folder / "x.pack", folder / "x.mcap", folder / "x.run.mcap"
    make_pack(pack)
    for count, object_pose in ((1, False), (3, True)):
        write_trace(source, trace(count, object_pose))
        (folder / "trace" / f"trace_{count}").write_bytes(with_crcs_of_one(source.read_bytes()))
    write_trace(source, pressing())
    _runtime.replay(str(pack), str(source), str(run), "", {"rate_hz": 5}, {})
    (folder / "trace" / "run").write_bytes(with_crcs_of_one(run.read_bytes()))
    write_recording(source)
    (folder / "trace" / "recording").write_bytes(with_crcs_of_one(source.read_bytes()))
    raw = re.sub(rb'(crc32\\": \\")[0-9a-f]{8}', rb"\g<1>00000001", pack.read_bytes())
    (folder / "pack" / "small").write_bytes(raw)

    # Of each message the first: its number in fuzz_cdr.cpp, then its bytes.
    from mcap.reader import NonSeekingReader

    for number, path in ((0, source), (2, run), (4, run), (5, source)):
        topics = {0: "/haptic_hand", 2: "/graphic_hand", 4: "/timing", 5: "/device_reading"}
        with path.open("rb") as stream:
            for _, _, message in NonSeekingReader(stream).iter_messages([topics[number]]):
                (folder / "cdr" / f"message_{number}").write_bytes(bytes([number]) + message.data)
                break
    (folder / "cdr" / "message_1").write_bytes(bytes([1, 0, 1, 0, 0]) + bytes(8) + b"\3\0\0\0abc")
    contact = (1, 7, 1, 3, 1, 2**32 - 1, 1, 0.5, 1, 0.25, 3, 0.1, 0.2, 0.3, 3, 0.0, 0.0, 1.0)
    columns = struct.pack("<dIB3xIIIII4xdI4xdI4x3dI4x3d", 0.5, *contact)
    (folder / "cdr" / "message_3").write_bytes(bytes([3, 0, 1, 0, 0]) + columns)
    settings = _runtime.default_settings()
    (folder / "settings" / "all").write_text(json.dumps(settings))
    (folder / "settings" / "one").write_text('{"rate_hz": 90.5}')
    for path in (pack, source, run):
        path.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
