"""Scene files: which keys a kind of scene has, and the cases that its sweeps make. Format: docs/traces.md."""

from __future__ import annotations

import copy
import itertools
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palmar.errors import PalmarError
from palmar.traces.columns import nearest

Three = tuple[float, float, float]
Which = Literal["thumb", "index", "middle", "ring", "little", "fingers", "all"]  # fingers: all but the thumb
Seconds = Annotated[float, Field(ge=0.0, le=600.0)]


class Strict(BaseModel):
    """No key beyond those named, and no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Phase = Literal["approach", "close", "open", "slide", "hold", "leave"]


class GraspScene(Strict):
    """A grasp, or a touch of some fingers, in phases. SI units; keys without a default are needed."""

    kind: Literal["grasp"]
    why: str = Field(min_length=1)
    rate_hz: float = Field(ge=50, le=8000)
    start_m: float = Field(ge=0.01, le=0.5)
    press_m: float = Field(ge=-0.15, le=0.02)  # palm into the object; below 0 it stays so far off
    fingers: list[Which] = ["all"]  # which close; the others stay open and clear of the object
    phases: list[Phase] = ["approach", "close", "slide", "hold", "leave"]
    squeeze_m: float = Field(ge=0.0, le=0.05)
    slide_radial_m: float = Field(ge=0.0, le=0.05)
    slide_distal_m: float = Field(ge=0.0, le=0.05)
    slide_turn_rad: float = Field(ge=0.0, le=0.5)
    vary_position_m: float = Field(ge=0.0, le=0.02)
    vary_turn_rad: float = Field(ge=0.0, le=0.3)
    open_rad: Three
    fist_rad: Three
    thumb_open_rad: Three
    thumb_fist_rad: Three
    approach_s: float = Field(ge=0.1, le=10)
    close_s: float = Field(ge=0.02, le=10)
    slide_s: float = Field(ge=0.1, le=10)
    hold_s: float = Field(ge=0.1, le=60)
    leave_s: float = Field(ge=0.1, le=10)
    open_s: float = Field(default=1.0, ge=0.02, le=10)

    @model_validator(mode="after")
    def _phases_that_fit(self) -> GraspScene:
        closed = False
        if self.phases[:1] != ["approach"] or self.phases[-1:] != ["leave"]:
            raise ValueError("phases from approach to leave")
        for phase in self.phases[1:-1]:
            if phase in ("approach", "leave") or (phase == "close") == closed:
                raise ValueError("close first, then slide, hold or open, and close again after open only")
            closed = phase != "open"
        return self


class Key(Strict):
    """A posture and how the hand gets there from the key before. What a key does not say stays as it was."""

    after_s: Seconds | None = None  # since the key before
    speed_m_per_s: float | None = Field(default=None, gt=0.0, le=100.0)  # of the point, instead of after_s
    move: Literal["linear", "min_jerk", "hold"] = "linear"  # hold: stay, and be there at once at the end
    phase: str = ""  # name of the time from the key before to this one
    position_m: Three | None = None
    move_m: Three | None = None  # from the key before, instead of position_m
    turn_rad: Three | None = None  # rotation vector, world from palm
    flexion_rad: dict[Which, Three] = {}  # later entries overrule earlier ones
    abduction_rad: dict[Which, float] = {}
    object_position_m: Three | None = None
    object_turn_rad: Three | None = None

    @model_validator(mode="after")
    def _one_of_each(self) -> Key:
        if self.position_m is not None and self.move_m is not None:
            raise ValueError("position_m or move_m, not both")
        if self.after_s is not None and self.speed_m_per_s is not None:
            raise ValueError("after_s or speed_m_per_s, not both")
        return self


class Disturbance(Strict):
    """What goes wrong with the samples from at_s on for for_s; in the header it is a phase of the name disturbance."""

    kind: Literal[
        "spike",
        "frozen",
        "untracked",
        "zeros",
        "broken",
        "stuck",
        "dropped",
        "doubled",
        "swapped",
        "late",
        "clock",
        "sampled",
    ]
    at_s: Seconds = 0.0  # since the first sample
    for_s: Seconds = 600.0
    share: float = Field(default=1.0, gt=0.0, le=1.0)  # of the samples in that time, drawn by the seed
    move_m: Three = (0.0, 0.0, 0.0)  # added by a spike
    turn_rad: Three = (0.0, 0.0, 0.0)  # likewise
    flexion_rad: float = 0.0  # likewise, to every joint
    of: Literal["palm", "thumb", "index", "middle", "ring", "little", "fingers", "all"] = "all"  # broken, stuck
    value: Literal["nan", "inf", "-inf", "huge", "denormal"] = "nan"  # that a broken number has
    by_s: float = Field(default=0.0, ge=-1e6, le=1e6)  # how late a sample comes; by how much the clock leaps
    times: int = Field(default=2, ge=2, le=10)  # how often a doubled sample comes
    own_times: bool = (
        False  # whether each double has a time of its own, as in a stream that was padded to a higher rate
    )
    rate_hz: float = Field(default=1000.0, ge=10.0, le=8000.0)  # of the device that samples the motion
    jitter: float = Field(default=0.0, ge=0.0, le=0.49)  # share of its interval that a sample may be early or late

    @model_validator(mode="after")
    def _its_own_keys(self) -> Disturbance:
        allowed = {"kind", "at_s", "for_s", *KEYS_OF_DISTURBANCE[self.kind]}
        for key in self.model_fields_set - allowed:
            raise ValueError(f"{', '.join(sorted(allowed - {'kind'}))} with kind {self.kind}, not {key}")
        return self


KEYS_OF_DISTURBANCE: dict[str, tuple[str, ...]] = {
    "spike": ("share", "move_m", "turn_rad", "flexion_rad"),
    "frozen": (),
    "untracked": (),
    "zeros": ("share",),
    "broken": ("share", "of", "value"),
    "stuck": ("of",),
    "dropped": ("share",),
    "doubled": ("share", "times", "own_times"),
    "swapped": ("share",),
    "late": ("share", "by_s"),
    "clock": ("by_s",),
    "sampled": ("rate_hz", "jitter"),
}


class Faults(Strict):
    """A file of faults for any trace: the same tables as in a scene."""

    disturbance: list[Disturbance] = Field(min_length=1)


class Noise(Strict):
    """Added to every sample; white, or inside band_hz; quantum_rad rounds the joint angles after it."""

    position_m: float = Field(default=0.0, ge=0.0, le=0.1)  # standard deviation of each coordinate
    turn_rad: float = Field(default=0.0, ge=0.0, le=1.0)  # about each axis
    joint_rad: float = Field(default=0.0, ge=0.0, le=1.0)
    band_hz: tuple[float, float] | None = None
    quantum_rad: float = Field(default=0.0, ge=0.0, le=0.5)


class Limit(Strict):
    """What a metric's number may be in this scene; reported only if there is no limit."""

    limit: float | None = Field(default=None, ge=0.0)
    reason: str = Field(min_length=10)


