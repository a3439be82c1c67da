"""The `demo` verb: mesh -> pack -> trace -> run -> report on built-in objects, with nothing but the package itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from palmar.reference import same_start
from palmar.replay import replay_file

# A body with a flat end and a sharp rim, one with concave lobes, one with two ears for fingers to get caught between.
# A fingertip hovers or sinks in by as much as the spheres are wrong, so they are held to the limit of hover.
OBJECTS = ("cylinder", "shamrock", "ears")
ERROR_MM = 0.25


def make_demo(
    out_dir: Path,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda text, fraction: None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Build, script, replay and judge one grasp on each of OBJECTS; the files stay in `out_dir`.

    progress(text, fraction) is told what goes on, say(line) what is done. Returns the answers of the stages.
    """
    from palmar.eval.report import write_report
    from palmar.tools.pack import build
    from palmar.traces.scripted import script

    out_dir.mkdir(parents=True, exist_ok=True)
    pack = out_dir / "objects.pack"

    def part(start: float, end: float) -> Callable[[str, float], None]:
        return lambda text, fraction: progress(text, start + (end - start) * fraction)

    shapes = [f"shape:{name}" for name in OBJECTS]
    built = build(shapes, pack, error_mm=ERROR_MM, seed=seed, progress=part(0.0, 0.5))
    say(f"pack    {pack}")

    runs = []
    for number, name in enumerate(OBJECTS):
        trace, run = out_dir / f"{name}.mcap", out_dir / f"{name}.run.mcap"
        start = 0.5 + 0.1 * number
        part(start, start)(f"script {name}", 0.0)
        script("grasp", pack, trace, object=name, seed=seed)
        say(f"trace   {trace}")
        runs.append(replay_file(pack, trace, run, object_name=name, progress=part(start + 0.02, start + 0.1)))
        say(f"run     {run}")

    pairs = [(Path(run["run"]), pack) for run in runs]
    told = part(0.8, 1.0)
    judged = write_report(
        pairs,
        out_dir / "report",
        progress=lambda done, total, what: told(what, done / total),
        same_start=same_start,
    )
    for verdict in judged["runs"]:
        say(f"verdict {verdict['run']}: {verdict['verdict']}")
    say(f"report  {judged['page']}")
    return {"build": built, "runs": runs, "report": judged}
