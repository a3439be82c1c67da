"""A host in Python that records through the shared library: python record.py LIBRARY FILE [FRAMES]."""

import ctypes
import sys
import time
from ctypes import POINTER, Structure, byref, c_char_p, c_double, c_int, c_size_t, c_uint32, c_uint64, c_void_p, sizeof

from host import Sample


class Recording(Structure):
    _fields_ = [
        ("size", c_uint32),
        ("ring_samples", c_uint32),
        ("device", c_char_p),
        ("hand", c_char_p),
        ("side", c_char_p),
        ("object", c_char_p),
        ("rate_hz", c_double),
    ]


class Counts(Structure):
    _fields_ = [
        ("size", c_uint32),
        ("failed", c_uint32),
        ("taken", c_uint64),
        ("written", c_uint64),
        ("dropped", c_uint64),
        ("refused", c_uint64),
    ]


def load(path: str) -> ctypes.CDLL:
    library = ctypes.CDLL(path)
    library.palmar_recorder_open.argtypes = [c_char_p, POINTER(Recording), POINTER(c_void_p), c_char_p, c_size_t]
    library.palmar_recorder_append.argtypes = [c_void_p, POINTER(Sample)]
    library.palmar_recorder_append.restype = c_int
    library.palmar_recorder_close.argtypes = [c_void_p, POINTER(Counts), c_char_p, c_size_t]
    return library


def read_device(frame: int) -> Sample:
    """A hand that goes up and closes by and by."""
    sample = Sample(size=sizeof(Sample), tracked=1, time_s=0.001 * frame)
    sample.haptic.palm.position_m[2] = 1e-6 * frame
    sample.haptic.palm.rotation_wxyz[0] = 1.0
    sample.haptic.flexion_rad[:] = [1e-3 * (frame % 1000)] * 15
    return sample


def main(library_path: str, path: str, frames: str = "1000") -> int:
    palmar = load(library_path)
    recorder = c_void_p()
    message = ctypes.create_string_buffer(256)
    recording = Recording(size=sizeof(Recording), device=b"example", hand=b"default", side=b"right", rate_hz=1000.0)
    if palmar.palmar_recorder_open(path.encode(), byref(recording), byref(recorder), message, len(message)):
        print(message.value.decode())
        return 2

    for frame in range(int(frames)):
        palmar.palmar_recorder_append(recorder, byref(read_device(frame)))
        time.sleep(0.001)

    counts = Counts(size=sizeof(Counts))
    code = palmar.palmar_recorder_close(recorder, byref(counts), message, len(message))
    print(f"{counts.written} written, {counts.dropped} dropped, {counts.refused} refused", message.value.decode())
    return code


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
