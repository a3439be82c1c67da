"""The `tune` verb: the leanest model that keeps every limit on some traces, and a page that says where that ends.

What was made and judged is kept under `made` and `cells`, so that work that was stopped goes on from there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from palmar import _runtime
from palmar.chart import Asked as ChartAsked
from palmar.chart import Job, keys_of, read_times, time_all
from palmar.errors import BadTrace, PalmarError
from palmar.eval.reach import find_reach
from palmar.eval.tuned import DIFFERENCES, RULES, Held, Values, held
from palmar.files import nearest, require_file, require_own_folder, sha256_of, stem_of
from palmar.model import AssetPack, load_pack, save_pack, write_whole
from palmar.noise import noise_note
from palmar.pack_check import TUNED, TUNED_SCHEMA
from palmar.records import read_run, read_trace
from palmar.replay import machine, object_of, require_side
from palmar.seen import pack_balls
from palmar.tools.lean import balls_over, lean_tree, measured, mode_of, own_error_mm, rest_of, surface_samples
from palmar.tools.pack import PACKAGES, version_of
from palmar.tune_beyond import HELD_OUT, changed_traces, outside_rows
from palmar.tune_cells import Bench, Model, Progress, Trial, try_answer, try_model
from palmar.tune_search import Search, Stage, parts_left_out, search
from palmar.workers import workers

TUNE_SCHEMA = "palmar.tune/1"
RESULTS = {"index.html", "tune.json", "lean.pack", "cells", "made"}
REST_SHARE = 0.8  # of the guard distance: a ball of the rest never comes as far out as a hand came near


@dataclass(frozen=True)
class Asked:
    """What is to be found. limits: by "metric stat", instead of the defaults."""

    limits: dict[str, float] = field(default_factory=dict)
    margin: float = 0.2
    guard_mm: float = 5.0
    rest_mm: float | None = None
    tries: int = 20
    repeats: int = 3
    seed: int = 0
    jobs: int = 1


def tune(
    pack_path: Path,
    traces: Sequence[Path],
    out: Path,
    asked: Asked,
    *,
    holdout: Sequence[Path] = (),
    object_name: str = "",
    progress: Progress = lambda text, fraction: None,
) -> dict[str, Any]:
    """Find the leanest model and write the folder: lean.pack, index.html, tune.json, cells, made.

    Returns what stands in tune.json; "pack" is None where nothing leaner keeps every limit. Raises PalmarError,
    BadPack, BadTrace, BadMesh; what was judged until then stays in `cells`.
    """
    from palmar.eval.tune_page import build_page

    pack = load_pack(require_file(pack_path))
    name = _check_inputs(pack_path, pack, traces, holdout, object_name)
    require_own_folder(out, RESULTS, "tuning")
    for folder in (out / "cells", out / "made"):
        folder.mkdir(parents=True, exist_ok=True)
    tree = pack.objects[name]
    full = Model(pack_path, len(tree.leaves), {})
    with workers(asked.jobs) if asked.jobs > 1 else nullcontext() as pool:
        bench = Bench(name, full, out / "cells", pool)
        progress("replaying the full model", 0.0)
        runs = [read_run(bench.full_run(trace)) for trace in traces]
        if not any(run.contacts.any() for run in runs):
            raise PalmarError(
                "E-TUNE-CONTACT", str(traces[0]), f"no hand touches {name} in any trace; nothing to tune on"
            )
        guard_m = asked.guard_mm / 1e3
        points = surface_samples(tree, guard_m, asked.seed)
        progress("finding what hands come near", 0.02)
        reach = find_reach(runs, pack, points, guard_m)
        seen_m = balls_over(points, reach.reached, guard_m)
        progress("judging the full model", 0.05)
        own = try_model(bench, full, traces)
        twin = _twin(bench, pack, asked, out / "made", lambda text: progress(text, 0.06))
        own = replace(own, values=own.values | _differences(try_answer(bench, twin, traces)))
        rows = held(own.values, asked.limits, asked.margin)
        _check_limits(rows, asked)
        rest_mm = asked.rest_mm or REST_SHARE * asked.guard_mm
        state = Search(
            bench=bench,
            pack=pack,
            traces=traces,
            rows=rows,
            seen_m=seen_m,
            share_seen=float(reach.reached.mean()),
            left_out=parts_left_out(reach.part_m, guard_m),
            rest_mm=rest_mm,
            seed=asked.seed,
            tries=asked.tries,
            made=out / "made",
            progress=lambda text, part: progress(text, 0.08 + 0.62 * part),
        )
        stages = search(state, Stage("as given", "the full model", own, own_error_mm(tree)))
        best, lean = stages[-1], None
        outside: list[dict[str, Any]] = []
        if len(stages) > 1:
            progress("measuring the lean model", 0.7)
            lean = _lean_pack(state, best, asked, rest_mm)
            groups = {stem_of(trace): [trace] for trace in holdout}
            groups |= {HELD_OUT: list(holdout)} if len(holdout) > 1 else {}
            groups |= changed_traces(traces, out / "made")
            outside = outside_rows(
                bench, best.trial.model, lean, twin, groups, rows, lambda text, part: progress(text, 0.72 + 0.13 * part)
            )
    times, measured_on = _time(stages, traces, name, asked, out, lambda text, part: progress(text, 0.85 + 0.15 * part))
    if lean is not None:
        save_pack(out / "lean.pack", lean)
    else:
        (out / "lean.pack").unlink(missing_ok=True)
    rest_mm = lean.objects[name].about[TUNED]["rest_mm"] if lean else own_error_mm(tree)
    answer = _answer(pack_path, pack, state, stages, outside, times, measured_on, asked, out, holdout, rest_mm)
    answer["parts_mm"] = {part: round(1e3 * gap, 2) if np.isfinite(gap) else None for part, gap in reach.part_m.items()}
    page = build_page(answer, tree, best_leaves(best, name), points, reach.reached)
    write_whole(out / "index.html", page.encode())
    write_whole(out / "tune.json", json.dumps(answer, indent=1, allow_nan=False).encode())
    return answer


def _twin(bench: Bench, pack: AssetPack, asked: Asked, made: Path, tell: Callable[[str], None]) -> Model:
    """Another model as full as the full one: the object fitted once more within the same error, from another seed.

    How much its answers differ from the full model's is what the spheres' places alone make.
    """
    tree = pack.objects[bench.name]
    path = made / f"twin-{pack.sha256[:16]}-{asked.seed}.pack"
    if not path.is_file():
        none = np.empty((0, 4))
        own_mm = own_error_mm(tree)
        twin = lean_tree(tree, none, 1.0, own_mm, own_mm, asked.seed + 1, lambda text, _: tell(f"another fit: {text}"))
        save_pack(path, AssetPack(pack.hand, {bench.name: twin}, {"tools": {}, "seed": asked.seed}))
    return Model(path, len(load_pack(path).objects[bench.name].leaves), bench.full.settings)


def _differences(trial: Trial) -> Values:
    return {name: value for name, value in trial.values.items() if name.split()[0] in DIFFERENCES}


def best_leaves(best: Stage, name: str) -> Any:
    """Spheres (n, 4) of the leaves of a stage's model."""
    return load_pack(best.trial.model.pack).objects[name].leaves


