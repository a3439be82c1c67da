"""Options of the test run."""


def pytest_addoption(parser):
    parser.addoption("--all-recordings", action="store_true", help="replay all recorded demonstrations")
    parser.addoption("--host-kills", type=int, default=8, help="how often a recording host is killed; 100 measures it")
