"""The `import` verb: a foreign log as a trace of a user's hand, with an object put in its way if one is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palmar.errors import BadPack, PalmarError
from palmar.model import AssetPack, HandModel, load_pack
from palmar.profile import fit_to_profile, other_hand_warning
from palmar.records import Trace
from palmar.tools.default_hands import find_hand
from palmar.tools.profile_file import read_profile
from palmar.traces.device import import_file
from palmar.traces.put_object import put_object


def import_log(
    path: Path,
    out: Path,
    *,
    format: str | None = None,
    options: dict[str, Any] | None = None,
    hand_name: str | None = None,
    profile_path: Path | None = None,
    grasp: Path | None = None,
    object_name: str = "",
) -> dict[str, Any]:
    """What `import_file` answers, and "warnings": sentences.

    grasp: pack, built for the same hand, whose object is put where the hand closes. Raises BadPack, BadTrace,
    PalmarError; then nothing is written.
    """
    for option in options or {}:
        if option in ("format", "hand", "profile", "change"):
            raise PalmarError(
                "E-CONF", option, "no option of a format; what the verb itself takes has a flag of its own"
            )
    profile = None if profile_path is None else read_profile(profile_path)
    hand, warnings = None, []
    if hand_name is not None or profile is not None:
        hand = find_hand(hand_name)
    if hand is not None and profile is not None:
        warnings = [text for text in [other_hand_warning(hand, profile)] if text]
        hand = fit_to_profile(hand, profile)
    if grasp is None:
        if object_name:
            raise PalmarError("E-USAGE", "--object", "is of a pack; --grasp PACK is missing")
        answer = import_file(path, out, format=format, hand=hand, profile=profile, **(options or {}))
        return {**answer, "warnings": warnings}
    pack = load_pack(grasp)
    name = _object_of(pack, grasp, object_name)

    def change(trace: Trace) -> Trace:
        if hand is not None and hand.about["sha256"] != pack.hand.about.get("sha256"):
            raise BadPack("E-PACK-HAND", str(grasp), _differs(hand, pack.hand))
        return put_object(trace, pack.hand, pack.objects[name].leaves, name)

    answer = import_file(path, out, format=format, hand=hand, profile=profile, change=change, **(options or {}))
    return {**answer, "warnings": warnings}


def _object_of(pack: AssetPack, path: Path, name: str) -> str:
    names = list(pack.objects)
    if name in names or (not name and len(names) == 1):
        return name or names[0]
    found = f"{name!r} is not in it" if name else f"has {len(names)} objects"
    raise BadPack("E-PACK-OBJECT", str(path), f"{found}; --object names one of {', '.join(names)}")


def _differs(hand: HandModel, packed: HandModel) -> str:
    found = f"built for hand {packed.about.get('name', 'unnamed')}, the trace is of {hand.about['name']}"
    return f"{found}; build it with the same --hand and --profile"
