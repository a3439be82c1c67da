"""The encoding: a file of raw bytes with what it means, and what must hold for any bytes."""

import math
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmar.traces.line_buffer import LineBuffer
from palmar.traces.line_faults import FAULTS, Faults, parse_faults
from palmar.traces.opengloves import (
    LONGEST_LINE,
    NEW_KEYS_AFTER,
    Decoder,
    Reading,
    Rejected,
    decode_force,
    encode_force,
    encode_reading,
)

DATA = Path(__file__).parents[1] / "data"
LINE = b"A100B200C300D400E500F2048G2048P0"


def read_all(chunks: list[bytes], decoder: Decoder) -> tuple[list[Reading], list[str]]:
    """The readings in chunks of bytes, and why other lines were rejected."""
    lines, readings, rejected = LineBuffer(LONGEST_LINE), [], []
    for chunk in chunks:
        for line in lines.feed(chunk):
            try:
                reading = decoder.decode(line) if line else None
            except Rejected as why:
                rejected.append(str(why))
            else:
                readings += [reading] if reading is not None else []
    return readings, rejected + ["overlong"] * lines.overlong


def as_lines(readings: list[Reading]) -> list[bytes]:
    return [encode_reading(reading).strip() for reading in readings]


def rejected_as(decoder: Decoder, line: bytes) -> str:
    with pytest.raises(Rejected) as caught:
        decoder.decode(line)
    return str(caught.value)


@settings(max_examples=50)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=200))
def test_a_file_of_raw_bytes_is_the_samples_beside_it_however_it_is_cut(sizes):
    raw = (DATA / "opengloves.bin").read_bytes()
    chunks, at = [], 0
    for size in [*sizes, len(raw)]:
        chunks.append(raw[at : at + size])
        at += size
    decoder = Decoder()
    readings, rejected = read_all(chunks, decoder)
    expected = np.loadtxt(DATA / "opengloves.csv", delimiter=",", skiprows=1)
    assert len(readings) == len(expected)
    # A count is an integer over the full scale: exact up to the rounding of one division.
    curls = np.array([reading.flexion[::3] for reading in readings])
    np.testing.assert_allclose(curls * 4095, expected[:, :5], atol=1e-9)
    np.testing.assert_allclose([reading.trigger * 4095 for reading in readings], expected[:, 5], atol=1e-9)
    assert [reading.buttons for reading in readings] == expected[:, 6].tolist()
    assert all(math.isnan(x) for reading in readings for x in reading.flexion[1::3] + reading.abduction)
    # Two lines of the banner are no reading either; its third is empty.
    assert sorted(rejected) == sorted(["garbage"] * 4 + ["other keys", "out of range", "overlong"])
    assert decoder.hand == 1 and decoder.glued == 2


def test_every_value_comes_back_within_half_a_count():
    generator = random.Random(1)
    for form, full_scale in (("joints", 4095), ("joints", 1023), ("curls", 4095), ("legacy", 1023)):
        decoder = Decoder(full_scale)
        for _ in range(200):
            said = Reading(
                [generator.random() for _ in range(15)],
                [generator.uniform(-1, 1) for _ in range(5)],
                (generator.uniform(-1, 1), generator.uniform(-1, 1)),
                generator.random(),
                generator.randrange(64) if form == "legacy" else generator.randrange(256),
            )
            heard = decoder.decode(encode_reading(said, full_scale, form).strip())
            assert heard is not None
            half = 0.5 / full_scale + 1e-12
            joints = slice(None) if form == "joints" else slice(0, None, 3)
            np.testing.assert_allclose(heard.flexion[joints], said.flexion[joints], atol=half)
            np.testing.assert_allclose(heard.joystick, said.joystick, atol=2 * half)
            if form == "joints":
                np.testing.assert_allclose(heard.abduction, said.abduction, atol=2 * half)
            if form != "legacy":
                assert abs(heard.trigger - said.trigger) <= half
            assert heard.buttons == said.buttons


def test_joints_override_the_curl_and_the_metacarpal_is_left_out():
    decoder = Decoder(1000)
    heard = decoder.decode(b"A100B200C300D400E500(BAA)900(BAB)10(BAC)20(BAD)30(AAD)700(BB)500")
    assert heard is not None
    assert heard.flexion[:6] == pytest.approx([0.1, math.nan, math.nan, 0.01, 0.02, 0.03], nan_ok=True)
    assert heard.abduction[1] == 0.0 and math.isnan(heard.abduction[0])


