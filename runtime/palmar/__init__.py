"""Palmar: contact between a virtual hand and objects, at haptic rates, without penetration.

The stages are `palmar.tools` (mesh -> pack), `palmar._runtime` (pack + trace -> run), `palmar.traces` (device -> trace)
and `palmar.eval` (run -> numbers -> report). The three kinds of file are read through `load_pack`, `read_trace`, `read_run`.
"""

from palmar.errors import BadMesh, BadPack, BadTrace, GloveError, PalmarError
from palmar.model import AssetPack, HandModel, SphereTree, load_pack, save_pack
from palmar.records import Run, Trace, read_run, read_trace, write_trace

__all__ = [
    "AssetPack",
    "BadMesh",
    "BadPack",
    "BadTrace",
    "GloveError",
    "HandModel",
    "PalmarError",
    "Run",
    "SphereTree",
    "Trace",
    "load_pack",
    "read_run",
    "read_trace",
    "save_pack",
    "write_trace",
]