class Region(Strict):
    """Half-spaces n.x > d, in the object's frame, in all of which no axis of the links may ever be."""

    half_spaces: list[tuple[float, float, float, float]] = Field(min_length=1)
    links: list[Annotated[int, Field(ge=0, le=15)]] | None = None


class Played(Strict):
    """The glove's actuator that the solver's forces go through, as `palmar record --actuator` has it."""

    cap_n: float = Field(default=20.0, ge=0.01, le=1000.0)
    brake_only: bool = True
    quantum_n: float = Field(default=0.0, ge=0.0, le=100.0)
    rate_hz: float = Field(default=200.0, ge=10.0, le=8000.0)  # at which it is commanded


class Sampled(Strict):
    """What scenes for `palmar check` have in common: the object, how the motion is sampled, and what is asked."""

    id: str = Field(pattern=r"^[A-Z]\d+[a-z]?$")
    why: str = Field(min_length=80)
    rate_hz: float = Field(default=1000.0, ge=50, le=8000)
    hold_hz: float = Field(default=0.0, ge=0.0, le=8000)  # a sample is kept so long; 0: no longer than one
    starts: int = Field(default=1, ge=1, le=1000)  # replays, whose first samples are spread over one sample's time
    object: dict[str, Any]
    point: Literal["frame", "palm", "thumb", "index", "middle", "ring", "little", "hand"] = "frame"
    towards: Three = (0.0, 0.0, -1.0)
    disturbance: list[Disturbance] = []
    noise: Noise = Noise()
    settings: dict[str, str | int | float] = {}
    limits: dict[str, Limit] = {}
    metrics: list[str] = []  # whose limits this scene is about, beside penetration_spheres and frozen_steps
    figures: list[str] = []  # numbers to print, METRIC STAT
    far_side: list[Region] = []
    settled_after_steps: int | None = Field(default=None, ge=1)  # of constant input; then no force may change by a bit
    end_offset_m: float | None = Field(default=None, ge=0.0)  # how far the palm may be from the glove's at the end
    same_end_force_n: float | None = Field(default=None, ge=0.0)  # how far the last forces of its cases may differ
    same_end_m: float | None = Field(default=None, ge=0.0)  # how far the last places of the palm shown may differ
    force_gone_after_s: float | None = Field(
        default=None, ge=0.0
    )  # since the last tracked sample; then nothing is felt
    actuator: Played | None = None  # whose commands have to be the solver's forces as far as it can give them
    sweep: list[dict[str, list[Any]]] = []


class KeysScene(Sampled):
    """A hand that goes from key to key."""

    kind: Literal["keys"]
    key: list[Key] = Field(min_length=2)
    repeat: int = Field(default=1, ge=1, le=1000)  # of all keys but the first


