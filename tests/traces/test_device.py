import tomllib

import numpy as np
import pytest

from palmar.errors import BadTrace, PalmarError
from palmar.records import read_trace
from palmar.traces.device import DEVICES, HANDS, import_file
from palmar.traces.scenario_csv import COLUMNS, read_scenario_csv


def write_scenario(path, rows=3):
    lines = [",".join(COLUMNS)]
    for i in range(rows):
        lines.append(",".join((dict.fromkeys(COLUMNS, "0.1") | {"t": str(i), "phase": "0"} | unit()).values()))
    path.write_text("\n".join(lines) + "\n")
    return path


def unit():
    return {"qw": "0.6", "qx": "0", "qy": "0.8", "qz": "0"}


def test_imported_trace_is_what_was_read_and_its_header_keeps_the_assumptions(tmp_path):
    log, out = write_scenario(tmp_path / "log.csv"), tmp_path / "log.mcap"
    summary = import_file(log, out)
    read, written = read_scenario_csv(log), read_trace(out)
    for name in ("time_s", "palm_position_m", "palm_rotation_wxyz", "flexion_rad", "abduction_rad"):
        np.testing.assert_array_equal(getattr(written, name), getattr(read, name))
    assert written.header["assumptions"] == read.header["assumptions"]
    assert summary["format"] == "scenario-csv" and summary["samples"] == 3
    assert summary["duration_s"] == 2.0 and summary["rate_hz"] == 1.0
    assert summary["assumptions"] and summary["changed"]["quaternions scaled to unit length"] == 3


def test_door_demonstration_goes_through_the_file(tmp_path, shared):
    out = tmp_path / "door.mcap"
    summary = import_file(shared / "traces" / "adroit_door" / "door_06.csv", out, object_frame="moving")
    assert summary["format"] == "adroit-door" and summary["rate_hz"] == 100.0
    assert len(read_trace(out).time_s) == summary["samples"] == 277
    assert read_trace(out).has_object_pose.all()


def test_hand_of_a_device_becomes_a_hand_file(tmp_path, shared):
    out = tmp_path / "adroit.toml"
    summary = import_file(shared / "traces" / "adroit_door" / "adroit_hand.json", out)
    assert summary["format"] == "adroit-hand"
    assert any("thumb_mcp_abd 0.2 rad" in sentence for sentence in summary["assumptions"])
    assert tomllib.loads(out.read_text())["name"] == "adroit"


def test_every_format_says_in_one_line_what_it_is():
    for device in DEVICES.values():
        assert device.about and "\n" not in device.about
    assert all(about and "\n" not in about for _, about in HANDS.values())


@pytest.mark.parametrize(
    ("name", "content", "options", "said"),
    [
        (
            "log.csv",
            "a,b,c\n1,2,3\n",
            {},
            "line 1: the header row is of no known format; name one of scenario-csv, adroit-door",
        ),
        ("log.xlsx", "a", {}, "log.xlsx: extension '.xlsx' is of no known format; name one of scenario-csv, "),
        (
            "log.csv",
            "a",
            {"format": "adroit_door"},
            "format 'adroit_door' (nearest: adroit-door); known are scenario-csv",
        ),
    ],
)
def test_unknown_format_is_refused_with_the_known_ones(tmp_path, name, content, options, said):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(BadTrace) as caught:
        import_file(path, tmp_path / "out.mcap", **options)
    assert caught.value.code == "E-TRACE-FORMAT" and said in str(caught.value)
    assert not (tmp_path / "out.mcap").exists()


def test_misspelt_column_of_a_known_format_is_named(tmp_path):
    path = write_scenario(tmp_path / "log.csv")
    path.write_text(path.read_text().replace("index_2", "index_pip"))
    with pytest.raises(BadTrace, match=r"E-TRACE-COLUMNS .*line 1: column index_2 is missing; unknown here: index_pip"):
        import_file(path, tmp_path / "out.mcap")


def test_option_of_another_format_is_refused(tmp_path):
    path = write_scenario(tmp_path / "log.csv")
    with pytest.raises(PalmarError, match="E-CONF lead_ms: no option of format scenario-csv; it takes none"):
        import_file(path, tmp_path / "out.mcap", lead_ms=70)
    with pytest.raises(
        PalmarError, match=r"E-CONF leadms: .*adroit-door \(nearest: lead_ms\); it takes angles, filter_hz"
    ):
        import_file(path, tmp_path / "out.mcap", format="adroit-door", leadms=70)


def test_missing_log_is_refused(tmp_path):
    with pytest.raises(BadTrace, match=r"E-TRACE-MISSING .*none.csv: No such file"):
        import_file(tmp_path / "none.csv", tmp_path / "out.mcap")
