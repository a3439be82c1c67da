"""What Palmar stands on: python tests/supply.py lowest > pins.txt, licences > docs/licences.md, sbom < ALL > sbom.json.

lowest: the oldest version that each range of pyproject.toml allows, for `make lowest`, which installs and tests them.
licences: the packages that `pip install palmar` brings, directly and by each other, as they are installed here.
sbom: of the CycloneDX list of all that is installed here, those packages and what is compiled in; tools are left out.
"""

import json
import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution, metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

TOP = Path(__file__).resolve().parents[1]
TABLES = tomllib.loads((TOP / "pyproject.toml").read_text())
PROJECT = TABLES["project"]
# Compiled in: header files alone, nothing of them is installed.
COMPILED = {"cmeel-eigen": "MPL-2.0", "nlohmann-json": "MIT", "nanobind": "BSD-3-Clause"}
# Where a package names its licence in prose or not at all.
KNOWN = {"openexr": "BSD-3-Clause"}


def lowest() -> list[str]:
    """`name==version` of each direct dependency, of the build's and of the tests'."""
    pins = []
    for text in [
        *TABLES["build-system"]["requires"],
        *PROJECT["dependencies"],
        *PROJECT["optional-dependencies"]["test"],
    ]:
        requirement = Requirement(text)
        (bound,) = [each.version for each in requirement.specifier if each.operator == ">="]
        pins.append(f"{requirement.name}=={bound}")
    return pins


def licence_of(name: str) -> str:
    """The SPDX expression, or what the classifiers say, or a first line of the licence field."""
    about = metadata(name)
    if name in KNOWN:
        return KNOWN[name]
    if expression := about.get("License-Expression"):
        return expression
    classifiers = [c.split(" :: ")[-1] for c in about.get_all("Classifier") or [] if c.startswith("License ::")]
    classifiers = [c for c in classifiers if c != "OSI Approved"]
    text = (about.get("License") or "").strip().splitlines()
    return ", ".join(classifiers) or (text[0][:60] if text else "not stated")


def brought() -> dict[str, tuple[str, str]]:
    """Name -> (range in pyproject.toml, or who brings it; licence) of all that an installation brings."""
    found: dict[str, tuple[str, str]] = {}
    waiting = [(Requirement(text), "") for text in PROJECT["dependencies"]]
    while waiting:
        requirement, parent = waiting.pop(0)
        name = canonicalize_name(requirement.name)
        if name in found or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        try:
            needs = distribution(name).requires or []
        except PackageNotFoundError:
            continue
        found[name] = (f"by {parent}" if parent else str(requirement.specifier), licence_of(name))
        waiting += [(Requirement(text), name) for text in needs]
    return found


def licences() -> list[str]:
    rows = [f"| {name} | {range_} | {licence} |" for name, (range_, licence) in sorted(brought().items())]
    return [
        "# Licences",
        "",
        "Palmar is under Apache-2.0. An installation brings these packages, by their own statement; made by",
        "`python tests/supply.py licences`, as is the list with versions that `make sbom` writes in CycloneDX.",
        "",
        "| package | range, or who brings it | licence |",
        "| --- | --- | --- |",
        *rows,
        "",
        "Compiled into the core as headers: " + ", ".join(f"{name} ({what})" for name, what in COMPILED.items()) + ".",
        "libigl also ships a module `igl.copyleft`, which Palmar does not import. Extras (`scan`, `parquet`) and the",
        "tools of tests and lint are not listed.",
    ]


def sbom() -> list[str]:
    every = json.load(sys.stdin)
    kept = {canonicalize_name(name) for name in [*brought(), *COMPILED]}
    every["components"] = [part for part in every["components"] if canonicalize_name(part["name"]) in kept]
    if missing := kept - {canonicalize_name(part["name"]) for part in every["components"]}:
        sys.exit(f"not in the list that was given: {', '.join(sorted(missing))}")
    refs = {part["bom-ref"] for part in [*every["components"], every["metadata"]["component"]]}
    every["dependencies"] = [
        {"ref": row["ref"], "dependsOn": [ref for ref in row.get("dependsOn", []) if ref in refs]}
        for row in every["dependencies"]
        if row["ref"] in refs
    ]
    return [json.dumps(every, indent=2)]


if __name__ == "__main__":
    kinds = {"lowest": lowest, "licences": licences, "sbom": sbom}
    if len(sys.argv) != 2 or not re.fullmatch("|".join(kinds), sys.argv[1]):
        sys.exit(__doc__)
    print("\n".join(kinds[sys.argv[1]]()))
