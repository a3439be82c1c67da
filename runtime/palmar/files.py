"""Files as the command line meets them: of which kind, with what hash, damaged or not, and which pack a run needs."""

from __future__ import annotations

import difflib
import hashlib
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from palmar.errors import BadPack, BadTrace, PalmarError
from palmar.model import AssetPack, load_pack
from palmar.records import Run, Trace, read_run, read_trace

MCAP_MAGIC = b"\x89MCAP"


def require_file(path: Path) -> Path:
    """The path itself. Raises PalmarError if no file is there."""
    if path.is_file():
        return path
    if path.is_dir():
        raise PalmarError("E-FILE-MISSING", str(path), "is a folder; a file is needed")
    near = nearest(path.name, [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else [])
    raise PalmarError("E-FILE-MISSING", str(path), f"no such file{near}")


def require_place(path: Path) -> Path:
    """The path itself. Raises PalmarError if no file can be written under this name."""
    if path.is_dir():
        raise PalmarError("E-FILE-PLACE", str(path), "is a folder; the name of a file is needed")
    if not path.parent.is_dir():
        raise PalmarError("E-FILE-PLACE", str(path), f"the folder {path.parent} does not exist")
    return path


def require_folder(path: Path) -> Path:
    """The path itself. Raises PalmarError if something else than a folder has this name."""
    if path.exists() and not path.is_dir():
        raise PalmarError("E-FILE-PLACE", str(path), "is a file; the name of a folder is needed")
    return path


def require_own_folder(path: Path, own: set[str], what: str) -> None:
    """Raise PalmarError E-FILE-PLACE unless the name is free or of a folder with nothing but what `own` names.

    what: as such a folder is called.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise PalmarError("E-FILE-PLACE", str(path), "is a file; the name of a folder is needed")
    other = sorted({entry.name for entry in path.iterdir()} - own)
    if other:
        found = f"holds {other[0]!r}, which is of no {what}; a new folder or one with an earlier {what} is needed"
        raise PalmarError("E-FILE-PLACE", str(path), found)


@contextmanager
def whole_folder(path: Path, own: set[str], what: str) -> Iterator[Path]:
    """A new folder to write into, which takes the name `path` when the block ends well; else nothing is left of it.

    An earlier folder of the kind is replaced. Raises what `require_own_folder` does, before the block.
    """
    require_own_folder(path, own, what)
    path.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    try:
        fresh = work / "new"
        fresh.mkdir()
        yield fresh
        if path.exists():
            path.replace(work / "earlier")
        fresh.replace(path)
    finally:
        shutil.rmtree(work)


def nearest(word: str, allowed: Sequence[str]) -> str:
    """`; nearest: ...`, or nothing if nothing is near."""
    found = difflib.get_close_matches(word, allowed, n=1)
    return f"; nearest: {found[0]}" if found else ""


def sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stem_of(path: Path) -> str:
    """cup of cup.pack, cup.mcap and cup.run.mcap."""
    return path.name.removesuffix(".mcap").removesuffix(".run") if path.name.endswith(".mcap") else path.stem


def load_any(path: Path) -> AssetPack | Trace | Run:
    """Whatever the file holds. Raises BadPack or BadTrace if it is none of the three kinds."""
    require_file(path)
    with path.open("rb") as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return load_pack(path)
    try:
        return read_trace(path)
    except BadTrace as error:
        if not error.message.startswith("schema palmar.run/"):
            raise
    return read_run(path)


def lost_line(path: Path, lost: dict[str, int]) -> str:
    """What a damaged file had lost, in the form of an error; "" for a sound file."""
    if not any(lost.values()):
        return ""
    counts = ", ".join(f"{count} {what}" for what, count in lost.items() if count and what != "unclosed")
    ending = "it was not closed by its writer" if lost.get("unclosed") else ""
    what = "; ".join(part for part in (counts and f"lost {counts}", ending) if part)
    return f"E-TRACE-LOSS {path}: the file is damaged: {what}"


def find_packs(runs: Sequence[Path], packs: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Each run with the pack whose hash it names, among `packs` and the *.pack files beside the run.

    Raises BadPack if there is none.
    """
    hashes = {sha256_of(require_file(pack)): pack for pack in packs}
    pairs = []
    for path in runs:
        wanted = read_run(require_file(path)).header.get("pack_sha256", "")
        beside = sorted(path.parent.glob("*.pack"))
        hashes = {sha256_of(pack): pack for pack in beside if pack.is_file()} | hashes
        if wanted not in hashes:
            seen = ", ".join(str(pack) for pack in hashes.values()) or "none"
            raise BadPack(
                "E-PACK-HASH",
                str(path),
                f"needs the pack with sha256 {wanted[:16] or '(not stored)'}; looked at: {seen}; name it with --pack",
            )
        pairs.append((path, hashes[wanted]))
    return pairs