def _check_inputs(
    pack_path: Path, pack: AssetPack, traces: Sequence[Path], holdout: Sequence[Path], object_name: str
) -> str:
    """The object's name, once pack and traces are known to belong together. Raises PalmarError, BadTrace."""
    if not traces:
        raise PalmarError("E-USAGE", "TRACE", "no trace; at least one is needed to tune on")
    known: dict[str, Path] = {}
    named = object_name
    for path in (*traces, *holdout):
        trace = read_trace(require_file(path))
        if any(trace.lost.values()):
            raise BadTrace("E-TRACE-LOSS", str(path), "the file is damaged; recover it first (palmar recover)")
        require_side(trace, path, pack_path)
        sha256 = sha256_of(path)
        if sha256 in known:
            raise PalmarError("E-USAGE", str(path), f"holds the same as {known[sha256]}; each trace is allowed once")
        known[sha256] = path
        named = named or object_of(trace, pack_path)
    if named and named not in pack.objects:
        found = f"no such object{nearest(named, list(pack.objects))}; there are {', '.join(sorted(pack.objects))}"
        raise PalmarError("E-PACK-OBJECT", named, found)
    if not named and len(pack.objects) > 1:
        raise PalmarError("E-USAGE", "--object", f"needed, {pack_path.name} has {', '.join(sorted(pack.objects))}")
    name = named or next(iter(pack.objects))
    if TUNED in pack.objects[name].about:
        raise PalmarError("E-TUNE-LEAN", str(pack_path), "is a lean pack already; the full one is needed")
    return name


