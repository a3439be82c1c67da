"""What a CI system reads of a check: JUnit XML, one test case a number or scene, and a summary in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

from palmar.golden import say_failure
from palmar.model import write_whole


@dataclass(frozen=True)
class Verdict:
    """One line of a check."""

    scene: str
    solver: str
    name: str  # what was asked
    said: str  # what came of it
    passed: bool


def of_suite(answer: dict[str, Any]) -> list[Verdict]:
    """The scenes of `check_scenes`."""
    found = []
    for scene in answer["scenes"]:
        fails = [
            f"{name} {row['value']:.4g} {row['unit']} above {row['limit']:.4g} in {row['runs']} replays"
            f" ({', '.join(filter(None, [row['case'], 'start ' + str(row['start'])]))})"
            for name, row in scene["fails"].items()
        ] + [f"no contact: {case}" for case in scene["untouched"]]
        margin = "every number 0" if scene["margin_db"] is None else f"worst margin {scene['margin_db']:+.1f} dB"
        said = "; ".join(fails) if fails else f"{margin} in {scene['runs']} replays"
        found.append(Verdict(scene["scene"], scene["solver"], "limits", said, scene["passed"]))
    return found


def of_golden(answer: dict[str, Any]) -> list[Verdict]:
    """The numbers of `check_golden`: each that fails, and of each replay that it holds in all others."""
    found = []
    for replay in answer["replays"]:
        of = [f for f in answer["failures"] if all(f[key] == replay[key] for key in ("scene", "case", "solver"))]
        found += [
            Verdict(replay["scene"], replay["solver"], f"{f['metric']} {f['stat']}", say_failure(f), False) for f in of
        ]
        same = replay["numbers"] - len(of)
        if same:
            said = f"{same} of {replay['numbers']} numbers inside their tolerance"
            found.append(Verdict(replay["scene"], replay["solver"], "golden numbers", said, True))
    return found


def write_junit(path: Path, verdicts: Sequence[Verdict]) -> None:
    """One test suite; the class of a test case is its scene and solver."""
    failed = sum(not verdict.passed for verdict in verdicts)
    suite = Xml.Element("testsuite", name="palmar check", tests=str(len(verdicts)), failures=str(failed))
    for verdict in verdicts:
        case = Xml.SubElement(suite, "testcase", classname=f"{verdict.scene}.{verdict.solver}", name=verdict.name)
        if verdict.passed:
            Xml.SubElement(case, "system-out").text = verdict.said
        else:
            Xml.SubElement(case, "failure", message=verdict.said).text = verdict.said
    Xml.indent(suite)
    write_whole(path, Xml.tostring(suite, encoding="utf-8", xml_declaration=True) + b"\n")


def write_markdown(path: Path, verdicts: Sequence[Verdict]) -> None:
    """A heading with the counts and a table, what failed first."""
    failed = sum(not verdict.passed for verdict in verdicts)
    head = (
        f"## palmar check: {failed} of {len(verdicts)} failed"
        if failed
        else f"## palmar check: all {len(verdicts)} hold"
    )
    lines = [head, "", "| | scene | solver | what | |", "| --- | --- | --- | --- | --- |"]
    for verdict in sorted(verdicts, key=lambda verdict: verdict.passed):
        cells = (verdict.scene, verdict.solver, verdict.name, verdict.said)
        told = " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells)
        lines.append(f"| {'ok' if verdict.passed else '**fails**'} | {told} |")
    write_whole(path, ("\n".join(lines) + "\n").encode())
