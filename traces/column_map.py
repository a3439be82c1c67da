"""A comma-separated log of any device -> Trace, by a map that says which column is what, in which unit and sense."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from palmar.errors import BadTrace, PalmarError
from palmar.model import FINGERS, JOINTS
from palmar.records import Trace
from palmar.traces.columns import Array, Log, read_header, read_log
from palmar.traces.receive import hold_last_good, receive, usable
from palmar.traces.scene_file import Strict, validated

LENGTH_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
ANGLE_RAD = {"rad": 1.0, "deg": np.pi / 180.0, "turn": 2.0 * np.pi}
TIME_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
Sign = Literal[-1, 1]
Three = tuple[str, str, str]


class TimeMap(Strict):
    column: str
    unit: Literal["s", "ms", "us", "ns"] = "s"
    from_zero: bool = False  # take the first sample's time off


class PositionMap(Strict):
    columns: Three  # x, y, z
    unit: Literal["m", "cm", "mm", "in"] = "m"
    sign: tuple[Sign, Sign, Sign] = (1, 1, 1)


class RotationMap(Strict):
    """Quaternion w x y z, rotation vector, or turns about the three axes of `form` (capitals: carried along)."""

    columns: list[str]
    form: Annotated[str, Field(pattern=r"^(quaternion|vector|[xyz]{3}|[XYZ]{3})$")] = "quaternion"
    unit: Literal["rad", "deg", "turn"] = "rad"

    @model_validator(mode="after")
    def _as_many_as_the_form_has(self) -> RotationMap:
        count = 4 if self.form == "quaternion" else 3
        if len(self.columns) != count:
            raise ValueError(f"{count} columns for form {self.form}")
        return self


class AnglesMap(Strict):
    """Angles of one finger. joints: which of MCP, PIP, DIP the columns are; what is left out follows the hand."""

    columns: list[str] = Field(min_length=1, max_length=3)
    joints: list[Literal["MCP", "PIP", "DIP"]] | None = None  # left out: from MCP outwards
    unit: Literal["rad", "deg", "turn"] = "rad"
    sign: Sign = 1  # -1 where the device counts extension
    zero: float | list[float] = 0.0  # what it says of a straight finger, in its unit

    @model_validator(mode="after")
    def _one_of_each(self) -> AnglesMap:
        joints = self.joints_of_columns
        if len(joints) != len(self.columns) or len(set(joints)) != len(joints):
            raise ValueError("one joint for each column, none twice")
        if isinstance(self.zero, list) and len(self.zero) != len(self.columns):
            raise ValueError("one zero, or one for each column")
        return self

    @property
    def joints_of_columns(self) -> list[str]:
        return list(self.joints or JOINTS[: len(self.columns)])


class AbductionMap(Strict):
    column: str
    unit: Literal["rad", "deg", "turn"] = "rad"
    sign: Sign = 1
    zero: float = 0.0


Finger = Literal["thumb", "index", "middle", "ring", "little"]


class ColumnMap(Strict):
    """What the columns of a log are. Columns that are not named are left out and listed."""

    device: str = Field(min_length=1)
    hand: str = Field(min_length=1)  # name of the hand model that the angles are of
    side: Literal["right", "left"]
    delimiter: str = Field(default=",", min_length=1, max_length=1)
    repair: bool = False  # drop rows that are late or double and keep those that are no pose as not tracked; count them
    time: TimeMap
    palm_position: PositionMap | None = None
    palm_rotation: RotationMap | None = None
    flexion: dict[Finger, AnglesMap]
    abduction: dict[Finger, AbductionMap] = Field(default_factory=dict)
    tracked: str | None = None  # 0 where the device had lost the hand
    object_position: PositionMap | None = None
    object_rotation: RotationMap | None = None

    @model_validator(mode="after")
    def _every_finger(self) -> ColumnMap:
        missing = [finger for finger in FINGERS if finger not in self.flexion]
        if missing:
            raise ValueError(f"a flexion of every finger; {', '.join(missing)} has none")
        if (self.object_position is None) != (self.object_rotation is None):
            raise ValueError("object_position and object_rotation together")
        return self

    @property
    def columns(self) -> list[str]:
        """Every column that the map names, time first."""
        named = [self.time.column, *([self.tracked] if self.tracked else [])]
        for part in (self.palm_position, self.palm_rotation, self.object_position, self.object_rotation):
            named += list(part.columns) if part else []
        for angles in self.flexion.values():
            named += angles.columns
        return named + [abduction.column for abduction in self.abduction.values()]


@dataclass(frozen=True)
class _Pose:
    position_m: Array
    rotation_wxyz: Array


def read_column_map(path: str | Path) -> ColumnMap:
    """A map from its TOML file. Raises PalmarError E-CONF with file, key and what is allowed."""
    try:
        keys = tomllib.loads(Path(path).read_text())
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PalmarError("E-CONF", str(path), f"not a TOML file that maps columns ({error})") from None
    found = validated(ColumnMap, keys, str(path))
    doubled = sorted({name for name in found.columns if found.columns.count(name) > 1})
    if doubled:
        raise PalmarError("E-CONF", str(path), f"column {doubled[0]!r} stands for two things")
    return found


def read_mapped_csv(path: str | Path, columns: ColumnMap) -> Trace:
    """Read a log by its map; joints without a column are NaN.

    Raises BadTrace as `palmar.traces.columns.read_log` does, and E-TRACE-VALUE for a row that is no pose, unless the
    map says `repair`.
    """
    unused = [name for name in read_header(Path(path), columns.delimiter) if name not in columns.columns]
    log = read_log(
        path,
        columns.columns,
        columns.time.column,
        unused=unused,
        may_be_empty=columns.columns if columns.repair else columns.columns[1:] if columns.tracked else [],
        delimiter=columns.delimiter,
        repair=columns.repair,
    )
    time_s = log.columns[columns.time.column] * TIME_S[columns.time.unit]
    shift_s = float(time_s[0]) if columns.time.from_zero else 0.0
    count = len(time_s)
    palm = _pose(log, columns.palm_position, columns.palm_rotation)
    body = _pose(log, columns.object_position, columns.object_rotation)
    tracked = np.ones(count, dtype=bool) if columns.tracked is None else log.columns[columns.tracked] > 0.5
    trace = Trace(
        header={
            "device": columns.device,
            "hand": columns.hand,
            "side": columns.side,
            "source": Path(path).name,
            "source_sha256": log.sha256,
        },
        time_s=time_s - shift_s,
        palm_position_m=palm.position_m,
        palm_rotation_wxyz=palm.rotation_wxyz,
        flexion_rad=_flexion(log, columns),
        abduction_rad=_abduction(log, columns),
        tracked=tracked,
        has_object_pose=np.full(count, columns.object_position is not None),
        object_position_m=body.position_m,
        object_rotation_wxyz=body.rotation_wxyz,
    )
    return _checked(trace, log, columns, unused, shift_s)


def _checked(trace: Trace, log: Log, columns: ColumnMap, unused: list[str], shift_s: float) -> Trace:
    unread = np.array([[_column_of(columns, f, joint) is None for joint in JOINTS] for f in FINGERS])
    # Joints that are not read must not look like rows that are broken.
    said = _with(trace, flexion_rad=np.where(unread, 0.0, trace.flexion_rad))
    counts: dict[str, Any] = {}
    sentences = [_sentence(columns, unused, shift_s)]
    if columns.repair:
        said, counts, more = receive(_arrival_s(said.time_s), said)
        sentences += more
    else:
        wrong = np.flatnonzero(~usable(said) & said.tracked)
        if wrong.size:
            raise BadTrace(
                "E-TRACE-VALUE",
                f"{log.where}:line {wrong[0] + 2}",
                "no pose of a hand (a field is empty, an angle above 10 rad, or a quaternion that is no rotation); "
                "repair = true in the map keeps such rows as not tracked",
            )
        said = hold_last_good(said)
    header = said.header | {"assumptions": json.dumps(sentences), "changed": json.dumps(counts)}
    if len(said.time_s) > 1:
        header["rate_hz"] = f"{1.0 / float(np.median(np.diff(said.time_s))):.6g}"
    return _with(said, header=header, flexion_rad=np.where(unread, np.nan, said.flexion_rad))


def _arrival_s(time_s: Array) -> Array:
    """When rows of a log came that kept no such times: as far apart as their own, where those rise."""
    apart = np.diff(time_s)
    rising = np.isfinite(apart) & (apart > 0)
    usual = float(np.median(apart[rising])) if rising.any() else 0.0
    return np.concatenate([[0.0], np.cumsum(np.where(rising, apart, usual))])


def _with(trace: Trace, **changes: Any) -> Trace:
    return Trace(**{**vars(trace), **changes})


def _pose(log: Log, position: PositionMap | None, rotation: RotationMap | None) -> _Pose:
    count = len(next(iter(log.columns.values())))
    at, turn = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    if position is not None:
        at = log.stack(list(position.columns)) * LENGTH_M[position.unit] * np.array(position.sign)
    if rotation is not None:
        said = log.stack(rotation.columns)
        if rotation.form == "quaternion":
            turn = said / np.maximum(np.linalg.norm(said, axis=1, keepdims=True), 1e-300)
            # One that is far from unit length was no rotation; it stays as it is, to be refused or counted.
            turn = np.where(np.abs(np.linalg.norm(said, axis=1, keepdims=True) - 1.0) <= 0.01, turn, said)
        else:
            radians = said * ANGLE_RAD[rotation.unit]
            known = np.isfinite(radians).all(axis=1)
            turns = (
                Rotation.from_rotvec(radians[known])
                if rotation.form == "vector"
                else Rotation.from_euler(rotation.form, radians[known])
            )
            turn = np.full((count, 4), np.nan)
            turn[known] = np.roll(turns.as_quat(), 1, axis=1)
        flips = np.where((turn[1:] * turn[:-1]).sum(axis=1) < 0, -1.0, 1.0)
        turn = turn * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    return _Pose(at, turn)


def _column_of(columns: ColumnMap, finger: str, joint: str) -> int | None:
    angles = columns.flexion[finger]  # type: ignore[index]
    joints = angles.joints_of_columns
    return joints.index(joint) if joint in joints else None


def _flexion(log: Log, columns: ColumnMap) -> Array:
    """(n, 5, 3) rad; NaN where there is no column."""
    count = len(log.columns[columns.time.column])
    flexion = np.full((count, 5, 3), np.nan)
    for f, finger in enumerate(FINGERS):
        angles = columns.flexion[finger]  # type: ignore[index]
        zero = np.broadcast_to(angles.zero, len(angles.columns))
        for k, joint in enumerate(JOINTS):
            column = _column_of(columns, finger, joint)
            if column is not None:
                said = log.columns[angles.columns[column]] - zero[column]
                flexion[:, f, k] = angles.sign * said * ANGLE_RAD[angles.unit]
    return flexion


def _abduction(log: Log, columns: ColumnMap) -> Array:
    abduction = np.zeros((len(log.columns[columns.time.column]), 5))
    for f, finger in enumerate(FINGERS):
        if finger in columns.abduction:
            angle = columns.abduction[finger]  # type: ignore[index]
            abduction[:, f] = angle.sign * (log.columns[angle.column] - angle.zero) * ANGLE_RAD[angle.unit]
    return abduction


def _sentence(columns: ColumnMap, unused: list[str], shift_s: float) -> str:
    parts = [f"Columns are what the map says; not used: {', '.join(unused) or 'none'}"]
    if columns.palm_position is None or columns.palm_rotation is None:
        parts.append("the log has no full palm pose: what is missing is the origin, unturned")
    if shift_s:
        parts.append(f"times are less {shift_s:.9g} s")
    without = [finger for finger in FINGERS if finger not in columns.abduction]
    if without:
        parts.append(f"abduction 0 of {', '.join(without)}")
    return "; ".join(parts) + "."