@pytest.mark.parametrize("name", ["corrupt", "cut", "missing", "range"])
def test_a_broken_line_never_becomes_a_reading_and_the_next_good_one_does(name):
    for seed in range(600):
        faults = Faults({name: (1.0, 0.0)}, 4095, seed)
        decoder = Decoder()
        decoder.decode(LINE)
        pieces = faults.pieces(LINE + b"\n")
        assert [piece.kind for piece in pieces] == [name]
        readings, _ = read_all([pieces[0].content, LINE + b"\n"], decoder)
        assert as_lines(readings) == [LINE], (seed, pieces)


def test_every_good_line_of_a_stream_with_every_fault_is_kept_and_nothing_else():
    # Without "missing": a line without its first value, glued to a line of which that alone was left, is a good one.
    shares = {name: (0.1, 900.0 if name == "overlong" else 0.0) for name in FAULTS if name != "missing"}
    faults = Faults(shares, 4095, seed=3)
    chunks, good = [LINE + b"\n"], [LINE]
    for number in range(4000):
        line = f"A{number}B200C300D400E500F2048G2048P0\n".encode()
        pieces = faults.pieces(line)
        chunks += [piece.content for piece in pieces]
        good += [line.strip() for piece in pieces if piece.kind == "good"]
    readings, rejected = read_all(chunks, Decoder())
    assert as_lines(readings) == good
    assert rejected


def test_an_info_packet_that_was_glued_before_a_line_with_a_repeat_is_no_reason_to_stop():
    decoder = Decoder()
    reading = decoder.decode(b"Z(ZH)1A1" + LINE)
    assert reading is not None and as_lines([reading]) == [LINE]
    assert decoder.hand is None and decoder.glued == 1


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_any_bytes_are_a_reading_or_rejected(content):
    decoder = Decoder()
    read_all([content + b"\n", LINE + b"\n"], decoder)
    assert decoder.keys


def test_a_glove_that_sends_other_keys_from_now_on_is_believed_after_a_while():
    decoder, other = Decoder(), LINE.replace(b"P0", b"")
    decoder.decode(LINE)
    for _ in range(NEW_KEYS_AFTER - 1):
        assert rejected_as(decoder, other) == "other keys"
    assert decoder.decode(other) is not None
    assert rejected_as(decoder, LINE) == "other keys"


def test_an_info_packet_is_no_reading_also_behind_a_broken_line():
    decoder = Decoder()
    decoder.decode(LINE)
    for content in (b"Z(ZV)5(ZG)1(ZH)0", b"A100B20Z(ZH)1", b"\xffZ(ZH)0"):
        assert decoder.decode(content) is None
        assert decoder.hand == int(content[-1:])
    assert as_lines([decoder.decode(b"noiseZ" + LINE)]) == [LINE]


def test_what_is_wrong_with_a_line_is_named():
    decoder = Decoder()
    assert rejected_as(decoder, b"A100B200C300") == "cut"
    assert rejected_as(decoder, LINE.replace(b"A100", b"A")) == "cut"
    assert rejected_as(decoder, LINE.replace(b"P0", b"P4096")) == "out of range"
    assert rejected_as(decoder, LINE.replace(b"P0", b"Q0")) == "garbage"
    assert rejected_as(decoder, b"1&2&3") == "cut"
    assert rejected_as(decoder, b"1&2&3&4&5&6&7&0&0&0&0&0&0&0") == "garbage"


def test_forces_are_five_levels_and_a_bare_line_end_is_no_command():
    assert encode_force([0, 1, 500, 999, 1000]) == b"A0B1C500D999E1000\n"
    assert decode_force(b"A0B1C500D999E1000") == [0, 1, 500, 999, 1000]
    assert decode_force(b"") is None


def test_faults_are_named_and_checked():
    assert parse_faults({"garbage": 0.5, "silence": "0.1:2"}) == {"garbage": (0.5, 0.0), "silence": (0.1, 2.0)}
    assert parse_faults({"all": 1}).keys() == FAULTS.keys()
    for pairs, said in (
        ({"garbge": 0.1}, r"--fault garbge: no such fault \(nearest: garbage\)"),
        ({"garbage": 2}, "a share of the lines from 0 to 1"),
        ({"garbage": "0.1:3"}, "a share of the lines from 0 to 1 is needed$"),
        ({"silence": "x"}, "and :seconds behind it"),
    ):
        with pytest.raises(Exception, match=said):
            parse_faults(pairs)
