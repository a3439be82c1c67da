"""A million samples written and read: the core alone, the core through Python, and the official `mcap` package.

`python tests/runtime/trace_figures.py [--samples N] [--rounds N]` prints times and their ratios, all of one machine in
one run, in mixed order. Files of both writers are read by both readers and compared. Needs build/tests/bench_trace
(`make programs`).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from palmar import _runtime

BENCH = Path(__file__).resolve().parents[2] / "build" / "tests" / "bench_trace"
HEADER = {"schema": "palmar.trace/1", "device": "bench", "hand": "none", "side": "right"}


def make_columns(count: int) -> dict[str, np.ndarray]:
    step = np.arange(count)
    return {
        "time_s": step / 1000.0,
        "palm_position_m": np.column_stack([np.sin(0.001 * step), np.full(count, 0.1), np.full(count, 0.2)]),
        "palm_rotation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        "flexion_rad": np.sin(0.01 * step[:, None] + np.arange(15)).reshape(count, 5, 3),
        "abduction_rad": np.zeros((count, 5)),
        "tracked": np.ones(count, bool),
    }


def official_messages(source: Path) -> tuple[list[tuple[int, bytes]], str, str]:
    """The encoded messages of a file, its schema's name and its text, read by the official package."""
    with source.open("rb") as stream:
        found = [(schema, message.log_time, message.data) for schema, _, message in make_reader(stream).iter_messages()]
    return [(at, data) for _, at, data in found], found[0][0].name, found[0][0].data.decode()


def official_write(path: Path, messages: list[tuple[int, bytes]], name: str, text: str) -> None:
    """Write encoded messages as the core does: uncompressed chunks with CRCs. Encoding is not part of it."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType.NONE, enable_data_crcs=True)
        writer.start("ros2")
        writer.add_metadata("palmar.trace", HEADER)
        channel = writer.register_channel("/haptic_hand", "cdr", writer.register_schema(name, "ros2msg", text.encode()))
        for at, data in messages:
            writer.add_message(channel, at, data, at)
        writer.finish()


def official_read(path: Path, decode: bool) -> int:
    with path.open("rb") as stream:
        if not decode:
            return sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return sum(1 for _, _, _, sample in reader.iter_decoded_messages() if sample.time_s >= 0)


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args()
    columns = make_columns(chosen.samples)
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs, native = (Path(folder) / f"{name}.mcap" for name in ("ours", "theirs", "native"))
        _runtime.write_trace(str(ours), HEADER, columns)
        messages, name, text = official_messages(ours)
        official_write(theirs, messages, name, text)
        for path in (ours, theirs):
            _, back, lost = _runtime.read_trace(str(path))
            assert not any(lost.values()) and all(np.array_equal(back[key], columns[key]) for key in columns)
            assert official_read(path, decode=False) == chosen.samples
        size = f"{ours.stat().st_size / 1e6:.0f} MB"
        print(f"{chosen.samples} samples, {size}; each file reads back equal with both readers")
        calls = {
            "write, core through Python": lambda: _runtime.write_trace(str(ours), HEADER, columns),
            "write, mcap (encoded before)": lambda: official_write(theirs, messages, name, text),
            "read, core through Python": lambda: _runtime.read_trace(str(ours)),
            "read, mcap (not decoded)": lambda: official_read(ours, decode=False),
            "read, mcap and mcap-ros2-support (decoded)": lambda: official_read(ours, decode=True),
        }
        times: dict[str, list[float]] = {key: [] for key in ("write, core", "read, core", *calls)}
        order = np.random.default_rng(0)
        for _ in range(chosen.rounds):
            said = json.loads(
                subprocess.run([BENCH, native, str(chosen.samples)], check=True, capture_output=True, text=True).stdout
            )
            times["write, core"].append(said["write_s"])
            times["read, core"].append(said["read_s"])
            for key in order.permutation(list(calls)):
                times[str(key)].append(seconds(calls[str(key)]))
        best = {key: min(values) for key, values in times.items()}
        for key, value in sorted(best.items()):
            base = best["write, core" if key.startswith("write") else "read, core"]
            print(f"{key:44} {value:8.2f} s  {value / base:7.1f} x the core's")


if __name__ == "__main__":
    main()