class RandomScene(Sampled):
    """Random targets at random times inside a box of places and postures; each of the `starts` draws its own."""

    kind: Literal["random"]
    seed: int = Field(default=0, ge=0)
    lasts_s: float = Field(ge=0.1, le=600)
    start_m: Three
    every_s: tuple[float, float]
    low_m: Three
    high_m: Three
    turn_rad: float = Field(ge=0.0, le=3.2)  # about each axis, to either side of `turned_rad`
    turned_rad: Three = (0.0, 0.0, 0.0)
    flexion_rad: tuple[float, float]
    abduction_rad: tuple[float, float]
    jump_share: float = Field(ge=0.0, le=1.0)  # of the targets that are there at once


Scene = GraspScene | KeysScene | RandomScene
Table = TypeVar("Table", bound=BaseModel)
SCENE_KINDS: dict[str, type[Scene]] = {"grasp": GraspScene, "keys": KeysScene, "random": RandomScene}


def check_scene(keys: dict[str, Any], where: str) -> Scene:
    """The scene's keys with their types and ranges checked. Raises PalmarError E-CONF `where:key`."""
    kind = keys.get("kind")
    if kind not in SCENE_KINDS:
        raise PalmarError(
            "E-CONF", f"{where}:kind", f"found {kind!r}; allowed is {' or '.join(map(repr, SCENE_KINDS))}"
        )
    return validated(SCENE_KINDS[kind], keys, where)


def validated(model: type[Table], keys: dict[str, Any], where: str) -> Table:
    """The keys as the model has them. Raises PalmarError E-CONF `where:key` for the first fault."""
    try:
        return model.model_validate(keys)
    except ValidationError as error:
        # The first fault alone: an unknown key before the missing one that it was meant to be.
        fault = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "extra_forbidden":
        known = _known_keys(model, fault["loc"])
        last = str(fault["loc"][-1])
        raise PalmarError(
            "E-CONF", f"{where}:{key}", f"unknown key{nearest(last, known)}; known are {', '.join(known)}"
        )
    if fault["type"] == "missing":
        raise PalmarError("E-CONF", f"{where}:{key}", "key is missing")
    message = fault["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
    raise PalmarError("E-CONF", f"{where}:{key}", f"found {fault['input']!r}; allowed is {message}")


def cases_of(keys: dict[str, Any], where: str) -> list[tuple[str, dict[str, Any]]]:
    """Every case of a scene: its name, "" if there is one alone, and the scene's keys with the sweeps put in.

    A sweep is a table from places in the scene, such as `key.1.speed_m_per_s`, to lists of values, all of one length
    and taken together; several sweeps multiply. Raises PalmarError E-CONF.
    """
    axes = []
    for number, sweep in enumerate(keys.get("sweep", [])):
        at = f"{where}:sweep.{number}"
        lengths = {len(values) if isinstance(values, list) else -1 for values in sweep.values()}
        if len(lengths) != 1 or not min(lengths) > 0:
            raise PalmarError("E-CONF", at, "lists that are empty or of several lengths; one length is allowed")
        axes.append([[(place, values[k]) for place, values in sweep.items()] for k in range(lengths.pop())])
    cases = []
    for chosen in itertools.product(*axes):
        changed = copy.deepcopy({key: value for key, value in keys.items() if key != "sweep"})
        for place, value in itertools.chain(*chosen):
            _put(changed, place, value, where)
        # The first place of each sweep names the case; what goes with it follows from it.
        name = ", ".join(f"{_short(places[0][0])} {_say(places[0][1])}" for places in chosen)
        check_scene(changed, f"{where} [{name}]" if name else where)
        cases.append((name, changed))
    return cases


def _put(keys: dict[str, Any], place: str, value: Any, where: str) -> None:
    *way, last = place.split(".")
    inside: Any = keys
    try:
        for part in way:
            inside = inside[int(part)] if isinstance(inside, list) else inside.setdefault(part, {})
        if isinstance(inside, list):
            inside[int(last)] = value
        else:
            inside[last] = value
    except (ValueError, IndexError, TypeError, AttributeError):
        raise PalmarError("E-CONF", f"{where}:sweep", f"{place!r} is no place in the scene") from None


def _short(place: str) -> str:
    words = [part for part in place.split(".") if not part.isdigit()]
    return words[-1]


def _say(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(_say(part) for part in value.values() if not isinstance(part, list))
    return f"{value:g}" if isinstance(value, float) else str(value).replace(" ", "")


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """The keys of the table in which an unknown one was found."""
    tables: dict[str, type[BaseModel]] = {
        "key": Key,
        "disturbance": Disturbance,
        "noise": Noise,
        "limits": Limit,
        "actuator": Played,
        "far_side": Region,
    }
    inner = tables.get(str(location[0])) if len(location) > 1 else None
    return list((inner or model).model_fields)
