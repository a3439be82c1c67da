"""The `record` and `emulate` verbs: a hand, a port, a place of the palm and a file put together, and what is told."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from palmar._runtime import DeviceRecording
from palmar.errors import BadPack, BadTrace, GloveError, PalmarError
from palmar.model import HandModel, load_pack
from palmar.profile import Profile, fit_to_profile
from palmar.records import read_trace
from palmar.tools.default_hands import find_hand
from palmar.tools.profile_file import read_profile
from palmar.traces.actuator import actuator_of
from palmar.traces.emulate import USUAL_HZ, Emulator, summarise_emulation
from palmar.traces.glove_angles import DEVICE
from palmar.traces.line_faults import Faults, Log, parse_faults
from palmar.traces.live_hand import LiveHand
from palmar.traces.live_line import LiveLine, RateMeter, bars, clock
from palmar.traces.opengloves import FORCE_FULL_SCALE, FULL_SCALE, Decoder
from palmar.traces.port import BAUD, Port, require_port
from palmar.traces.pose_source import open_pose
from palmar.traces.readings import require_readings
from palmar.traces.record import Recorder, summarise_recording
from palmar.traces.wire import Pty, Server


def record(
    device: str,
    ports: Sequence[str],
    out: Path,
    *,
    baud: int = BAUD,
    full_scale: int = FULL_SCALE,
    hand_name: str | None = None,
    profile_path: Path | None = None,
    side: str | None = None,
    pose: str = "constant",
    pose_offset_ms: float = 0.0,
    pose_mount: str = "",
    duration_s: float | None = None,
    rate_hz: float | None = None,
    passive: bool = False,
    solve: Path | None = None,
    object_name: str = "",
    settings: dict[str, Any] | None = None,
    feedback: bool = False,
    actuator: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Record until the duration is over or a signal ends it; what was recorded and lost. docs/record.md has the flags.

    "failed" stands in the answer, and the file is whole up to there, if the disk took no more. Raises PalmarError,
    BadPack, BadTrace, GloveError; then no file is left.
    """
    if device != DEVICE:
        raise PalmarError("E-CONF", "--device", f"{device!r}; known are {DEVICE}")
    if out.exists():
        raise PalmarError("E-FILE-PLACE", str(out), "is there already, and a recording is never written over")
    if (feedback or settings or object_name) and solve is None:
        raise PalmarError("E-USAGE", "--feedback, --set, --object", "are of a solver; --solve PACK is missing")
    if actuator and not feedback:
        raise PalmarError("E-USAGE", "--actuator", "is for what is sent back; --feedback is missing")
    if feedback and passive:
        raise PalmarError("E-USAGE", "--passive", "sends nothing, and --feedback sends forces; one of them is allowed")
    hand, profile = _hand_of(hand_name, profile_path, side, solve)
    force = actuator_of(actuator or {}) if feedback else None
    live = None if solve is None else LiveHand(solve, object_name, settings or {}, force)
    start_s, started = time.monotonic(), datetime.now(UTC)
    source = open_pose(pose, hand, offset_s=pose_offset_ms / 1e3, mount=pose_mount, baud=baud)
    with closing(source), closing(Port(ports, baud)) as port:
        require_port(port, "--port")
        header = {
            "device": DEVICE,
            "hand": str(hand.about.get("name", "")),
            "side": str(hand.about["side"]),
            "full_scale": str(full_scale),
            "started_utc": started.isoformat(timespec="milliseconds"),
            "started_monotonic_s": f"{start_s:.6f}",
            "assumptions": json.dumps([*_sentences(full_scale, profile), source.about]),
            **({"profile_sha256": profile.sha256} if profile else {}),
            **({"object": object_name} if object_name else {}),
        }
        recorder = Recorder(
            port,
            source,
            DeviceRecording(str(out), header),
            hand,
            profile=profile,
            decoder=Decoder(full_scale),
            side=header["side"],
            live=live,
            passive=passive,
            start_s=start_s,
        )
        try:
            with _stop_signals() as stopped, _shown(_recorder_line) as told:
                recorder.run(stopped, told, duration_s)
            return _finish(recorder, out, rate_hz)
        except BaseException:
            if not recorder.tally.samples:
                out.unlink(missing_ok=True)
            raise