def _check_limits(rows: Sequence[Held], asked: Asked) -> None:
    for row in rows:
        if row.rule.name in asked.limits and row.own is not None and row.limit is not None and row.own > row.limit:
            found = f"{row.limit:g} {row.rule.unit} asked, the full pack itself comes to {row.own:.4g} on these traces"
            raise PalmarError("E-TUNE-LIMIT", row.rule.name, f"{found}; nothing leaner can be held to that")


def limit_names() -> dict[str, str]:
    """What --limit may name -> "metric stat": each rule in full, and each metric for its first rule."""
    names = {rule.metric: rule.name for rule in reversed(RULES)}
    return names | {f"{rule.metric}.{rule.stat}": rule.name for rule in RULES}


def _lean_pack(state: Search, best: Stage, asked: Asked, rest_mm: float) -> AssetPack:
    """The pack to hand out: the object's lean tree with its errors, and what it was tuned for."""
    name, model = state.bench.name, best.trial.model
    tree = measured(load_pack(model.pack).objects[name], asked.seed)
    whole = "regions" not in tree.about["parameters"]
    tuned = {
        "schema": TUNED_SCHEMA,
        "full_sha256": state.pack.sha256,
        "full_spheres": state.bench.full.spheres,
        "traces": [{"name": trace.name, "sha256": sha256_of(trace)} for trace in state.traces],
        "guard_mm": asked.guard_mm,
        "fine_mm": best.fine_mm,
        "rest_mm": best.fine_mm if whole else rest_of(best.fine_mm, rest_mm),
        "margin": asked.margin,
        "limits": {row.rule.name: row.limit for row in state.rows if row.allowed is not None},
        "values": {row.rule.name: best.trial.values[row.rule.name] for row in state.rows if row.allowed is not None},
        "left_out": model.settings.get("leave_out", "").split("+") if "leave_out" in model.settings else [],
        "settings": model.settings,
        "share_seen": state.share_seen,
        "seen": pack_balls(state.seen_m),
    }
    tools = {package: version_of(package) for package in PACKAGES}
    tree = replace(tree, about={**tree.about, TUNED: tuned})
    return AssetPack(state.pack.hand, {name: tree}, {"tools": tools, "seed": asked.seed})


def _time(
    stages: Sequence[Stage], traces: Sequence[Path], name: str, asked: Asked, out: Path, progress: Progress
) -> tuple[list[dict[str, float]], dict[str, Any]]:
    """Step times of every stage, in mixed order, over the steps in which the full model touches."""
    jobs = [
        Job(
            pack=str(stage.trial.model.pack),
            trace=str(trace),
            object=name,
            name=f"{stage.name} {stem_of(trace)}",
            number=-1,
            level=stage.trial.model.spheres,
            spheres=stage.trial.model.spheres,
            solver="progressive",
            settings=stage.trial.model.settings,
            in_use="",
        )
        for stage in stages
        for trace in traces
    ]
    keys = keys_of(jobs)
    folder = out / "cells"
    chart = ChartAsked(solvers=("progressive",), spheres=(), repeats=asked.repeats, seed=asked.seed)
    told = time_all(jobs, keys, chart, folder, progress)
    count = len(traces)
    touching = [read_times(folder / key)[1] > 0 for key in keys[:count]]
    rows = []
    for number in range(len(stages)):
        times = [read_times(folder / key)[0] for key in keys[number * count : (number + 1) * count]]
        cpu = [each["cpu_us"][:, at] for each, at in zip(times, touching, strict=True)]
        least, all_ = np.concatenate([each.min(axis=0) for each in cpu]), np.concatenate([each.ravel() for each in cpu])
        row = {f"cost_{stat}": float(np.percentile(least, q)) for stat, q in (("p50", 50), ("p99", 99))}
        tail = (("p50", 50), ("p99", 99), ("p99.9", 99.9), ("max", 100))
        rows.append(row | {stat: float(np.percentile(all_, q)) for stat, q in tail})
    return rows, told


