"""The `show` verb, and how the answers of `build` and `replay` are printed."""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np

from palmar.model import AssetPack
from palmar.pack_check import TUNED
from palmar.records import Run, Trace
from palmar.replay import count_status
from palmar.terminal import cell, print_fields, print_table

LEVEL_COLUMNS = ["object", "level", "spheres", "protrusion max mm", "p99", "mean", "gap max mm", "p99", "mean"]
LEVEL_COLUMNS += ["normals median deg", "p95"]
LEVEL_ERRORS = [(figure, stat) for figure in ("protrusion_mm", "gap_mm") for stat in ("max", "p99", "mean")]
RESIDUAL_STATS = ("p50", "p99", "max")
LEVEL_ERRORS += [("normal_error_deg", "median"), ("normal_error_deg", "p95")]

FIT_COLUMNS = ["part", "at rest: protrusion max mm", "p99", "mean", "gap max mm", "p99", "mean"]
FIT_COLUMNS += ["bent: protrusion p99 mm", "gap p99 mm"]
FIT_ERRORS = [("rest", figure, stat) for figure, stat in LEVEL_ERRORS[:6]]
FIT_ERRORS += [("sweep", "protrusion_mm", "p99"), ("sweep", "gap_mm", "p99")]


CLOSING_COLUMNS = ["object", "closed", "distance of", "max mm", "p99", "mean", "largest at x, y, z mm"]
COVER_FIGURES = {
    "spheres": ("spheres",),
    "balanced p99 mm": ("balanced_p99_mm",),
    "protrusion p99 mm": ("protrusion_mm", "p99"),
    "protrusion max mm": ("protrusion_mm", "max"),
    "gap p99 mm": ("gap_mm", "p99"),
    "gap max mm": ("gap_mm", "max"),
    "normals p95 deg": ("normal_deg", "p95"),
    "felt offset p99 mm": ("felt", "offset_mm", "p99"),
    "felt normal p50 deg": ("felt", "normal_deg", "p50"),
    "felt normal p95 deg": ("felt", "normal_deg", "p95"),
    "felt normal p99 deg": ("felt", "normal_deg", "p99"),
    "volume union / mesh": ("volume", "ratio"),
    "tree: not contained": ("tree", "not_contained"),
    "dual bound: least spheres": ("dual_bound", "least_spheres"),
    "spheres / dual bound": ("dual_bound", "ratio"),
}


def describe(content: AssetPack | Trace | Run) -> dict[str, Any]:
    """What `show` says of a file; plain values that JSON can hold."""
    if isinstance(content, AssetPack):
        return {"kind": "pack", **describe_pack(content)}
    if isinstance(content, Run):
        return {"kind": "run", **describe_run(content)}
    return {"kind": "trace", **describe_trace(content)}


def describe_pack(pack: AssetPack) -> dict[str, Any]:
    objects = {}
    for name, tree in pack.objects.items():
        size_mm = np.ptp(tree.vertices_m, axis=0) * 1000
        objects[name] = {
            **tree.about,
            "triangles": len(tree.faces),
            "size_mm": [round(float(side), 3) for side in size_mm],
        }
    hand = {**pack.hand.about, "palm_spheres": len(pack.hand.palm_spheres_m)}
    return {"sha256": pack.sha256, "schema": pack.manifest["schema"], "hand": hand, "objects": objects}


def describe_trace(trace: Trace) -> dict[str, Any]:
    return {
        "header": trace.header,
        "samples": len(trace.time_s),
        **_describe_time(trace.time_s),
        "untracked": int((~trace.tracked).sum()),
        "object_poses": int(trace.has_object_pose.sum()),
        "lost": dict(trace.lost),
    }


def describe_run(run: Run) -> dict[str, Any]:
    values, counts = np.unique(run.status, return_counts=True)
    in_contact = run.contacts > 0
    # Steps far from the object cost next to nothing; only those in contact say how fast a solver is.
    times = run.cpu_us[in_contact] if in_contact.any() else run.cpu_us
    percentiles = dict(zip(("p50", "p99", "p99.9", "max"), _percentiles(times), strict=True))
    return {
        "header": run.header,
        "steps": len(run.time_s),
        **_describe_time(run.time_s),
        "steps_in_contact": int(in_contact.sum()),
        "contacts_max": int(run.contacts.max(initial=0)),
        "status": count_status(dict(zip(values.tolist(), counts.tolist(), strict=True))),
        "step_cpu_us": {"of": "steps in contact" if in_contact.any() else "all steps", **percentiles},
        "lost": dict(run.lost),
    }


