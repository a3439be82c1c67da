"""The command line: runs a verb and turns whatever went wrong into one line and an exit code.

Exit codes: 0 fine; 1 a limit of a scene does not hold; 2 bad input, with one line on stderr; 3 recovered with loss;
70 a bug of Palmar; 130 Ctrl-C; 143 SIGTERM. Verbs import their stage only when they run.
"""

import os
import signal
import sys
from typing import Annotated

import typer

from palmar.cli_app import app, complain, usage_line
from palmar.errors import PalmarError

# isort: off
# Each of these adds its verbs to the application; in this order they stand in the help.
from palmar import cli_make, cli_calibrate, cli_record, cli_trace, cli_judge, cli_check, cli_chart, cli_tune  # noqa: F401
# isort: on

BUG = 70
STOPPED = 130


def main() -> None:
    """Run a command line and exit with its code. SIGTERM ends it as Ctrl-C does: what it began is tidied up."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run a command line and return its exit code."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        code = app(arguments, prog_name="palmar", standalone_mode=False)
        sys.stdout.flush()
        return code or 0
    except PalmarError as error:
        return complain(str(error), error.exit_code)
    except typer.TyperException as error:
        return complain(usage_line(error), 2)
    except BrokenPipeError:
        # The reader of our output (a pager, head) has had enough; nothing more may go there, not even at Python's end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return complain(f"E-FILE {error.filename or 'file'}: {error.strerror or error}", 2)
    except MemoryError:
        return complain("E-MEMORY palmar: the system gives no more memory", 2)
    except KeyboardInterrupt:
        return STOPPED
    except BaseException as error:  # the outermost door: what arrives here is our own mistake
        if debug or isinstance(error, SystemExit):
            raise
        what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return complain(
            f"E-BUG palmar: {what}; this is a bug of Palmar, not of your files: run again with --debug and report it",
            BUG,
        )


def print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"palmar {version('palmar')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print it.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback if Palmar itself fails; may stand anywhere.")
    ] = False,
) -> None:
    pass
