"""What a kill, a full disk or an unplugged glove leaves behind: python tests/interrupted.py [--moments 100] [VERB...]

Each of build, replay, report and record is ended at random moments, or at a random byte of what it writes, in a folder
that keeps what was left behind. Under the final name there must be a whole result or none (of a recording: whole
samples up to there, which `recover` makes a sound trace); the next attempt must succeed. Exit code 1 if it is not so.
"""

import argparse
import os
import random
import resource
import select
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from test_bad_input import make_good

from palmar import cli
from palmar.errors import BadTrace
from palmar.files import sha256_of
from palmar.records import read_run, read_trace
from palmar.recover import recover_file
from palmar.traces.wire import Pty

LINE = b"A1000B1000C1000D1000E1000F2048G2048P0\n"
RECORD_S = 2.0  # on a busy machine a child may not run for half a second
PATIENCE_S = 120.0


@dataclass
class Verb:
    """A command line with one result, and whether what lies under its name is whole."""

    arguments: list[str]
    out: str
    is_whole: Callable[[Path], bool]
    restart_every: int = 1  # a whole run after so many interrupted ones


def report_is_whole(folder: Path) -> bool:
    names = {path.name for path in folder.iterdir()}
    return {"index.html", "metrics.json"} <= names and (folder / "index.html").read_text().rstrip().endswith("</html>")


def recording_is_whole(path: Path) -> bool:
    """A recording that was cut off holds whole samples, of which `recover` makes a sound trace."""
    try:
        found = len(read_trace(path).time_s)
    except BadTrace:
        return False
    again = path.with_name("again.mcap")
    recover_file(path, again)
    sound = read_trace(again)
    again.unlink()
    return len(sound.time_s) == found and not any(sound.lost.values())


def verbs(folder: Path) -> dict[str, Verb]:
    pack = sha256_of(folder / "other.pack")  # of the spheres that cube.csv now holds
    run = read_run(folder / "good.run.mcap").header["content_fnv1a64"]
    record = ["record", "--device", "opengloves", "--port", "glove", "-o", "out.mcap", "--duration-s", str(RECORD_S)]
    return {
        "build": Verb(
            ["build", "shape:cube", "--spheres-csv", "cube.csv", "-o", "out.pack"],
            "out.pack",
            lambda path: sha256_of(path) == pack,
        ),
        "replay": Verb(
            ["replay", "good.pack", "good.mcap", "-o", "out.run.mcap"],
            "out.run.mcap",
            lambda path: read_run(path).header["content_fnv1a64"] == run,
        ),
        "report": Verb(["report", "good.run.mcap", "-o", "out"], "out", report_is_whole, restart_every=10),
        "record": Verb(record, "out.mcap", recording_is_whole),
    }


class Attempt:
    """One run of a verb in a child of this process, which has everything imported."""

    def __init__(self, verb: Verb, folder: Path, limit_bytes: int | None = None) -> None:
        self.glove = Pty(folder / "glove") if verb.arguments[0] == "record" else None
        self._err, err = os.pipe()
        self.start_s = time.monotonic()
        self._pid = os.fork()
        if self._pid == 0:
            try:
                os.setsid()
                os.chdir(folder)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                os.dup2(err, 2)
                if limit_bytes is not None:
                    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
                os._exit(cli.run(list(verb.arguments)))
            finally:
                os._exit(99)
        os.close(err)
        self.said = b""

    def wait(self, until_s: float = PATIENCE_S) -> int | None:
        """Play the glove until the child ends (gives its exit code, 128 + signal) or so long after its start (None)."""
        while True:
            found, status = os.waitpid(self._pid, os.WNOHANG)
            while select.select([self._err], [], [], 0)[0] and (more := os.read(self._err, 4096)):
                self.said += more
            if found:
                os.close(self._err)
                self.unplug()
                return os.waitstatus_to_exitcode(status) % 256
            left_s = self.start_s + until_s - time.monotonic()
            if left_s <= 0:
                return None
            if self.glove is not None and self.glove.heard():
                self.glove.send(LINE)
            time.sleep(min(0.005, left_s))

    def kill(self) -> int | None:
        os.killpg(self._pid, signal.SIGKILL) if os.getpgid(self._pid) == self._pid else os.kill(
            self._pid, signal.SIGKILL
        )
        return self.wait()

    def unplug(self) -> None:
        if self.glove is not None:
            self.glove.close()
            self.glove = None