def _answer(
    pack_path: Path,
    pack: AssetPack,
    state: Search,
    stages: Sequence[Stage],
    outside: Sequence[dict[str, Any]],
    times: Sequence[dict[str, float]],
    measured_on: dict[str, Any],
    asked: Asked,
    out: Path,
    holdout: Sequence[Path],
    rest_mm: float,
) -> dict[str, Any]:
    """Everything that the page and tune.json say."""
    best, lean = stages[-1], len(stages) > 1
    limits = [
        {
            "metric": row.rule.name,
            "unit": row.rule.unit,
            "own": row.own,
            "limit": row.limit,
            "allowed": row.allowed,
            "why": row.why,
            "value": best.trial.values[row.rule.name],
        }
        for row in state.rows
    ]
    told = [
        {
            "name": stage.name,
            "what": stage.what,
            "spheres": stage.trial.model.spheres,
            # The lean pack holds what it was tuned for as well.
            "bytes": (
                out / "lean.pack"
                if lean and stage.trial.model.pack == best.trial.model.pack
                else stage.trial.model.pack
            )
            .stat()
            .st_size,
            "fine_mm": stage.fine_mm,
            "settings": stage.trial.model.settings,
            "operations": stage.trial.operations,
            "times_us": row,
            "values": stage.trial.values,
        }
        for stage, row in zip(stages, times, strict=True)
    ]
    answer = {
        "schema": TUNE_SCHEMA,
        "pack": str(out / "lean.pack") if lean else None,
        "page": str(out / "index.html"),
        "object": state.bench.name,
        "full": {"pack": pack_path.name, "sha256": pack.sha256},
        "traces": [trace.name for trace in state.traces],
        "holdout": [trace.name for trace in holdout],
        "guard_mm": asked.guard_mm,
        "rest_mm": rest_mm,
        "margin": asked.margin,
        "mode": mode_of(pack.objects[state.bench.name]),
        "share_seen": state.share_seen,
        "left_out": state.left_out if "leave_out" in best.trial.model.settings else [],
        "stages": told,
        "limits": limits,
        "tried": state.tried,
        "outside": list(outside),
        "note": noise_note(measured_on["kernels"]),
        "machine": machine(),
        "build": dict(sorted(_runtime.build_info().items())),
        "repeats": asked.repeats,
        "seed": asked.seed,
    }
    return answer | {"sentence": _sentence(answer), "promise": _promise(answer)}


def _sentence(answer: dict[str, Any]) -> str:
    first, last = answer["stages"][0], answer["stages"][-1]
    held_count = sum(row["allowed"] is not None for row in answer["limits"])
    if answer["pack"] is None:
        tried = [row for row in answer["tried"] if row["broken"]]
        why = ""
        if tried:
            broke = tried[0]["broken"][0]
            found = f"{broke['value']:.4g}, {broke['allowed']:.4g} is allowed, on {tried[0]['trace']}"
            why = f": {tried[0]['what']} comes to {broke['metric']} {found}"
        return f"Nothing leaner than the {first['spheres']:,} spheres keeps all {held_count} limits{why}."
    count, before, after = last["spheres"], first["times_us"], last["times_us"]
    fewer = f"{count:,} spheres instead of {first['spheres']:,} ({first['spheres'] / count:.1f} times fewer)"
    if count == first["spheres"]:
        fewer = f"The same {count:,} spheres with {' and '.join(row['what'] for row in answer['stages'][1:])}"
    return (
        f"{fewer} keep all {held_count} limits on {_counted(len(answer['traces']), 'trace')}; a step takes "
        f"{after['cost_p50']:.1f} us instead of {before['cost_p50']:.1f} (p50), {after['cost_p99']:.1f} instead of "
        f"{before['cost_p99']:.1f} (p99)."
    )


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _promise(answer: dict[str, Any]) -> list[str]:
    """What is promised, and what is not: one sentence each."""
    if answer["pack"] is None:
        return []
    said = [
        f"Promised for hands that stay within about {answer['guard_mm']:g} mm of where those of the traces came "
        f"({answer['share_seen']:.0%} of the surface); nothing is promised beyond. There the object is within "
        f"{answer['rest_mm']:.3g} mm of its mesh, so that a hand meets it, but not where it should."
    ]
    if answer["left_out"]:
        said.append(f"Left out, and touching nothing at all: {', '.join(answer['left_out'])}.")
    for row in answer["outside"]:
        if row["name"] in {stem_of(Path(name)) for name in answer["holdout"]}:
            said += [f"No promise for {line}." for line in row["outside"]]
    return said