def emulate(
    trace_path: Path,
    *,
    hand_name: str | None = None,
    link: Path | None = None,
    listen: str = "",
    form: str = "curls",
    full_scale: int = FULL_SCALE,
    rate_hz: float | None = None,
    lock_step: bool = False,
    auto_range: bool = False,
    jitter_ms: float = 0.0,
    drift_ppm: float = 0.0,
    count_lines: bool = False,
    loop: bool = False,
    duration_s: float | None = None,
    faults: dict[str, Any] | None = None,
    seed: int = 0,
    log: Path | None = None,
    poses_to: str = "",
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Play a trace as a glove until it is over, the duration is, or a signal ends it; what was sent.

    say is told the name of the port. Raises PalmarError, BadPack, BadTrace.
    """
    if form not in ("curls", "joints", "legacy"):
        raise PalmarError("E-CONF", "--form", f"{form!r}; curls, joints or legacy is allowed")
    if link is not None and listen:
        raise PalmarError("E-USAGE", "--listen", "is a socket, and --link names a terminal; one of them is allowed")
    trace = read_trace(trace_path)
    hand = find_hand(hand_name)
    host, _, number = poses_to.removeprefix("udp://").rpartition(":")
    if poses_to and not (poses_to.startswith("udp://") and number.isdigit() and 0 < int(number) < 65536):
        raise PalmarError("E-CONF", "--poses-to", f"{poses_to!r}; udp://HOST:PORT is needed")
    recorded_hz = float(trace.header.get("rate_hz") or USUAL_HZ)
    chosen = Faults(parse_faults(faults or {}), full_scale, seed)
    with closing(Server(listen) if listen else Pty(link)) as wire, closing(Log(log)) as written:
        emulator = Emulator(
            trace,
            hand,
            wire,
            form=form,
            full_scale=full_scale,
            rate_hz=rate_hz or min(recorded_hz, USUAL_HZ),
            lock_step=lock_step,
            auto_range=auto_range,
            jitter_s=jitter_ms / 1e3,
            drift_ppm=drift_ppm,
            count_lines=count_lines,
            loop=loop,
            faults=chosen,
            log=written,
            seed=seed,
            poses_to=(host, int(number)) if poses_to else None,
        )
        say(wire.name)
        with _stop_signals() as stopped, _shown(_emulator_line) as told:
            emulator.run(stopped, told, duration_s)
    return summarise_emulation(emulator)


def _hand_of(
    hand_name: str | None, profile_path: Path | None, side: str | None, solve: Path | None
) -> tuple[HandModel, Profile | None]:
    """The hand that is recorded, of the pack if there is one, and the profile with its sensor ranges."""
    profile = None if profile_path is None else read_profile(profile_path)
    if profile is not None:
        require_readings(profile, DEVICE, side or profile.side)
    hand = find_hand(hand_name) if profile is None else fit_to_profile(find_hand(hand_name), profile)
    if solve is not None:
        packed = load_pack(solve).hand
        if (hand_name or profile) and packed.about.get("sha256") != hand.about["sha256"]:
            found = f"built for hand {packed.about.get('name', 'unnamed')}, the recording is of {hand.about['name']}"
            raise BadPack("E-PACK-HAND", str(solve), f"{found}; build it with the same --hand and --profile")
        hand = packed
    if side is not None and side != hand.about["side"]:
        raise PalmarError("E-CONF", "--side", f"{side!r}; hand {hand.about['name']} is a {hand.about['side']} one")
    return hand, profile


def _sentences(full_scale: int, profile: Profile | None) -> list[str]:
    scaled = (
        "A joint is straight at 0 and at the end of its range at the full scale."
        if profile is None
        else f"Readings are scaled by profile {profile.name}: its open hand is straight, its fist at the end of each "
        "joint's range."
    )
    return [
        f"The glove's full scale is {full_scale}.",
        scaled,
        "Joints that the glove does not send follow the hand's coupling; abductions that it does not send are 0.",
        "A sample's time is when its line arrived; lines that came together are a microsecond apart.",
    ]


def _finish(recorder: Recorder, out: Path, rate_hz: float | None) -> dict[str, Any]:
    """End the file and say what is in it. Raises GloveError if no line could be read; then no file is left."""
    tally = recorder.tally
    summary = summarise_recording(recorder, rate_hz)
    if not tally.samples and recorder.failed is None:
        out.unlink(missing_ok=True)
        if not tally.bytes:
            found = "nothing came: is the glove on, and this its port? Firmware that waits for a host needs an answer"
        else:
            kinds = ", ".join(f"{count} {kind}" for kind, count in tally.rejected.most_common())
            found = f"{tally.bytes} bytes came and no line of them reads ({kinds or 'no line ended'})"
            found += f"; --baud {recorder.port.baud} and --full-scale {recorder.decoder.full_scale} are what was tried"
        raise GloveError("E-GLOVE-SILENT", ", ".join(recorder.port.opened), found)
    if recorder.failed is None:
        end = {"changed": json.dumps(_changed(summary)), "recorded": json.dumps(summary)}
        end["rate_hz"] = f"{summary['clock']['rate_hz']:.6g}"
        recorder.recording.close(end)
    answer = {"out": str(out), **summary}
    if recorder.failed is not None:
        answer["failed"] = str(recorder.failed)
        answer["samples in the file"] = _count_whole(out)
    if recorder.decoder.largest * 4 < recorder.decoder.full_scale:
        answer["hint"] = f"no count was above {recorder.decoder.largest}: an AVR has --full-scale 1023"
    return answer


def _count_whole(out: Path) -> int:
    """Samples that can be read of a file that was not ended."""
    try:
        return len(read_trace(out).time_s)
    except BadTrace:
        return 0


def _changed(summary: dict[str, Any]) -> dict[str, Any]:
    counts = {f"lines rejected: {kind}": count for kind, count in summary["rejected"].items()}
    if summary["gaps"]["count"]:
        counts["gaps without a line"] = summary["gaps"]["count"]
        counts["seconds without a line"] = round(summary["gaps"]["seconds"], 3)
    return counts


def _recorder_line(meter: RateMeter) -> Callable[[Recorder], str]:
    def text(recorder: Recorder) -> str:
        tally = recorder.tally
        if not recorder.port.is_open:
            return f"{clock(recorder.time_s)}  {tally.samples} samples  waiting for {recorder.port.problem}"
        jitter = recorder.arrivals.recent_jitter_s * 1e3
        spread = "  ..." if math.isnan(jitter) else f"{jitter:5.2f}"
        shares = [math.nan] * 5 if recorder.last is None else _curls(recorder.last.flexion)
        rejected = tally.rejected.total() + recorder.overlong
        line = f"{clock(recorder.time_s)}  {meter.rate(recorder.time_s, tally.decoded):6.1f} Hz  "
        line += f"jitter {spread} ms  {tally.samples} samples  {rejected} rejected  {tally.gaps} gaps  "
        if recorder.recording.dropped:
            line += f"{recorder.recording.dropped} dropped  "
        line += bars(shares)
        if recorder.live is not None and recorder.live.levels:
            line += "  force " + bars([level / FORCE_FULL_SCALE for level in recorder.live.levels])
        return line

    return text


def _emulator_line(meter: RateMeter) -> Callable[[Emulator], str]:
    def text(emulator: Emulator) -> str:
        good = emulator.sent["good"]
        bad = emulator.sent.total() - good
        line = f"{meter.rate(time.monotonic(), good):6.1f} Hz  {good} lines  {bad} faults  {emulator.answers} answers  "
        return line + "force " + bars([level / FORCE_FULL_SCALE for level in emulator.force])

    return text


def _curls(flexion: list[float]) -> list[float]:
    """One share a finger: the mean of the joints that are sent."""
    fingers = [[x for x in flexion[3 * f : 3 * f + 3] if not math.isnan(x)] for f in range(5)]
    return [sum(finger) / len(finger) if finger else math.nan for finger in fingers]


@contextmanager
def _shown(line: Callable[[RateMeter], Callable[[Any], str]]) -> Iterator[Callable[[Any], None]]:
    live, text = LiveLine(), line(RateMeter())
    try:
        yield lambda subject: live.show(lambda: text(subject))
    finally:
        live.close()


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Ctrl-C, and what ends a service or closes a terminal, ask for an end; a second Ctrl-C does not wait for it."""
    asked: list[int] = []

    def ask(number: int, frame: Any) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