def print_description(description: dict[str, Any]) -> None:
    if description["kind"] == "pack":
        _print_pack(description)
        return
    fields = {key: value for key, value in description.items() if not isinstance(value, dict)}
    print_fields(fields)
    if description["kind"] == "run":
        _print_status(description["status"])
        cpu = description["step_cpu_us"]
        print_table(("step CPU time, us", "p50", "p99", "p99.9", "max"), [(cpu["of"], *list(cpu.values())[1:])])
    print("header")
    print_fields({f"  {key}": _short(value) for key, value in description["header"].items()})


def print_build(answer: dict[str, Any]) -> None:
    """The answer of `palmar.tools.pack.build`: the errors of each level, then the file; warnings on stderr."""
    print_table(LEVEL_COLUMNS, _level_rows(answer["objects"]))
    _print_regions(answer["objects"])
    print_fields({"pack": answer["pack"], "bytes": answer["bytes"], "sha256": answer["sha256"]})
    for warning in answer["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)


def print_fit(answer: dict[str, Any]) -> None:
    """The answer of `palmar.tools.hand_fit.fit_hand`: its errors at rest and the worst of a sweep, then the file."""
    hand = answer["hand"]
    rows = [
        (part, *(hand["error"][pose][part][figure][stat] for pose, figure, stat in FIT_ERRORS))
        for part in hand["error"]["rest"]
    ]
    if "scan" in hand:
        found = [(part, *figures.values()) for part, figures in hand["scan"]["residual_mm"].items()]
        print_table(("from the scan to the warped hand, mm", "p50", "p99", "max"), found)
    print_table(FIT_COLUMNS, rows)
    fields = {"hand": answer["out"], "side": hand["side"], "palm spheres": hand["palm"]["kept"]}
    fields |= {"volume by the mesh's": hand["error"]["volume_ratio"], "axes from the": hand["axes"]}
    print_fields(fields | {"sha256": answer["sha256"]})


def print_cover(answer: dict[str, Any]) -> None:
    """The answer of `palmar.tools.cover_report.write_cover`: the covers side by side, their worst places, the page."""
    rows: list[tuple[Any, ...]] = []
    for label, keys in COVER_FIGURES.items():
        values = [_dig(cover, keys) for cover in answer["covers"]]
        if any(value != "" for value in values):
            rows.append((label, *(cell(value) for value in values)))
    print_table(("", *(cover["name"] for cover in answer["covers"])), rows)
    places = [
        (
            cover["name"],
            number,
            *(place[key] for key in ("kind", "what", "max_mm", "extent_mm")),
            _position(place["at_mm"]),
        )
        for cover in answer["covers"]
        for number, place in enumerate(cover["worst_places"], 1)
    ]
    print_table(("worst places", "", "error", "on", "max mm", "extent mm", "at x, y, z mm"), places)
    print_fields({"page": answer["page"]})


def print_replay(answer: dict[str, Any]) -> None:
    """The answer of `palmar.replay.replay_file`: how many steps had which status, then the file."""
    _print_status(answer["status"])
    print_fields({"run": answer["run"], "steps": answer["steps"]})


def print_residuals(residual_mm: dict[str, Any]) -> None:
    """How far the solved hand is from each point seen."""
    rows = []
    for finger, points in residual_mm.items():
        named = {"all": points} if finger == "fingertips" else points
        for point, stats in named.items():
            rows.append((finger, point, *(stats.get(key, "") for key in RESIDUAL_STATS)))
    print_table(("residual, mm", "point", *RESIDUAL_STATS), rows)


def _print_pack(description: dict[str, Any]) -> None:
    hand = {key: value for key, value in description["hand"].items() if key not in ("error", "palm", "axis_error_deg")}
    print_fields({"kind": "pack", "sha256": description["sha256"], "schema": description["schema"]})
    print_fields({f"hand {key}": value for key, value in hand.items()})
    objects = description["objects"]
    columns = ("object", "source", "size mm", "triangles", "closed")
    rows = [
        (
            name,
            about.get("source", ""),
            " x ".join(f"{s:.1f}" for s in about["size_mm"]),
            about["triangles"],
            about.get("closed") or "",
        )
        for name, about in objects.items()
    ]
    print_table(columns, rows)
    closed = _closing_rows(objects)
    if closed:
        print_table(CLOSING_COLUMNS, closed)
    print_table(LEVEL_COLUMNS, _level_rows(objects))
    _print_regions(objects)
    _print_tuned(objects)


def _print_tuned(objects: dict[str, Any]) -> None:
    """Of a lean pack what it was tuned for."""
    for name, about in objects.items():
        if TUNED in about:
            tuned = about[TUNED]
            settings = " ".join(f"{key}={value}" for key, value in tuned["settings"].items())
            fields = {
                "tuned on": [f"{trace['name']} {trace['sha256'][:16]}" for trace in tuned["traces"]],
                "instead of": f"{tuned['full_spheres']} spheres of {tuned['full_sha256'][:16]}",
                "fine": f"{tuned['fine_mm']:.3g} mm where hands came within {tuned['guard_mm']:g} mm, "
                f"{tuned['share_seen']:.0%} of the surface; {tuned['rest_mm']:.3g} mm elsewhere",
                "left out": ", ".join(tuned["left_out"]) or "nothing of the hand",
                "settings": settings or "the defaults",
            }
            print_fields({f"{name}: {key}": value for key, value in fields.items()})


def _print_regions(objects: dict[str, Any]) -> None:
    """Where regions were asked for: the share of each, what that allows, and what the leaves keep there."""
    columns = ("share", "error_mm", "gap_p99_mm", "protrusion_max_mm")
    rows = [
        (name, *(region[column] for column in columns))
        for name, about in objects.items()
        for region in about.get("parameters", {}).get("regions", [])
    ]
    if rows:
        print_table(("object", "regions of share", "error mm", "gap p99 mm", "protrusion max mm"), rows)


def _closing_rows(objects: dict[str, Any]) -> list[tuple[Any, ...]]:
    """How far each closed mesh is from the solid made of it, both ways."""
    rows = []
    for name, about in objects.items():
        closing = about.get("parameters", {}).get("closing")
        for way, moved in (closing or {}).get("moved_mm", {}).items():
            at = _position(moved["at_mm"]) if moved.get("at_mm") else ""
            rows.append((name, closing["how"], way.replace("_", " "), *(moved[k] for k in ("max", "p99", "mean")), at))
    return rows


def _print_status(counts: dict[str, int]) -> None:
    print_table(("status", "steps"), [(name, count) for name, count in counts.items() if count or name == "ok"])


def _level_rows(objects: dict[str, Any]) -> list[tuple[Any, ...]]:
    rows = []
    for name, about in objects.items():
        for k, level in enumerate(about["levels"]):
            errors = [level[figure][stat] for figure, stat in LEVEL_ERRORS]
            rows.append((name, k, level["spheres"], *errors))
    return rows


def _describe_time(time_s: Any) -> dict[str, Any]:
    """Duration, median rate, and gaps: times between neighbours of over twice the median."""
    if len(time_s) < 2:
        return {"duration_s": 0.0, "rate_hz": 0.0, "gaps": 0, "longest_gap_s": 0.0}
    between = np.diff(time_s)
    usual = float(np.median(between))
    return {
        "duration_s": float(time_s[-1] - time_s[0]),
        "rate_hz": 1.0 / usual if usual > 0 else 0.0,
        "gaps": int((between > 2 * usual).sum()),
        "longest_gap_s": float(between.max()),
    }


def _percentiles(values: Any) -> list[float]:
    return [float(v) for v in np.percentile(values, [50, 99, 99.9, 100])] if len(values) else [0.0] * 4


def _dig(value: Any, keys: tuple[str, ...]) -> Any:
    """What stands under nested keys, "" if nothing does."""
    for key in keys:
        value = value.get(key, "") if isinstance(value, dict) else ""
    return value


def _position(at: list[float]) -> str:
    return ", ".join(f"{x:.1f}" for x in at)


def _short(text: str) -> str:
    """JSON values on one line, cut where nobody reads on."""
    try:
        parsed = json.loads(text)
    except ValueError:
        parsed = text
    if isinstance(parsed, dict):
        text = ", ".join(f"{key} {value}" for key, value in parsed.items())
    elif isinstance(parsed, list):
        text = ", ".join(str(part.get("name", part)) if isinstance(part, dict) else str(part) for part in parsed)
    return text if len(text) <= 160 else f"{text[:157]}..."
