"""Options of the test run, and what the tests of the command line share."""

import pytest

from palmar import cli


def pytest_addoption(parser):
    parser.addoption("--all-recordings", action="store_true", help="replay all recorded demonstrations")
    parser.addoption("--fuzz-examples", type=int, default=60, help="changed copies of each file that Python reads")
    parser.addoption("--host-kills", type=int, default=8, help="how often a recording host is killed; 100 measures it")


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run a command line in an empty folder; gives the exit code, stdout and the lines of stderr."""
    monkeypatch.chdir(tmp_path)

    def run_line(*arguments):
        code = cli.run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err.splitlines()

    return run_line
