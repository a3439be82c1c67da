"""The recorder against the emulated glove, measured: `python tests/traces/glove_figures.py --help`.

Prints the tables of docs/record.md. The tests run the same functions for some seconds.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from palmar.errors import PalmarError
from palmar.model import AssetPack, SphereTree, save_pack
from palmar.records import Trace, read_trace, write_trace
from palmar.tools.default_hands import find_hand
from palmar.tools.hierarchy import bounds_over
from palmar.traces.opengloves import Reading, encode_reading
from palmar.traces.scripted import script

DRIFT_PPM = 200  # of the emulated glove with every fault on
PALMAR = [sys.executable, "-c", "from palmar.cli import main; main()"]


def moving_trace(path: Path, seconds: float = 20.0, rate_hz: float = 200.0) -> Trace:
    """A hand that opens, closes and spreads, each finger at its own pace, inside the ranges of the default hand."""
    hand = find_hand(None)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    pace = np.array([0.31, 0.43, 0.57, 0.71, 0.83])
    closed = 0.5 - 0.5 * np.cos(2 * np.pi * time_s[:, None] * pace)
    flexion = closed[:, :, None] * hand.flexion_limit_rad[..., 1] * np.array([0.9, 0.8, 0.7])
    low, high = hand.abduction_limit_rad.T
    swing = np.sin(2 * np.pi * time_s[:, None] * pace[::-1])
    position = 0.1 * np.stack([np.sin(time_s), np.cos(0.7 * time_s), 0.2 * np.sin(1.3 * time_s)], axis=1)
    turn = 0.2 * np.sin(0.5 * time_s)
    zero = np.zeros_like(time_s)
    count = len(time_s)
    trace = Trace(
        header={"device": "script", "hand": hand.about["name"], "side": "right", "rate_hz": f"{rate_hz:g}"},
        time_s=time_s,
        palm_position_m=position,
        palm_rotation_wxyz=np.stack([np.cos(turn), zero, zero, np.sin(turn)], axis=1),
        flexion_rad=flexion,
        abduction_rad=np.where(swing < 0, -low, high) * swing * 0.9,
        tracked=np.ones(count, dtype=bool),
        has_object_pose=np.zeros(count, dtype=bool),
        object_position_m=np.zeros((count, 3)),
        object_rotation_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
    )
    write_trace(path, trace)
    return trace


class Glove:
    """`palmar emulate` in a process of its own; `port` is a pattern that finds it under every name."""

    def __init__(self, trace: Path, *flags: str) -> None:
        link, self.log = trace.with_suffix(".port"), trace.with_suffix(".log")
        self.port = f"{link}*"
        self.process = start("emulate", str(trace), "--link", str(link), "--log", str(self.log), "--json", *flags)
        while not link.is_symlink():
            if self.process.poll() is not None:
                raise RuntimeError(self.process.stderr.read())
            time.sleep(0.02)

    def stop(self) -> dict:
        """What it sent."""
        os.kill(self.process.pid, signal.SIGINT)  # not by Popen, which may reap it first
        return answer_of(self.process)[0]

    def sent(self) -> list[dict]:
        return [json.loads(line) for line in self.log.read_text().splitlines()]


def start(*arguments: str, **how) -> subprocess.Popen:
    return subprocess.Popen([*PALMAR, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how)


def answer_of(process: subprocess.Popen) -> tuple[dict, float]:
    """The answer of a command with --json, and the CPU seconds that it took."""
    output = process.stdout.read()
    complaint = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if not output:
        raise RuntimeError(f"exit {process.returncode}: {complaint}")
    return json.loads(output), usage.ru_utime + usage.ru_stime


def record(port: str, out: Path, *flags: str) -> tuple[dict, float]:
    return answer_of(start("record", "--device", "opengloves", "--port", port, "-o", str(out), "--json", *flags))


def readings_of(path: Path) -> list[str]:
    """Every reading in a recording, by another MCAP library, as the line that it was."""
    lines = []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, reading in reader.iter_decoded_messages(topics=["/device_reading"]):
            shares = Reading(
                list(reading.flexion), [0.0] * 5, tuple(reading.joystick), reading.trigger, reading.buttons
            )
            lines.append(encode_reading(shares).decode().strip())
    return lines


def faults_for(seconds: float, folder: Path, share: float = 1.0) -> dict:
    """Every fault of the emulator at 200 lines a second, and what the recorder made of it."""
    moving_trace(folder / "source.mcap")
    flags = ["--loop", "--count-lines", "--drift-ppm", str(DRIFT_PPM), "--jitter-ms", "0.3", "--fault", f"all={share}"]
    glove = Glove(folder / "source.mcap", *flags)
    answer, cpu_s = record(glove.port, folder / "faults.mcap", "--rate-hz", "200", "--duration-s", str(seconds))
    emulated = glove.stop()
    sent = glove.sent()
    unplugged = [entry["time_s"] for entry in sent if entry["kind"] == "plug"]
    # What was sent when the recorder had ended, or was about to, counts neither way.
    begun_s = float(read_trace(folder / "faults.mcap").header["started_monotonic_s"])
    in_time = [entry for entry in sent if entry["time_s"] < begun_s + answer["duration_s"] - 0.2]
    good = Counter(entry["text"] for entry in in_time if entry["kind"] == "good")
    late = Counter(entry["text"] for entry in sent[len(in_time) :])
    kept = Counter(readings_of(folder / "faults.mcap"))
    return {
        "seconds": answer["duration_s"],
        "emulated": emulated["sent"],
        "good_lines_sent": good.total(),
        "good_lines_lost": (good - kept).total(),
        "wrong_readings": (kept - good - late).total(),
        "unplugs": len(unplugged),
        "cpu_percent": 100.0 * cpu_s / answer["duration_s"],
        "recorder": answer,
    }


def lock_step_for(seconds: float, folder: Path) -> dict:
    """Lines a second of a glove that waits for an answer, answered and not."""
    moving_trace(folder / "source.mcap")
    rates = {}
    for name, flags in (("answered", []), ("passive", ["--passive"])):
        glove = Glove(folder / "source.mcap", "--lock-step", "--loop")
        answer, _ = record(glove.port, folder / f"{name}.mcap", "--duration-s", str(seconds), *flags)
        glove.stop()
        times = read_trace(folder / f"{name}.mcap")
        times = times.time_s[times.tracked]
        rates[name] = (answer["lines"]["decoded"] - 1) / (times[-1] - times[0])
    return rates


def kills(count: int, folder: Path, seed: int = 0) -> dict:
    """The recorder killed at random moments: what is in the file against what had arrived."""
    moving_trace(folder / "source.mcap")
    generator, lost_s, unreadable = random.Random(seed), [], 0
    for number in range(count):
        glove = Glove(folder / "source.mcap", "--loop")
        out = folder / f"killed_{number}.mcap"
        process = start("record", "--device", "opengloves", "--port", glove.port, "-o", str(out), "--json")
        while not has_samples(out):
            if process.poll() is not None:
                raise RuntimeError(process.stderr.read())
            time.sleep(0.05)
        time.sleep(generator.uniform(0.0, 1.5))
        process.kill()
        killed_s = time.monotonic()
        process.communicate()
        try:
            trace = read_trace(out)
            last_s = float(trace.header["started_monotonic_s"]) + trace.time_s[-1]
            lost_s.append(killed_s - last_s)
        except PalmarError as error:
            unreadable += 1
            print(error, file=sys.stderr)
        glove.stop()
        out.unlink()
    return {"kills": count, "unreadable": unreadable, "lost_s": lost_s}


def silences(seconds: float, folder: Path) -> dict:
    """Force feedback on a ball: how long after the last good line the glove is told to let go."""
    pack, scene = folder / "ball.pack", folder / "grasp.mcap"
    ball = np.array([[0.0, 0.0, 0.0, 0.035]])
    corners = 0.035 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tree = SphereTree([ball], [bounds_over(ball)], corners, np.zeros((0, 3), dtype=np.int32), {"levels": [{}]})
    save_pack(pack, AssetPack(find_hand(None), {"ball": tree}, {}))
    script("grasp", pack, scene)
    faults = ["--fault", "silence=0.01:0.3", "--fault", "unplug=0.003:0.3", "--fault", "other=0.002:0.3"]
    glove = Glove(scene, "--loop", "--form", "joints", "--count-lines", *faults)
    flags = ["--solve", str(pack), "--feedback", "--pose", str(scene), "--duration-s", str(seconds)]
    answer, _ = record(glove.port, folder / "felt.mcap", *flags)
    glove.stop()
    waits, last_s, waiting = [], 0.0, False
    for entry in glove.sent():
        if entry["kind"] == "silence":
            waiting = waiting or bool(entry["text"])
        elif waiting:
            waits.append((entry["time_s"] if entry["kind"] == "no force" else np.inf) - last_s)
            waiting = False
        if entry["kind"] == "good":
            last_s = entry["time_s"]
    return {"let_go_s": waits, "feedback": answer["feedback"], "gaps": answer["gaps"]["count"]}


def has_samples(path: Path) -> bool:
    try:
        return len(read_trace(path).time_s) > 0
    except PalmarError:
        return False


def round_trip(folder: Path, form: str, seconds: float = 4.0) -> dict:
    """Emulator -> record -> trace against the source, at the encoding's own steps."""
    source = moving_trace(folder / "source.mcap", 5.0)
    hand = find_hand(None)
    glove = Glove(folder / "source.mcap", "--form", form, "--poses-to", "udp://127.0.0.1:47000", "--count-lines")
    record(glove.port, folder / f"back_{form}.mcap", "--duration-s", str(seconds), "--pose", "udp://127.0.0.1:47000")
    glove.stop()
    back = read_trace(folder / f"back_{form}.mcap")
    played_s = {entry["line"]: entry["played_s"] for entry in glove.sent() if entry["kind"] == "good"}
    lines = [int(line.split("F")[1].split("G")[0]) for line in readings_of(folder / f"back_{form}.mcap")]
    numbers = np.floor(np.array([played_s[line] for line in lines]) * 200.0 + 1e-6).astype(int)
    seen = back.tracked
    played = source.flexion_rad[numbers], source.abduction_rad[numbers], source.palm_position_m[numbers]
    step = hand.flexion_limit_rad[..., 1] / 4095
    splay = np.abs(hand.abduction_limit_rad).max() * 2 / 4095
    joint = slice(None) if form == "joints" else slice(0, 1)
    count = min(len(numbers), int(seen.sum()))
    flexion = np.abs(back.flexion_rad[seen][:count] - played[0][:count]) / step
    answer = {"samples": count, "flexion_steps": float(flexion[:, :, joint].max())}
    if form == "joints":
        answer["abduction_steps"] = float((np.abs(back.abduction_rad[seen][:count] - played[1][:count]) / splay).max())
    away = np.linalg.norm(back.palm_position_m[seen][:count] - played[2][:count], axis=1)
    answer["palm_mm_p99"] = float(np.percentile(away, 99) * 1e3)
    return answer


