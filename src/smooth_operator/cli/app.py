"""Runs a command: arguments to exit status; the only place where errors become messages."""

from __future__ import annotations

import _thread
import atexit
import contextlib
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence

from smooth_operator.cli.options import Command, parse
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.terminal import print_note

OK = 0
USER_ERROR = 2
INTERRUPTED = 130  # what shells report for SIGINT
BROKEN_PIPE = 141  # and for SIGPIPE
_COMPILES = "compile"  # name of the thread of ``smooth_operator.compilation.early_answers``


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: the arguments; None for those of the process.

    Returns:
        The exit status: 0 done, 1 done but for some recordings or cells (a folder, a benchmark),
        2 the user can mend it (the reason is on standard error), 130 stopped by Ctrl-C, 141 nobody
        reads standard output any more.

    Raises:
        SmoothOperatorError: what would have been a message, with ``--debug`` or
            ``SMOOTH_OPERATOR_DEBUG=1``; its traceback then shows where it came from.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    _never_fail_on_a_character()
    with _no_interrupt_lost():
        return _run(arguments)


def program() -> int:
    """The process of a command: ``main``, and an end that no thread can spoil.

    A daemon thread that is still within compiled code (a driver that does not answer, a library)
    asks for the interpreter while that ends, and is unwound through frames that do not expect it:
    the process aborts, though its work is done. So where one is left, nothing is torn down. What
    compiles a method while a run answers early is not waited for, either.
    """
    status = main()
    left = [thread for thread in threading.enumerate() if thread is not threading.current_thread()]
    if not any(thread.daemon or thread.name == _COMPILES for thread in left):
        return status
    for thread in left:
        if not thread.daemon and thread.name != _COMPILES:
            thread.join()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
            stream.flush()
    os._exit(status)


def _run(arguments: list[str]) -> int:
    command: Command | None = None
    try:
        try:
            if arguments[:1] in (["--version"], ["-V"]):
                from smooth_operator.version import package_version

                print(f"smooth-operator {package_version()}")
                return OK
            command = parse(arguments)
            command.run()
            return OK
        except SystemExit as stop:  # of the parser: help is 0, completion None, a mistake 2
            return stop.code if isinstance(stop.code, int) else USER_ERROR if stop.code else OK
        finally:
            sys.stdout.flush()  # here, where a broken pipe can still be answered
    except BrokenPipeError:
        _drop_output()
        return BROKEN_PIPE
    except KeyboardInterrupt:
        _complain("stopped")
        return INTERRUPTED
    except SmoothOperatorError as error:
        if _debugging(command):
            raise
        _complain(str(error))
        return USER_ERROR


@contextlib.contextmanager
def _no_interrupt_lost() -> Iterator[None]:
    """Have Ctrl-C come again where it was swallowed.

    JAX has the garbage collector call it back, and Python drops whatever is raised in there: a
    Ctrl-C at such a moment would go unheard.
    """
    before, busy = sys.unraisablehook, threading.Lock()

    def later() -> None:
        with busy:  # not in the hook, where it would be dropped as well
            pass
        time.sleep(0.02)
        _interrupt()

    def again(what: sys.UnraisableHookArgs) -> None:
        if what.exc_type is KeyboardInterrupt:
            with busy:
                _thread.start_new_thread(later, ())
        else:
            before(what)

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = before


def _interrupt() -> None:
    if hasattr(signal, "pthread_kill"):  # a real signal ends a sleep, too
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


def _debugging(command: Command | None) -> bool:
    asked = os.environ.get("SMOOTH_OPERATOR_DEBUG", "").lower() not in ("", "0", "no", "off")
    return asked or (command is not None and command.debug)


def _complain(message: str) -> None:
    with contextlib.suppress(OSError):
        print_note(f"smooth-operator: {message}")


def _never_fail_on_a_character() -> None:
    # A console of Windows may know neither "m²" nor "→"; a question mark beats a traceback.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _drop_output() -> None:
    # The interpreter flushes standard output once more on its way out, and would complain.
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
