"""Palmar: contact between a virtual hand and objects, at haptic rates, without penetration.

The stages are `palmar.tools` (mesh -> pack), `palmar._runtime` (pack + trace -> run), `palmar.traces` (device -> trace)
and `palmar.eval` (run -> numbers -> report). The three kinds of file are read through `load_pack`, `read_trace` and
`read_run`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    # On first use, so that `palmar --help` and `palmar --version` do not wait for numpy.
    for module in ("errors", "model", "records") if name in __all__ else ():
        found = getattr(import_module(f"palmar.{module}"), name, None)
        if found is not None:
            return found
    raise AttributeError(f"module 'palmar' has no attribute {name!r}")
