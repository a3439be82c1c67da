"""MCAP files as Isaac Teleop writes them, of joints that are known, made with the FlatBuffers package's own builder."""

import io

import numpy as np
from flatbuffers import Builder
from flatbuffers.number_types import Uint8Flags
from mcap.writer import CompressionType, Writer

from palmar.traces.isaac_teleop import JOINT, SCHEMA

STRUCTS = {
    "core.DeviceDataTimestamp": {
        "available_time_local_common_clock": 0,
        "sample_time_local_common_clock": 8,
        "sample_time_raw_device_clock": 16,
    },
    "core.HandJointPose": {"pose": 0, "is_valid": 28, "radius": 32},
    "core.HandJoints": {"poses": 0},
    "core.Point": {"x": 0, "y": 4, "z": 8},
    "core.Pose": {"position": 0, "orientation": 12},
    "core.Quaternion": {"x": 0, "y": 4, "z": 8, "w": 12},
}


def record(stamp_ns, joints):
    """One HandPoseRecord; joints (26,) of JOINT, or None for a hand that is not there."""
    builder = Builder(2048)
    hand = None
    if joints is not None:
        builder.StartObject(1)
        builder.Prep(4, 26 * JOINT.itemsize)
        for byte in reversed(np.asarray(joints).tobytes()):
            builder.Place(byte, Uint8Flags)
        builder.PrependStructSlot(0, builder.Offset(), 0)
        hand = builder.EndObject()
    builder.StartObject(2)
    if hand is not None:
        builder.PrependUOffsetTRelativeSlot(0, hand, 0)
    builder.Prep(8, 24)
    for value in (0, stamp_ns, stamp_ns + 1_000_000):
        builder.PrependInt64(value)
    builder.PrependStructSlot(1, builder.Offset(), 0)
    builder.Finish(builder.EndObject())
    return bytes(builder.Output())


def binary_schema(structs):
    """A binary schema with these structs: name -> field -> offset (reflection.fbs, as far as it is read)."""
    builder = Builder(1024)

    def vector(offsets):
        builder.StartVector(4, len(offsets), 4)
        for offset in reversed(offsets):
            builder.PrependUOffsetTRelative(offset)
        return builder.EndVector()

    objects = []
    for name, fields in structs.items():
        made = []
        for field, at in fields.items():
            text = builder.CreateString(field)
            builder.StartObject(13)
            builder.PrependUOffsetTRelativeSlot(0, text, 0)
            builder.PrependUint16Slot(3, at, 0)
            made.append(builder.EndObject())
        text, list_of_fields = builder.CreateString(name), vector(made)
        builder.StartObject(8)
        builder.PrependUOffsetTRelativeSlot(0, text, 0)
        builder.PrependUOffsetTRelativeSlot(1, list_of_fields, 0)
        builder.PrependBoolSlot(2, True, False)
        objects.append(builder.EndObject())
    list_of_objects = vector(objects)
    builder.StartObject(8)
    builder.PrependUOffsetTRelativeSlot(0, list_of_objects, 0)
    builder.Finish(builder.EndObject(), file_identifier=b"BFBS")
    return bytes(builder.Output())


def teleop_file(hands, structs=STRUCTS, compression=CompressionType.ZSTD):
    """The bytes of a file. hands: topic -> list of (stamp in ns, joints or None)."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=compression)
    writer.start()
    schema = writer.register_schema(SCHEMA, "flatbuffer", binary_schema(structs))
    for topic, records in hands.items():
        channel = writer.register_channel(topic, "flatbuffer", schema)
        for stamp_ns, joints in records:
            writer.add_message(channel, stamp_ns, record(stamp_ns, joints), stamp_ns)
    writer.finish()
    return stream.getvalue()
