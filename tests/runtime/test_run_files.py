"""Runs against the official MCAP packages."""

import re
from pathlib import Path

import numpy as np
import pytest
from documented import schema_texts
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as Ros2Writer

from palmar import _runtime
from palmar.errors import BadTrace

SOUND = {"bytes": 0, "chunks": 0, "messages": 0, "unclosed": 0}


def content_hash(path: Path) -> str:
    value = 14695981039346656037  # FNV-1a, 64 bit
    with path.open("rb") as stream:
        for _, channel, message in NonSeekingReader(stream).iter_messages(["/graphic_hand", "/contacts"]):
            assert channel.message_encoding == "cdr"
            for byte in message.data:
                value = (value ^ byte) * 1099511628211 % 2**64
    return f"{value:016x}"


def write_official_run(path: Path, count: int, end: dict[str, str] | None = None) -> dict[str, list[dict]]:
    """A run by the official writer with the document's schemas; contacts on every third step."""
    random = np.random.default_rng(1)
    texts = schema_texts()
    steps, contacts, timing = [], [], []
    sizes = {n: int(s) for s, n in re.findall(r"^float64\[(\d+)\] (\w+)", texts["palmar_msgs/msg/Step"], re.MULTILINE)}
    for i in range(count):
        n = i % 3 * 2
        steps.append(
            {"time_s": i / 1000, "status": i % 64, "contacts": n, "operations": 7 * i, "state_hash": 2**64 - 1 - i}
        )
        steps[-1] |= {name: random.normal(size=size).tolist() for name, size in sizes.items()}
        names = ("cpu_us", "wall_us", "search_us", "solve_us", "verify_us")
        timing.append({"time_s": i / 1000} | {name: random.random() for name in names})
        contacts.append(
            {
                "time_s": i / 1000,
                "link": bytes(range(n)),
                "object_sphere": random.integers(0, 2**32, n).tolist(),
                "palm_sphere": [2**32 - 1] * n,
                "gap_m": random.normal(size=n).tolist(),
                "force_n": random.normal(size=n).tolist(),
                "point_m": random.normal(size=3 * n).tolist(),
                "normal": random.normal(size=3 * n).tolist(),
            }
        )
    with path.open("wb") as stream, Ros2Writer(stream, 50_000, CompressionType.NONE) as writer:
        schemas = {name: writer.register_msgdef(name, text) for name, text in texts.items()}
        writer.add_metadata("palmar.run", {"schema": "palmar.run/1", "solver": "none"})
        for i in range(count):
            rows = {
                "Step": ("/graphic_hand", steps[i]),
                "Contacts": ("/contacts", contacts[i]),
                "Timing": ("/timing", timing[i]),
            }
            for name, (topic, row) in rows.items():
                if name != "Contacts" or row["link"]:
                    writer.write_message(topic, schemas[f"palmar_msgs/msg/{name}"], row, log_time=1_000_000 * i)
        if end is not None:
            writer.add_metadata("palmar.run.end", end)
    return {"steps": steps, "contacts": contacts, "timing": timing}


def test_reads_a_run_of_the_official_writer(tmp_path):
    path = tmp_path / "r.mcap"
    write_official_run(path, 60)
    written = write_official_run(path, 60, {"steps": "60", "content_fnv1a64": content_hash(path)})
    header, run, lost = _runtime.read_run(str(path))
    assert lost == SOUND
    assert header["steps"] == "60"
    for group in ("steps", "timing"):
        for name in written[group][0]:
            expected = np.array([row[name] for row in written[group]])
            assert np.array_equal(run[name].reshape(expected.shape), expected), name
    assert run["state_hash"].dtype == np.uint64
    assert run["contact_start"].tolist() == [0, *np.cumsum([len(c["link"]) for c in written["contacts"]]).tolist()]
    for name in ("link", "object_sphere", "palm_sphere", "gap_m", "force_n", "point_m", "normal"):
        expected = [x for row in written["contacts"] for x in row[name]]
        assert run[f"contact_{name}"].ravel().tolist() == expected, name
    assert run["fingertip_force_n"].shape == (60, 5, 3)
    assert run["contact_point_m"].shape == (120, 3)


def test_run_with_another_content_hash_is_refused(tmp_path):
    path = tmp_path / "r.mcap"
    write_official_run(path, 5, {"steps": "5", "content_fnv1a64": "0123456789abcdef"})
    with pytest.raises(BadTrace, match="E-TRACE-CRC"):
        _runtime.read_run(str(path))


def test_run_without_its_end_is_said_to_be_unclosed(tmp_path):
    path = tmp_path / "r.mcap"
    write_official_run(path, 5)
    assert _runtime.read_run(str(path))[2] == SOUND | {"unclosed": 1}
