import numpy as np
import pytest

from palmar.errors import BadTrace
from palmar.traces.columns import read_log, unit_quaternions

COLUMNS = ["t", "qw", "qx", "qy", "qz"]
GOOD = "t,qw,qx,qy,qz\n0,1,0,0,0\n0.01,0.6,0.8,0,0\n"


@pytest.fixture
def refusal(tmp_path):
    """Read a log that must not be read; its error."""

    def read(content: str | bytes) -> BadTrace:
        path = tmp_path / "log.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(BadTrace) as caught:
            unit_quaternions(read_log(path, COLUMNS, "t"), COLUMNS[1:])
        assert "\n" not in str(caught.value)
        return caught.value

    return read


def test_columns_come_by_name_whatever_their_order(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("qz,qy,qx,qw,t\n0,0,0.8,0.6,0.5\n")
    log = read_log(path, COLUMNS, "t")
    assert log.columns["t"] == [0.5]
    np.testing.assert_array_equal(unit_quaternions(log, COLUMNS[1:]), [[0.6, 0.8, 0, 0]])


def test_fields_may_be_empty_and_columns_left_out_only_where_it_is_said(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x,more\n0,,1\n1,2,3\n")
    log = read_log(path, ["t", "x"], "t", optional=("more", "other"), may_be_empty=("x",))
    np.testing.assert_array_equal(log.columns["x"], [np.nan, 2.0])
    np.testing.assert_array_equal(log.columns["more"], [1.0, 3.0])
    with pytest.raises(BadTrace, match="column x"):
        read_log(path, ["t", "x"], "t", optional=("more",))
    with pytest.raises(BadTrace, match="unknown column 'more'"):
        read_log(path, ["t", "x"], "t", may_be_empty=("x",))
    path.write_text("t,x\n,1\n")
    with pytest.raises(BadTrace, match="column t"):
        read_log(path, ["t", "x"], "t", may_be_empty=("x",))


@pytest.mark.parametrize(
    ("content", "code", "place", "said"),
    [
        ("", "E-TRACE-EMPTY", "log.csv", "empty file"),
        ("t,qw,qx,qy,qz\n", "E-TRACE-EMPTY", "log.csv", "only a header"),
        (b"\xff\xfe\x00", "E-TRACE-FORMAT", "log.csv", "not text"),
        (GOOD.replace("qy", "qq"), "E-TRACE-COLUMNS", "line 1", "column qy is missing; unknown here: qq"),
        (GOOD.replace("t,", "t,qx2,", 1), "E-TRACE-COLUMNS", "line 1", "unknown column 'qx2' (nearest: qx)"),
        (GOOD.replace("qz", "qy"), "E-TRACE-COLUMNS", "line 1", "'qy' stands there twice"),
        (GOOD + "0.02,1,0,0\n", "E-TRACE-COLUMNS", "line 4", "4 fields; the header names 5"),
        (GOOD + "0.02,1,0,nan,0\n", "E-TRACE-VALUE", "line 4, column qy", "'nan'"),
        (GOOD + "0.02,1,0,1e999,0\n", "E-TRACE-VALUE", "line 4, column qy", "'1e999'"),
        (GOOD + "0.02,1,zero,0,0\n", "E-TRACE-VALUE", "line 4, column qx", "'zero'"),
        (GOOD + "0.02,1,1,0,0\n", "E-TRACE-VALUE", "line 4", "length 1.41421"),
        (GOOD + "0.01,1,0,0,0\n", "E-TRACE-TIME", "line 4", "t 0.01 after 0.01"),
        (GOOD + "0.005,1,0,0,0\n", "E-TRACE-TIME", "line 4", "t 0.005 after 0.01"),
    ],
)
def test_fault_is_refused_at_its_place(refusal, content, code, place, said):
    error = refusal(content)
    assert error.code == code
    assert error.where.endswith(place)
    assert said in error.message


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(BadTrace, match="E-TRACE-MISSING"):
        read_log(tmp_path / "none.csv", COLUMNS, "t")


def test_every_cut_of_a_log_is_refused_or_loses_whole_rows_only(tmp_path):
    path = tmp_path / "log.csv"
    rows = {len(GOOD.splitlines()[1]) + 15: 1, len(GOOD): 2}
    for length in range(len(GOOD) + 1):
        path.write_text(GOOD[:length])
        try:
            log = read_log(path, COLUMNS, "t")
        except BadTrace:
            continue
        assert GOOD[:length].endswith("\n") and len(log.columns["t"]) == rows[length]
