"""The `report` verb: runs -> one HTML page, figures with the numbers behind them, metrics.json."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from palmar.errors import BadPack, BadTrace
from palmar.eval.case import Case, Reference
from palmar.eval.figures import write_figures
from palmar.eval.maps import write_maps
from palmar.eval.metrics import measure_case, metrics_json, verdict
from palmar.eval.page import build_page
from palmar.eval.panels import Judged, panels
from palmar.eval.recompute import recompute
from palmar.files import require_own_folder, whole_folder
from palmar.model import load_pack
from palmar.records import Run, read_run

Progress = Callable[[int, int, str], None]
SameStart = Callable[[Run, Path], Run]  # a run and its pack -> the converged answer to its steps, each on its own
OF_A_REPORT = {"index.html", "metrics.json", "figures", "maps"}


def write_report(
    runs: list[tuple[Path, Path]],
    out_dir: str | Path,
    *,
    progress: Progress | None = None,
    same_start: SameStart | None = None,
    references: list[Path] | None = None,
) -> dict[str, Any]:
    """Judge runs, each with the pack it was made with, and write a folder of index.html, figures/ and metrics.json.

    What cost_excess is measured against: same_start, and of `references` the run of the same trace on the same pack.
    progress(done, total, what) is called as the work goes on. Returns {"page", "passed", "runs"}, each run {"run",
    "passed", "verdict"}. The folder appears whole or not at all; an earlier report of that name is replaced. Raises
    BadTrace or BadPack if a file breaks its format, a pack is not the one its run names or a reference is of no run,
    PalmarError if the folder holds anything but a report.
    """
    out_dir = Path(out_dir)
    require_own_folder(out_dir, OF_A_REPORT, "report")
    total = 2 * len(runs) + 1
    done = 0

    def tell(what: str) -> None:
        nonlocal done
        if progress:
            progress(done, total, what)
        done += 1

    own_ways = _own_ways(references or [], [Path(run) for run, _ in runs])
    judged = []
    for name, (run_path, pack_path) in zip(run_names(runs), runs, strict=True):
        tell(f"judging {name}")
        judged.append(judge_run(name, Path(run_path), Path(pack_path), same_start, own_ways))
    with whole_folder(out_dir, OF_A_REPORT, "report") as folder:
        fill_folder(judged, folder, tell)
    return {
        "page": str(out_dir / "index.html"),
        "passed": all(one.passed for one in judged),
        "runs": [
            {
                "run": one.name,
                "passed": one.passed,
                "verdict": one.verdict,
                "recomputed": one.recomputed.told() if one.recomputed else None,
            }
            for one in judged
        ],
    }


def _own_ways(references: list[Path], runs: list[Path]) -> dict[tuple[str | None, ...], Run]:
    """Reference runs by what they answer. Raises BadTrace if one is of none of the runs."""
    asked = {_work_of(read_run(path)) for path in runs} if references else set()
    found = {}
    for path in references:
        run = read_run(path)
        if _work_of(run) not in asked:
            message = "a run of another trace, pack, object, rate or resampling than every run to judge"
            raise BadTrace("E-RUN-REFERENCE", str(path), message)
        found[_work_of(run)] = run
    return found


def _work_of(run: Run) -> tuple[str | None, ...]:
    """What two runs share that answer the same haptic hand, step by step."""
    return tuple(run.header.get(key) for key in ("pack_sha256", "trace_sha256", "object", "rate_hz", "resample"))


def judge_run(
    name: str,
    run_path: Path,
    pack_path: Path,
    same_start: SameStart | None = None,
    own_ways: dict[tuple[str | None, ...], Run] | None = None,
) -> Judged:
    """Read a run and its pack and measure everything that has a metric."""
    run, pack = read_run(run_path), load_pack(pack_path)
    if not len(run.time_s):
        raise BadTrace("E-RUN-EMPTY", str(run_path), "no step; a run of at least one step is needed")
    named = run.header.get("pack_sha256")
    if named != pack.sha256:
        message = f"sha256 {pack.sha256[:12]}, but {run_path.name} was made with {str(named)[:12]}"
        raise BadPack("E-PACK-OTHER", str(pack_path), message)
    object_name = run.header.get("object", "")
    if object_name not in pack.objects:
        message = f"no object {object_name!r} as {run_path.name} names; it has {', '.join(sorted(pack.objects))}"
        raise BadPack("E-PACK-OBJECT", str(pack_path), message)
    reference = Reference(same_start(run, pack_path) if same_start else None, (own_ways or {}).get(_work_of(run)))
    size = pack_path.stat().st_size
    case = Case(run, pack, object_name, size, reference)
    rows, series = measure_case(case)
    passed, sentence = verdict(rows)
    sources = {"run": run_path, "pack": pack_path}
    again, depth_mm = recompute(case), 1e3 * case.link_depth_m
    return Judged(name, run, pack, object_name, rows, series, sentence, passed, sources, again, depth_mm)


def fill_folder(judged: list[Judged], folder: Path, tell: Callable[[str], None]) -> None:
    """Write the report of judged runs into an empty folder."""
    (folder / "figures").mkdir()
    maps: dict[str, list[Path]] = {}
    for one in judged:
        tell(f"drawing {one.name}")
        for _ in write_figures(one.name, panels(one), folder / "figures"):
            pass
        maps[one.name] = [folder / "maps" / name for name in write_maps(one, folder / "maps")]
    tell("writing the page")
    title = judged[0].name if len(judged) == 1 else f"{len(judged)} runs"
    (folder / "index.html").write_text(build_page(judged, title, maps), encoding="utf-8")
    (folder / "metrics.json").write_text(metrics_json([(one.name, one.run, one.rows) for one in judged]))


def run_names(runs: list[tuple[Path, Path]]) -> list[str]:
    """File names without .run.mcap; those that are not the only one get a number."""
    names = [Path(run).name.removesuffix(".mcap").removesuffix(".run") for run, _ in runs]
    counts, seen, found = Counter(names), Counter[str](), []
    for name in names:
        seen[name] += 1
        found.append(f"{name}-{seen[name]}" if counts[name] > 1 else name)
    return found
