"""Options of the test run."""


def pytest_addoption(parser):
    parser.addoption("--all-recordings", action="store_true", help="replay all recorded demonstrations")
