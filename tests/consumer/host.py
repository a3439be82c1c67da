"""A host in Python that knows nothing but the shared library: python host.py LIBRARY PACK."""

import ctypes
import sys
from ctypes import POINTER, Structure, byref, c_char_p, c_double, c_int, c_size_t, c_uint32, c_uint64, c_void_p, sizeof


# The structs of palmar.h, field by field.
class Placement(Structure):
    _fields_ = [("position_m", c_double * 3), ("rotation_wxyz", c_double * 4)]


class Pose(Structure):
    _fields_ = [("palm", Placement), ("flexion_rad", c_double * 15), ("abduction_rad", c_double * 5)]


class Sample(Structure):
    _fields_ = [
        ("size", c_uint32),
        ("tracked", c_uint32),
        ("time_s", c_double),
        ("haptic", Pose),
        ("has_object_pose", c_uint32),
        ("reserved", c_uint32),
        ("object", Placement),
    ]


class Contact(Structure):
    _fields_ = [
        ("link", c_uint32),
        ("object_sphere", c_uint32),
        ("palm_sphere", c_uint32),
        ("reserved", c_uint32),
        ("gap_m", c_double),
        ("force_n", c_double),
        ("point_m", c_double * 3),
        ("normal", c_double * 3),
    ]


class Result(Structure):
    _fields_ = [
        ("size", c_uint32),
        ("status", c_uint32),
        ("time_s", c_double),
        ("graphic", Pose),
        ("palm_force_n", c_double * 3),
        ("palm_torque_n_m", c_double * 3),
        ("joint_torque_n_m", c_double * 15),
        ("fingertip_force_n", c_double * 15),
        ("contacts", c_uint32),
        ("operations", c_uint32),
        ("state_hash", c_uint64),
    ]


def load(path: str) -> ctypes.CDLL:
    library = ctypes.CDLL(path)
    library.palmar_version.restype = c_char_p
    library.palmar_open.argtypes = [c_char_p, c_char_p, c_char_p, POINTER(c_void_p), c_char_p, c_size_t]
    library.palmar_step.argtypes = [c_void_p, POINTER(Sample), POINTER(Result)]
    library.palmar_step.restype = c_int
    library.palmar_contacts.argtypes = [c_void_p, POINTER(Contact), c_uint32]
    library.palmar_contacts.restype = c_uint32
    library.palmar_close.argtypes = [c_void_p]
    return library


def read_device(frame: int) -> Sample:
    """An open hand comes down on the object, 200 mm in a second, and stays."""
    sample = Sample(size=sizeof(Sample), tracked=1, time_s=0.001 * frame)
    sample.haptic.palm.position_m[:] = [0.0, -0.045, 0.22 - 0.0002 * min(frame, 1000)]
    sample.haptic.palm.rotation_wxyz[0] = 1.0
    return sample


def main(library_path: str, pack_path: str) -> int:
    palmar = load(library_path)
    print("palmar", palmar.palmar_version().decode())
    session = c_void_p()
    message = ctypes.create_string_buffer(256)
    if palmar.palmar_open(pack_path.encode(), None, b'{"rate_hz": 1000}', byref(session), message, len(message)):
        print(message.value.decode())
        return 1

    result = Result(size=sizeof(Result))
    contacts = (Contact * 64)()
    for frame in range(1500):
        if palmar.palmar_step(session, byref(read_device(frame)), byref(result)):
            return 1
        touching = palmar.palmar_contacts(session, contacts, len(contacts))
        if frame % 250 == 249:
            height = result.graphic.palm.position_m[2]
            force = result.palm_force_n[2]
            print(f"{result.time_s:.3f} s: palm at {height:.6f} m, {touching} contacts, force {force:.3f} N")
    print(f"state {result.state_hash:016x}, nearest gap {contacts[0].gap_m:.1e} m")
    palmar.palmar_close(session)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
