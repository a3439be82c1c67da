"""MCAP recordings of NVIDIA's Isaac Teleop (OpenXR hand joints as FlatBuffers) -> Recording.

Layout: `HandPoseRecord` of src/core/schema/fbs/hand.fbs in github.com/NVIDIA/IsaacTeleop, on topics NAME/left_hand and
NAME/right_hand; each file carries the binary schema, against which places of numbers are checked before any is read.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from flatbuffers import encode, number_types
from flatbuffers.table import Table
from mcap.reader import make_reader

from palmar.errors import BadTrace, PalmarError
from palmar.traces.recording import Recording
from palmar.traces.webxr import SIDES, recording_of_joints

DEVICE = "isaac-teleop"
SCHEMA = "core.HandPoseRecord"
WRIST = (
    1  # XrHandJointEXT: 0 palm, 1 wrist, then thumb metacarpal to tip (2 to 5), index metacarpal to tip (6 to 10), ...
)
CHAINS = [[2, 3, 4, 5], *[[first + k for k in range(1, 5)] for first in (6, 11, 16, 21)]]
JOINT = np.dtype(
    {
        "names": ["position_m", "rotation_xyzw", "valid", "radius_m"],
        "formats": [("<f4", 3), ("<f4", 4), "u1", "<f4"],
        "offsets": [0, 12, 28, 32],
        "itemsize": 36,
    }
)
# Where the numbers are that are read here, by struct: field -> offset in bytes.
LAYOUT = {
    "core.Point": {"x": 0, "y": 4, "z": 8},
    "core.Quaternion": {"x": 0, "y": 4, "z": 8, "w": 12},
    "core.Pose": {"position": 0, "orientation": 12},
    "core.HandJointPose": {"pose": 0, "is_valid": 28, "radius": 32},
    "core.DeviceDataTimestamp": {"sample_time_local_common_clock": 8},
}
DATA, TIMESTAMP, JOINTS = 4, 6, 4  # places in the tables' vtables: field number x 2 + 4


def read_isaac_teleop(path: str | Path, *, side: str = "right") -> Recording:
    """Read one hand of a recording: metres, seconds of the host's clock at the time of the sample, from zero.

    side: which of the hands. A record without a hand, or with a joint that is not valid, is not tracked. The palm frame
    is the wrist's, as for WebXR, whose joints are the same. Raises PalmarError for the side, BadTrace E-TRACE-FORMAT,
    E-TRACE-SCHEMA, E-TRACE-EMPTY.
    """
    if side not in SIDES:
        raise PalmarError("E-CONF", "side", f"{side!r}; allowed are right, left")
    path = Path(path)
    content = _bytes(path)
    stamps, joints, inactive, topic = _records(content, side, path)
    time_s = 1e-9 * (stamps - stamps[0])
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if late.size:
        raise BadTrace("E-TRACE-TIME", f"{path}:{topic} record {late[0] + 1}", "its time does not increase")
    position = joints["position_m"].astype(np.float64)
    rotation = np.roll(joints["rotation_xyzw"][:, WRIST].astype(np.float64), 1, axis=1)
    length = np.linalg.norm(rotation, axis=1)
    used = [WRIST, *[joint for chain in CHAINS for joint in chain]]
    seen = ~inactive & (joints["valid"][:, used] > 0).all(axis=1) & (np.abs(length - 1.0) <= 1e-3)
    seen &= np.isfinite(position[:, used]).all(axis=(1, 2))
    if not seen.any():
        raise BadTrace("E-TRACE-EMPTY", f"{path}:{topic}", "no record has a hand with all joints valid")
    return recording_of_joints(
        *(DEVICE, path.name, hashlib.sha256(content).hexdigest(), side),
        time_s=time_s,
        wrist_m=position[:, WRIST],
        wrist_wxyz=rotation,
        chains_m=position[:, np.array(CHAINS)],
        seen=seen,
        assumption=f"Topic {topic}; times are those of the samples on the host's clock, from the first.",
    )


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadTrace("E-TRACE-MISSING", str(path), f"{error.strerror}; a recording is needed") from None


def _records(content: bytes, side: str, path: Path) -> tuple[Any, Any, Any, str]:
    """Sample times (n,) in ns, the joints of each record (n, 26), whether it has no hand (n,), and the topic."""
    stamps: list[int] = []
    joints: list[Any] = []
    inactive: list[bool] = []
    topics: set[str] = set()
    try:
        for schema, channel, message in make_reader(io.BytesIO(content), validate_crcs=True).iter_messages():
            if schema is None or schema.name != SCHEMA or not channel.topic.endswith(f"{side}_hand"):
                continue
            if channel.topic not in topics:
                _check_layout(schema.data, f"{path}:{channel.topic}")
                topics.add(channel.topic)
            stamp, found = decode_record(message.data, f"{path}:{channel.topic} record {len(stamps)}")
            stamps.append(stamp)
            inactive.append(found is None)
            joints.append(np.zeros(26, JOINT) if found is None else found)
    except BadTrace:
        raise
    except Exception as error:  # of damaged files the packages raise whatever their parser meets
        said = f"{type(error).__name__} {error}".strip()
        raise BadTrace("E-TRACE-FORMAT", str(path), f"not a sound MCAP file with FlatBuffers ({said})") from None
    if not topics:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"has no topic of {SCHEMA} that ends in {side}_hand")
    if len(topics) > 1:
        raise BadTrace("E-TRACE-FORMAT", str(path), f"has {len(topics)} such topics: {', '.join(sorted(topics))}")
    return np.array(stamps, dtype=np.int64), np.stack(joints), np.array(inactive), topics.pop()


def decode_record(data: bytes, where: str) -> tuple[int, Any]:
    """Sample time in ns and the joints (26,), None where the device had no hand. Raises BadTrace E-TRACE-FORMAT."""
    record = _root(data)
    at = record.Offset(TIMESTAMP)
    if not at or record.Pos + at + 24 > len(data):
        raise BadTrace("E-TRACE-FORMAT", where, "has no timestamp")
    stamp = int(np.frombuffer(data, "<i8", 3, record.Pos + at)[1])
    at = record.Offset(DATA)
    if not at:
        return stamp, None
    hand = Table(data, record.Indirect(record.Pos + at))
    at = hand.Offset(JOINTS)
    if not at or hand.Pos + at + 26 * JOINT.itemsize > len(data):
        raise BadTrace("E-TRACE-FORMAT", where, "its joints are cut")
    return stamp, np.frombuffer(data, JOINT, 26, hand.Pos + at)


def struct_layout(schema: bytes) -> dict[str, dict[str, int]]:
    """Offset of every field of every struct of a binary FlatBuffers schema (reflection.fbs)."""
    root = _root(schema)
    found: dict[str, dict[str, int]] = {}
    for struct in _tables(root, 4):  # Schema.objects
        fields = {}
        for field in _tables(struct, 6):  # Object.fields
            at = field.Offset(10)  # Field.offset
            fields[_text(field, 4)] = field.Get(number_types.Uint16Flags, field.Pos + at) if at else 0
        at = struct.Offset(8)  # Object.is_struct
        if at and struct.Get(number_types.BoolFlags, struct.Pos + at):
            found[_text(struct, 4)] = fields
    return found


def _check_layout(schema: bytes, where: str) -> None:
    found = struct_layout(schema)
    for struct, fields in LAYOUT.items():
        for field, offset in fields.items():
            if found.get(struct, {}).get(field) != offset:
                said = found.get(struct, {}).get(field, "missing")
                raise BadTrace(
                    "E-TRACE-SCHEMA", where, f"{struct}.{field} is at {said}, {offset} is read: another version"
                )


def _root(data: bytes) -> Table:
    return Table(data, encode.Get(number_types.UOffsetTFlags.packer_type, data, 0))


def _tables(table: Table, slot: int) -> list[Table]:
    at = table.Offset(slot)
    if not at:
        return []
    start = table.Vector(at)
    return [Table(table.Bytes, table.Indirect(start + 4 * k)) for k in range(table.VectorLen(at))]


def _text(table: Table, slot: int) -> str:
    return table.String(table.Pos + table.Offset(slot)).decode()