def show_faults(figures: dict) -> None:
    """The table of docs/record.md."""
    recorder, sent = figures["recorder"], figures["emulated"]
    faults = ", ".join(f"{kind} {count}" for kind, count in sent.items() if kind != "good")
    print(f"every fault on, {figures['seconds']:.0f} s: {figures['good_lines_sent']} good lines; {faults}")
    print(f"  good lines lost {figures['good_lines_lost']}, readings that no good line was {figures['wrong_readings']}")
    print(f"  lines {recorder['lines']}, rejected {recorder['rejected']}")
    print(f"  broken parts before good lines {recorder['broken parts before good lines']}, gaps {recorder['gaps']}")
    lines_s = figures["good_lines_sent"] / figures["seconds"]
    print(f"  {lines_s:.1f} good lines a second; CPU {figures['cpu_percent']:.2f} % of a core")
    print(f"  clock {recorder['clock']}, the glove's was {DRIFT_PPM} ppm fast")


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="glove_figures") as folder:
        measure(Path(folder))


def measure(folder: Path) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="with every fault on")
    parser.add_argument("--kills", type=int, default=100)
    arguments = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")

    rates = lock_step_for(10.0, folder)
    print(f"lock-step firmware: answered {rates['answered']:.1f} lines/s, passive {rates['passive']:.2f}")
    for form in ("curls", "joints"):
        print(f"round trip, {form}: {round_trip(folder, form)}")
    felt = silences(30.0, folder)
    waits = np.array(felt["let_go_s"]) * 1e3
    print(f"let go after the last good line: {len(waits)} times, p50 {np.median(waits):.0f}, max {waits.max():.0f} ms")
    print(f"  {felt['feedback']}, gaps {felt['gaps']}")
    killed = kills(arguments.kills, folder)
    lost = np.array(killed["lost_s"]) * 1e3
    print(f"killed {killed['kills']} times: {killed['unreadable']} files unreadable, of the last samples")
    print(f"  lost p50 {np.median(lost):.0f}, max {lost.max():.0f} ms")
    show_faults(faults_for(arguments.seconds, folder))
    print(f"load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