def remove(path: Path) -> None:
    for below in path.iterdir() if path.is_dir() else []:
        remove(below)
    path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)


def largest_file(path: Path) -> int:
    return max(p.stat().st_size for p in ([path] if path.is_file() else path.rglob("*")) if p.is_file())


def interrupt(
    name: str, verb: Verb, how: str, moments: int, folder: Path, rng: random.Random
) -> tuple[Counter, list[str]]:
    """What came of each moment, and what must not be."""
    out = folder / verb.out
    remove(out) if out.exists() else None
    whole = Attempt(verb, folder)
    if whole.wait() != 0:
        return Counter(), [f"{name} alone fails: {whole.said.decode()}"]
    took_s, size = time.monotonic() - whole.start_s, largest_file(out)
    remove(out)
    counts, bad = Counter(), []
    for number in range(moments):
        where = f"{name} {how} {number}"
        before = {path.name for path in folder.iterdir()}
        if how == "full disk":
            # A recording is never twice as long.
            attempt = Attempt(verb, folder, limit_bytes=rng.randrange(size if name != "record" else size // 2))
            code = attempt.wait()
            said = attempt.said.decode()
            if code not in (2, 3) or not said.startswith("E-") or said.count("\n") != 1:
                bad.append(f"{where}: exit code {code}: {said}")
            if name != "record" and {path.name for path in folder.iterdir()} != before:
                bad.append(f"{where}: left { {path.name for path in folder.iterdir()} - before }")
        else:
            attempt = Attempt(verb, folder)
            code = attempt.wait(rng.uniform(0, took_s))
            if code is None and how == "kill":
                code = attempt.kill()
            elif code is None:
                attempt.unplug()
                code = attempt.wait()
                if code not in (0, 2):
                    bad.append(f"{where}: exit code {code}: {attempt.said.decode()}")
        there = out.exists()
        counts["whole" if there else "none"] += 1
        if there and not verb.is_whole(out):
            bad.append(f"{where}: {verb.out} is there and not whole")
        if there:
            remove(out)
        if number % verb.restart_every == 0:
            again = Attempt(verb, folder)
            if again.wait() != 0 or not verb.is_whole(out):
                bad.append(f"{where}: the next attempt fails: {again.said.decode()}")
            else:
                remove(out)
    return counts, bad


HOWS = {"build": ("kill", "full disk"), "replay": ("kill", "full disk"), "report": ("kill", "full disk")}
HOWS["record"] = ("kill", "full disk", "unplug")


def measure(names: list[str], moments: int, seed: int) -> list[str]:
    """Print a row for each verb and way; give what must not be."""
    import palmar.eval.report
    import palmar.recording
    import palmar.replay
    import palmar.tools.pack  # noqa: F401

    rng, wrong = random.Random(seed), []
    print("| verb | ended by | moments | whole result | none | wrong |\n| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as scratch:
        make_good(Path(scratch))
        known = verbs(Path(scratch))
        replay = ["replay", "good.pack", "good.mcap", "-o", "good.run.mcap"]  # one that names its pack
        assert Attempt(Verb(replay, "good.run.mcap", Path.is_file), Path(scratch)).wait() == 0
        for name in names:
            verb = known[name]
            for how in HOWS[name]:
                counts, bad = interrupt(name, verb, how, moments, Path(scratch), rng)
                wrong += bad
                print(f"| {name} | {how} | {moments} | {counts['whole']} | {counts['none']} | {len(bad)} |", flush=True)
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verbs", nargs="*", help=f"of {', '.join(HOWS)}; all if none")
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    wrong = measure(options.verbs or list(HOWS), options.moments, options.seed)
    print(*wrong, sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
