"""Recorded CyberGlove demonstrations of the Adroit hand at a door -> Trace, with the palm seen from the moving latch.

Columns: `palm_*` and `q_*` are what the simulated hand did, `cmd_*` what the glove asked for, `latch_*` the handle's
pose (Rajeswaran et al. 2017, "Learning complex dexterous manipulation with deep reinforcement learning and
demonstrations").
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, filtfilt

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS, HandModel
from palmar.records import Trace
from palmar.traces.adroit_hand import FINGER_JOINTS, FROZEN_RAD, JOINTS, fit_angles, hand_model, load_chain
from palmar.traces.columns import Array, Log, read_log, unit_quaternions
from palmar.traces.kinematics import conjugate, multiply, rotate

PALM_POSITION = [f"palm_p{axis}_m" for axis in "xyz"]
PALM_ROTATION = [f"palm_q{axis}" for axis in "wxyz"]
LATCH_POSITION = [f"latch_p{axis}_m" for axis in "xyz"]
LATCH_ROTATION = [f"latch_q{axis}" for axis in "wxyz"]
ALL_JOINTS = ["wrist_deviation", "wrist_flexion", *JOINTS]
GAPS = [f"gap_{part}_m" for part in (*FINGERS, "palm", "forearm")]
COLUMNS = [
    *["t_s", *PALM_POSITION, *PALM_ROTATION],
    *[f"q_{joint}" for joint in ALL_JOINTS],
    *[f"cmd_{joint}" for joint in ALL_JOINTS],
    *["door_hinge_rad", "latch_rad", *LATCH_POSITION, *LATCH_ROTATION, *GAPS],
]
FILTER_HZ = 6.0  # the commands carry uniform noise of +-0.1 rad that no glove made; the motion stays below this
LEAD_MS = 70.0  # the simulated servos follow the filtered command 60 to 80 ms late, and the palm is theirs


def read_adroit_door(
    path: str | Path,
    *,
    angles: str = "command",
    filter_hz: float | None = None,
    lead_ms: float | None = None,
    object_frame: str = "latch",
    hand_json: str | Path | None = None,
) -> Trace:
    """Read one demonstration as the haptic hand "adroit".

    angles: "command" (what the glove asked for; may pass through the handle) or "recorded" (the simulated hand, which
    the door stops). filter_hz: cut-off of the second-order Butterworth low-pass run both ways over the commands; 0
    leaves them raw; default 6. lead_ms: how much later than its command the palm is; the commands are moved later by it
    and the rows before are left out; default 70. object_frame: "latch" (palm in the latch's frame, object still) or
    "moving" (palm in the world, latch pose in every sample).
    hand_json: the chain of the hand; default `adroit_hand.json` beside the log.

    Raises BadTrace as `read_log` does, PalmarError E-CONF for an option out of its range.
    """
    filter_hz, lead_ms = _check_options(angles, filter_hz, lead_ms, object_frame)
    log = read_log(path, COLUMNS, "t_s")
    time_s = log.columns["t_s"]
    chain, chain_sha256 = load_chain(hand_json or Path(path).parent / "adroit_hand.json")
    hand = hand_model(chain, chain_sha256)

    assumptions = [
        "Angles are the 24 joints of the Adroit hand; wrist and forearm are left out, the palm pose is the palm body's."
    ]
    changed: dict[str, float] = {}
    if angles == "command":
        joint_rad = {joint: log.columns[f"cmd_{joint}"] for joint in JOINTS}
        if filter_hz > 0:
            joint_rad = _filter(log, time_s, joint_rad, filter_hz, assumptions, changed)
        else:
            assumptions.append(
                "Commands are raw: they carry uniform noise of about +-0.1 rad that was added to the recording."
            )
        start, joint_rad = _delay(log, time_s, joint_rad, lead_ms * 1e-3)
        if start > 0:
            changed["rows left out at the start"] = start
        assumptions.append(
            f"The palm follows a command {lead_ms:g} ms late (60 to 80 ms in these recordings), so commands are moved "
            f"later by that; the first {start} rows, which have no command yet, are left out."
        )
    else:
        start = 0
        joint_rad = {joint: log.columns[f"q_{joint}"] for joint in JOINTS}
        assumptions.append(
            "Angles are those the simulated hand reached, stopped by the door: not what the glove asked for."
        )

    flexion, abduction, tip_error_m = fit_angles(chain, hand, joint_rad)
    assumptions += _mapping_sentences(tip_error_m)
    flexion, abduction, outside = _clip(hand, flexion, abduction)
    if outside:
        changed["angles clipped to the limits"] = outside

    palm = (log.stack(PALM_POSITION)[start:], unit_quaternions(log, PALM_ROTATION)[start:])
    latch = (log.stack(LATCH_POSITION)[start:], unit_quaternions(log, LATCH_ROTATION)[start:])
    moving = object_frame == "moving"
    if moving:
        assumptions.append("The palm is in the world; every sample carries the latch's pose.")
    else:
        palm = pose_in_frame(palm, latch)
        assumptions.append("The palm is in the moving latch's frame, so the object stands still at the origin.")
        latch = (np.zeros_like(latch[0]), np.tile([1.0, 0.0, 0.0, 0.0], (len(latch[1]), 1)))
    count = len(time_s) - start
    header = {
        "device": "adroit-door",
        "hand": "adroit",
        "side": "right",
        "object": "latch",
        "source": Path(path).name,
        "source_sha256": log.sha256,
        "assumptions": json.dumps(assumptions),
        "changed": json.dumps(changed),
    }
    if len(time_s) > 1:
        header["rate_hz"] = f"{1.0 / float(np.median(np.diff(time_s))):.6g}"
    return Trace(
        header=header,
        time_s=time_s[start:],
        palm_position_m=palm[0],
        palm_rotation_wxyz=palm[1],
        flexion_rad=flexion,
        abduction_rad=abduction,
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.full(count, moving),
        object_position_m=latch[0],
        object_rotation_wxyz=latch[1],
    )


def pose_in_frame(pose: tuple[Array, Array], frame: tuple[Array, Array]) -> tuple[Array, Array]:
    """A pose seen from a frame, both in the world: inverse(frame) * pose. (n, 3) metres and (n, 4) w x y z."""
    back = conjugate(frame[1])
    return rotate(back, pose[0] - frame[0]), multiply(back, pose[1])


def _check_options(
    angles: str, filter_hz: float | None, lead_ms: float | None, object_frame: str
) -> tuple[float, float]:
    if angles not in ("command", "recorded"):
        raise PalmarError("E-CONF", "angles", f"{angles!r}; allowed are command, recorded")
    if object_frame not in ("latch", "moving"):
        raise PalmarError("E-CONF", "object_frame", f"{object_frame!r}; allowed are latch, moving")
    for name, value, highest in (("filter_hz", filter_hz, 40.0), ("lead_ms", lead_ms, 500.0)):
        if value is not None and angles == "recorded":
            raise PalmarError("E-CONF", name, "applies to commands; recorded angles are taken as they are")
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value is not None and not (number and 0.0 <= value <= highest):
            raise PalmarError("E-CONF", name, f"{value!r}; allowed is 0 to {highest:g}")
    return FILTER_HZ if filter_hz is None else filter_hz, LEAD_MS if lead_ms is None else lead_ms


def _filter(
    log: Log,
    time_s: Array,
    joint_rad: dict[str, Array],
    filter_hz: float,
    assumptions: list[str],
    changed: dict[str, float],
) -> dict[str, Array]:
    """Second-order Butterworth low-pass, forwards and backwards, so that nothing is late; notes what it did."""
    # filtfilt mirrors 9 rows at either end and needs one more.
    if len(time_s) < 10:
        raise BadTrace("E-TRACE-EMPTY", log.where, f"{len(time_s)} rows; the filter needs 10 (or pass filter_hz 0)")
    step_s = np.diff(time_s)
    rate_hz = 1.0 / float(np.median(step_s))
    uneven = np.flatnonzero(np.abs(step_s * rate_hz - 1.0) > 0.01)
    if uneven.size:
        i = int(uneven[0]) + 1
        raise BadTrace(
            "E-TRACE-TIME",
            f"{log.where}:line {i + 2}",
            f"step of {step_s[i - 1]:g} s; the filter needs equal steps (or pass filter_hz 0)",
        )
    if filter_hz >= rate_hz / 2:
        raise PalmarError("E-CONF", "filter_hz", f"{filter_hz:g}; has to be below half the log's {rate_hz:g} Hz")
    b, a = butter(2, filter_hz, fs=rate_hz)
    smooth = {joint: filtfilt(b, a, values) for joint, values in joint_rad.items()}
    moved = np.concatenate([smooth[joint] - joint_rad[joint] for joint in joint_rad])
    changed["command values filtered"] = len(moved)
    changed["rms change by the filter, rad"] = float(np.sqrt((moved**2).mean()))
    assumptions.append(
        f"Commands are filtered by a second-order Butterworth low-pass at {filter_hz:g} Hz, run both ways: they carry "
        "uniform noise of about +-0.1 rad that was added to the recording."
    )
    return smooth


def _delay(log: Log, time_s: Array, joint_rad: dict[str, Array], lead_s: float) -> tuple[int, dict[str, Array]]:
    """Commands of lead_s ago, and the first row that has one; between rows by pchip, which never overshoots."""
    # A rounding error must not cost a row: times are written in milliseconds.
    asked_s = np.maximum(time_s - lead_s, time_s[0])
    start = int(np.searchsorted(time_s, time_s[0] + lead_s - 1e-6))
    if start >= len(time_s):
        raise BadTrace("E-TRACE-EMPTY", log.where, f"the log is shorter than the lead of {lead_s * 1e3:g} ms")
    if start == 0:
        return 0, joint_rad
    return start, {joint: PchipInterpolator(time_s, values)(asked_s[start:]) for joint, values in joint_rad.items()}


def _clip(hand: HandModel, flexion: Array, abduction: Array) -> tuple[Array, Array, int]:
    """Angles inside the model's limits and how many were not."""
    clipped_flexion = np.clip(flexion, hand.flexion_limit_rad[..., 0], hand.flexion_limit_rad[..., 1])
    clipped_abduction = np.clip(abduction, hand.abduction_limit_rad[:, 0], hand.abduction_limit_rad[:, 1])
    outside = int((clipped_flexion != flexion).sum() + (clipped_abduction != abduction).sum())
    return clipped_flexion, clipped_abduction, outside


def _mapping_sentences(tip_error_m: Array) -> list[str]:
    """What the 20-angle model does to the tips of the two fingers that lose a joint, in mm."""
    lost = {"thumb": "thumb_mcp_abd", "little": "little_cmc_flex"}
    sentences = []
    for finger, joint in lost.items():
        p50, p99, most = np.percentile(tip_error_m[:, FINGERS.index(finger)] * 1e3, [50, 99, 100])
        names = ", ".join(name for name, _ in FINGER_JOINTS[finger])
        sentences.append(
            f"The model has no {joint}: it is fixed at {FROZEN_RAD[joint]:g} rad and its motion folded into {names} by "
            f"least squares over joints and tip; {finger} tip error {p50:.2f} mm p50, {p99:.2f} mm p99, "
            f"{most:.2f} mm max."
        )
    return sentences
