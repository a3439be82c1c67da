"""What a chart is drawn of: packs with their traces, packs that get scripted grasps, and objects made for it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palmar.errors import PalmarError
from palmar.files import nearest, require_file, stem_of
from palmar.model import AssetPack, load_pack, save_pack
from palmar.records import read_trace, write_trace

Progress = Callable[[str, float], None]

DEFAULT_SHAPES = ("ears",)
GRASP = "grasp"
MOST_LEAVES = 10_000  # that a grasp is placed on: more cost minutes and move no finger


@dataclass(frozen=True)
class Scene:
    """One trace on one object."""

    pack: Path
    trace: Path
    object: str
    name: str
    in_use: str = ""  # of a trace that uses part of the hand only


def find_scenes(
    files: Sequence[Path],
    shapes: Sequence[str],
    *,
    spheres: Sequence[int],
    grasps: int,
    fingers: bool,
    made: Path,
    progress: Progress,
) -> list[Scene]:
    """Packs and traces among `files` as they belong together; grasps of the objects that have no trace, and of shapes.

    shapes: built-in ones, made with a level for each count of `spheres`; without files and shapes DEFAULT_SHAPES.
    fingers: add, of the first grasp, those that use part of the hand. What is made goes into the folder `made`. Raises
    PalmarError, BadPack, BadTrace.
    """
    made.mkdir(parents=True, exist_ok=True)
    packs = [require_file(path) for path in files if path.suffix == ".pack"]
    traces = [require_file(path) for path in files if path.suffix == ".mcap"]
    for path in files:
        if path not in packs and path not in traces:
            raise PalmarError("E-USAGE", str(path), "is neither a .pack nor a .mcap")
    if traces and not packs:
        raise PalmarError("E-USAGE", str(traces[0]), "a trace without a pack; name the pack of its object too")
    scenes = [_place_trace(trace, packs) for trace in traces]
    to_grasp = [
        (pack, name) for pack in packs for name in load_pack(pack).objects if (pack, name) not in _taken(scenes)
    ]
    names = list(shapes) or ([] if packs else list(DEFAULT_SHAPES))
    for number, shape in enumerate(names):
        progress(f"making {shape}", number / len(names))
        to_grasp.append((_make_shape(shape, sorted(spheres), made), shape))
    if not grasps:
        to_grasp = []
    for pack, name in to_grasp:
        scenes += [_script(pack, name, seed, made) for seed in range(grasps)]
    if fingers and to_grasp:
        pack, name = to_grasp[0]
        scenes += _with_fingers(next(s for s in scenes if (s.pack, s.object) == (pack, name)), made)
    if not scenes:
        raise PalmarError("E-USAGE", "PACK", "nothing to replay: no trace, and no grasp asked for")
    return scenes


def _taken(scenes: Sequence[Scene]) -> set[tuple[Path, str]]:
    return {(scene.pack, scene.object) for scene in scenes}


def _place_trace(trace: Path, packs: Sequence[Path]) -> Scene:
    """The pack and object that a trace belongs to: the one it names, else the only one there is."""
    named = read_trace(trace).header.get("object", "")
    objects = [(pack, name) for pack in packs for name in load_pack(pack).objects]
    fitting = [(pack, name) for pack, name in objects if name == named] or objects
    if len(fitting) != 1:
        known = ", ".join(name for _, name in objects)
        found = f"names object {named!r}" if named else "names no object"
        raise PalmarError("E-OBJECT", str(trace), f"{found}; the packs hold {known}: give a pack with its own alone")
    pack, name = fitting[0]
    return Scene(pack, trace, name, f"{name} {stem_of(trace)}")


def _make_shape(shape: str, spheres: Sequence[int], made: Path) -> Path:
    """A pack of a built-in shape with a level of each count, unless it is there."""
    from palmar.tools.hand_file import default_hand
    from palmar.tools.shapes import SHAPES
    from palmar.tools.spread import spread_levels

    if shape not in SHAPES:
        known = f"{nearest(shape, list(SHAPES))}; known are {', '.join(SHAPES)}"
        raise PalmarError("E-MESH-SHAPE", shape, f"no such shape{known}")
    path = made / f"{shape}-{'-'.join(map(str, spheres))}.pack"
    if not path.is_file():
        vertices, faces = SHAPES[shape]()
        sha256 = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()
        about = {"source": f"shape:{shape}", "sha256": sha256, "units": "m", "metres_per_unit": 1.0, "closed": None}
        tree = spread_levels(vertices, faces, spheres, about)
        save_pack(path, AssetPack(default_hand(), {shape: tree}, {"tools": {}, "seed": 0}))
    return path


def _script(pack_path: Path, name: str, seed: int, made: Path) -> Scene:
    """A scripted grasp, made to fit the finest level of at most MOST_LEAVES spheres: the same for all levels."""
    from palmar.traces.scripted import load_scene, script_trace

    pack = load_pack(pack_path)
    path = made / f"{pack_path.stem}-{name}-{pack.sha256[:8]}-{GRASP}-{seed}.mcap"
    if not path.is_file():
        tree = pack.objects[name]
        few = max((k for k, level in enumerate(tree.levels) if len(level) <= MOST_LEAVES), default=0) + 1
        coarse = replace(tree, levels=tree.levels[:few], bounds=tree.bounds[:few])
        trace = script_trace(load_scene(GRASP)[0], pack.hand, coarse, seed)
        write_trace(path, replace(trace, header=trace.header | {"object": name}))
    return Scene(pack_path, path, name, f"{name} {GRASP} {seed}")


def _with_fingers(scene: Scene, made: Path) -> list[Scene]:
    from palmar.traces.fingers import IN_USE, with_fingers

    whole = read_trace(scene.trace)
    found = []
    for name, (fingers, palm) in IN_USE.items():
        path = made / f"{stem_of(scene.trace)}-{name.replace(' ', '-')}.mcap"
        write_trace(path, with_fingers(whole, fingers, palm))
        found.append(Scene(scene.pack, path, scene.object, f"{scene.name}, {name}", name))
    return found
