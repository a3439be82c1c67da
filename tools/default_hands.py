"""Hands that need no file: the default hand, and the same for women and men of three sizes."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from palmar.errors import PalmarError
from palmar.model import HandModel, load_pack
from palmar.profile import Profile, fit_to_profile
from palmar.tools.hand_file import default_hand, read_hand
from palmar.tools.toml_file import nearest

DEFAULT = "default"
# Gordon et al. 2014, "2012 Anthropometric Survey of U.S. Army Personnel: Methods and Summary Statistics",
# NATICK/TR-15/007, 4082 men and 1986 women: hand length, mean and standard deviation, and mean hand breadth, mm.
SURVEY_MM = {"female": (181.1, 10.1, 78.2), "male": (193.3, 9.9, 88.3)}
# Standard normal deviates. Derived: lengths taken for normal; breadths taken to vary as much as lengths, relatively,
# since no deviation of theirs was at hand.
PERCENTILES = {"5": -1.645, "50": 0.0, "95": 1.645}
NAMES = [DEFAULT, *[f"{DEFAULT}:{sex}-{percentile}" for sex in SURVEY_MM for percentile in PERCENTILES]]


def find_hand(name: str | Path | None) -> HandModel:
    """The hand of a TOML file or a pack, or one of NAMES; None is the default hand. Raises BadPack, PalmarError."""
    if name is None or str(name) == DEFAULT:
        return default_hand()
    if not is_default(name):
        return load_pack(name).hand if _is_pack(Path(name)) else read_hand(name)
    if str(name) not in NAMES:
        known = ", ".join(NAMES)
        raise PalmarError("E-CONF", "--hand", f"{str(name)!r}{nearest(str(name), NAMES)}; known are {known}")
    sex, percentile = str(name).removeprefix(f"{DEFAULT}:").split("-")
    profile = survey_profile(sex, percentile)
    hand = fit_to_profile(default_hand(), profile)
    return replace(hand, about={key: value for key, value in hand.about.items() if key != "profile_sha256"})


def _is_pack(path: Path) -> bool:
    """Whether a file begins as a pack does: with the length of its header, eight bytes, and a brace. No text does."""
    try:
        with path.open("rb") as stream:
            start = stream.read(9)
    except OSError:
        return False
    return b"\0" in start[:8] and start[8:] == b"{"


def is_default(name: str | Path) -> bool:
    """Whether this is the name of a built-in hand and not of a file."""
    return str(name).partition(":")[0] == DEFAULT


def survey_profile(sex: str, percentile: str) -> Profile:
    """Hand length and breadth at a percentile of the survey, as a profile."""
    length, deviation, breadth = SURVEY_MM[sex]
    factor = 1.0 + PERCENTILES[percentile] * deviation / length
    measures = f"{length * factor:.6f} {breadth * factor:.6f}"
    return Profile(
        name=f"{sex}-{percentile}",
        side="right",
        source=f"Gordon et al. 2014, percentile {percentile} of hand length",
        hand_length_m=length * factor / 1e3,
        hand_breadth_m=breadth * factor / 1e3,
        sha256=hashlib.sha256(measures.encode()).hexdigest(),
    )
