"""The `check` verb: scenes -> objects, traces, runs, and whether every limit holds. It knows all stages, as `demo`.

The answer of each scene and solver is kept in a file of its own under `tallies` of the folder, so that a check that was
stopped, or that is asked for again with more, takes up what is there.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from palmar import _runtime
from palmar.check_case import Asked, check_scene_with, require_known
from palmar.eval.matrix import write_matrix
from palmar.files import sha256_of
from palmar.model import write_whole
from palmar.traces.scripted import SCENES, load_scene
from palmar.workers import workers

Progress = Callable[[str, float], None]

CHECK_SCHEMA = "palmar.check/1"
TALLY_SCHEMA = "palmar.tally/1"
SOURCES = ("palmar", "palmar.eval", "palmar.tools", "palmar.traces")

Answer = dict[str, Any]  # of a scene and solver: told, line, moment


def check_scenes(
    scenes: Sequence[str],
    asked: Asked,
    *,
    solvers: Sequence[str] = ("progressive",),
    jobs: int = 1,
    progress: Progress = lambda text, fraction: None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Replay every case and start of every scene by every solver and judge each run; a process holds one run at a time.

    scenes: names or TOML files; none for all of the suite. asked.out: a folder for check.json and the matrix of scenes
    and solvers, whose cells open the worst moment. jobs: processes.
    Returns schema, passed, scenes. Raises PalmarError, BadPack, BadTrace.
    """
    names = list(scenes) or suite()
    for name in names:
        require_known(name)
    pairs = [(name, solver) for name in names for solver in solvers]
    if asked.out is not None:
        (asked.out / "tallies").mkdir(parents=True, exist_ok=True)
    answers = []
    for answer in _answers(pairs, asked, jobs, progress):
        answers.append(answer)
        say(answer["line"])
    told = {
        "schema": CHECK_SCHEMA,
        "passed": all(answer["told"]["passed"] for answer in answers),
        "scenes": [answer["told"] for answer in answers],
    }
    if asked.out is not None:
        write_whole(asked.out / "check.json", json.dumps(told, indent=1).encode())
        shown = {(a["told"]["scene"], a["told"]["solver"]): a["moment"] for a in answers if a["moment"] is not None}
        told = {**told, "page": str(write_matrix(asked.out, told["scenes"], shown))}
    return told


def suite() -> list[str]:
    """The scenes of the stability suite: all that stand for themselves, by name."""
    names = sorted(path.stem for path in SCENES.glob("*.toml"))
    return [name for name in names if load_scene(name)[0]["kind"] != "grasp"]


def _answers(pairs: Sequence[tuple[str, str]], asked: Asked, jobs: int, progress: Progress) -> Iterator[Answer]:
    """The answer of each scene and solver in their order: what is kept, else anew, in so many processes."""
    kept = {pair: _kept(asked, name) for pair, name in zip(pairs, _keys(pairs, asked), strict=True)}
    todo = [pair for pair, path in kept.items() if _read(path) is None]
    if jobs < 2 or len(todo) < 2:
        for done, pair in enumerate(pairs):

            def within(text: str, part: float, done: int = done) -> None:
                progress(text, (done + part) / len(pairs))

            yield _answer(pair, asked, kept[pair], within)
        return
    with workers(min(jobs, len(todo))) as pool:
        waiting = {pair: pool.submit(_answer, pair, asked, kept[pair]) for pair in todo}
        for done, pair in enumerate(pairs):
            progress(" ".join(pair), done / len(pairs))
            yield waiting[pair].result() if pair in waiting else _answer(pair, asked, kept[pair])


def _answer(
    pair: tuple[str, str], asked: Asked, path: Path | None, progress: Progress = lambda text, part: None
) -> Answer:
    kept = _read(path)
    if kept is not None:
        return kept
    tally = check_scene_with(*pair, asked, progress)
    answer = {"told": tally.told(), "line": tally.line(), "moment": tally.moment}
    if path is not None:
        write_whole(path, json.dumps({"schema": TALLY_SCHEMA, "answer": answer}, indent=1).encode())
    return answer


def _kept(asked: Asked, key: str) -> Path | None:
    """Where the answer is kept. That of `runs` is not: its files are part of it."""
    return None if asked.out is None or asked.runs else asked.out / "tallies" / f"{key}.json"


def _read(path: Path | None) -> Answer | None:
    """What is kept there; None where nothing is, or where it was damaged since: it is worked out again."""
    if path is None or not path.is_file():
        return None
    try:
        table = json.loads(path.read_text())
    except ValueError:
        return None
    sound = isinstance(table, dict) and table.get("schema") == TALLY_SCHEMA and "answer" in table
    return table["answer"] if sound else None


def _keys(pairs: Sequence[tuple[str, str]], asked: Asked) -> list[str]:
    """A name for each answer that changes with whatever it depends on: the scene, the settings, and all of our code."""
    packages = [Path(str(import_module(package).__file__)).parent for package in SOURCES]
    code = [sha256_of(path) for folder in packages for path in sorted(folder.glob("*.py"))]
    code.append(sha256_of(Path(_runtime.__file__)))
    told = [code, asked.settings, asked.quick, asked.starts]
    return [
        hashlib.sha256(json.dumps([*told, load_scene(name)[2], Path(name).stem, solver]).encode()).hexdigest()[:24]
        for name, solver in pairs
    ]
