"""Runs a command and returns its exit status. This is the only place that turns errors into
messages."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Sequence

from smooth_operator.cli.options import Command, parse
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.terminal import print_note

OK = 0
USER_ERROR = 2
BROKEN_PIPE = 141  # exit status that shells report for SIGPIPE


def run(argv: Sequence[str], set_up: Callable[[], object]) -> int:
    """Runs one command; see ``main`` in ``process.py``."""
    _never_fail_on_a_character()
    arguments = list(argv)
    command: Command | None = None
    try:
        try:
            if arguments[:1] in (["--version"], ["-V"]):
                from smooth_operator.version import package_version

                print(f"smooth-operator {package_version()}")
                return OK
            command = parse(arguments)
            set_up()
            command.run()
            return OK
        # The parser exits with 0 after help, None after completion and 2 after a mistake.
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else USER_ERROR if stop.code else OK
        finally:
            sys.stdout.flush()  # Flush here, where a broken pipe can still be handled.
    except BrokenPipeError:
        _drop_output()
        return BROKEN_PIPE
    except SmoothOperatorError as error:
        if _debugging(command):
            raise
        _complain(str(error))
        return USER_ERROR


def _debugging(command: Command | None) -> bool:
    enabled = os.environ.get("SMOOTH_OPERATOR_DEBUG", "").lower() not in ("", "0", "no", "off")
    return enabled or (command is not None and command.debug)


def _complain(message: str) -> None:
    with contextlib.suppress(OSError):
        print_note(f"smooth-operator: {message}")


def _never_fail_on_a_character() -> None:
    # A Windows console may not support "m²" or "→"; a question mark is better than a traceback.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _drop_output() -> None:
    # The interpreter flushes standard output once more on its way out, and would complain.
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
