"""`palmar record` and `palmar emulate` as a person runs them; `glove_figures.py` measures the same for minutes."""

import json
import resource
import signal

import glove_figures
import pytest

from palmar.errors import PalmarError
from palmar.recording import emulate
from palmar.records import read_trace


def test_every_good_line_is_kept_and_no_bad_one_among_every_fault(tmp_path):
    figures = glove_figures.faults_for(4.0, tmp_path, share=4.0)
    assert figures["good_lines_sent"] > 50  # on a busy machine; 800 on an idle one
    assert figures["good_lines_lost"] == 0 and figures["wrong_readings"] == 0
    assert figures["recorder"]["lines"]["rejected"] > 0


def test_angles_come_back_within_half_a_step_of_the_encoding(tmp_path):
    back = glove_figures.round_trip(tmp_path, "joints", seconds=1.5)
    # Rounding to the nearest count is half a step; the rest is rounding of doubles.
    assert back["samples"] > 10 and back["flexion_steps"] <= 0.5 + 1e-6 and back["abduction_steps"] <= 0.5 + 1e-6


def test_a_killed_recorder_leaves_what_had_come(tmp_path):
    assert glove_figures.kills(1, tmp_path)["unreadable"] == 0


def test_ctrl_c_ends_a_recording_cleanly(tmp_path):
    glove_figures.moving_trace(tmp_path / "source.mcap", 2.0)
    glove = glove_figures.Glove(tmp_path / "source.mcap", "--loop")
    out = tmp_path / "out.mcap"
    process = glove_figures.start("record", "--device", "opengloves", "--port", glove.port, "-o", str(out))
    while not glove_figures.has_samples(out):
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    told, complaints = process.communicate()
    glove.stop()
    assert process.returncode == 0 and "samples" in told and complaints == ""
    trace = read_trace(out)
    assert not any(trace.lost.values()) and json.loads(trace.header["recorded"])["samples"] == trace.tracked.sum()


def test_a_full_disk_costs_the_end_alone_and_exit_code_3(tmp_path):
    glove_figures.moving_trace(tmp_path / "source.mcap", 2.0)
    glove = glove_figures.Glove(tmp_path / "source.mcap", "--loop")
    out = tmp_path / "out.mcap"
    process = glove_figures.start(
        *("record", "--device", "opengloves", "--port", glove.port, "-o", str(out), "--json"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)),
    )
    told, complaint = process.communicate()
    glove.stop()
    assert process.returncode == 3 and complaint.startswith("E-TRACE-WRITE") and complaint.count("\n") == 1
    assert json.loads(told)["samples in the file"] == len(read_trace(out).time_s) > 0


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ({"faults": {"garbge": 1}}, r"E-CONF --fault garbge: no such fault \(nearest: garbage\)"),
        ({"form": "curl"}, "E-CONF --form: 'curl'; curls, joints or legacy is allowed"),
        ({"listen": "x"}, "E-CONF --listen: 'x'; HOST:PORT is needed"),
    ],
)
def test_emulate_refuses_wrong_flags_(tmp_path, flags, said):
    glove_figures.moving_trace(tmp_path / "source.mcap", 1.0)
    with pytest.raises(PalmarError, match=said):
        emulate(tmp_path / "source.mcap", **flags)
