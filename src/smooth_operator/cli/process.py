"""The process of a command: signals from its first line on, and an end that nothing spoils."""

from __future__ import annotations

import _thread
import atexit
import contextlib
import os
import signal
import sys
import threading
import time

from smooth_operator.signals import ended_by_signals

TYPE_CHECKING = False  # as typing's, whose import Ctrl-C would interrupt with a traceback
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

INTERRUPTED = 130  # what shells report for SIGINT
_COMPILES = "compile"  # name of the thread of ``smooth_operator.teleop.run`` that compiles


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: the arguments; None for those of the process.

    Returns:
        The exit status: 0 done, 1 done but for some recordings or cells (a folder, a benchmark),
        2 the user can mend it (the reason is on standard error), 130 stopped by Ctrl-C or another
        ending signal, 141 after standard output was closed.

    Raises:
        SmoothOperatorError: what would have been a message, with ``--debug`` or
            ``SMOOTH_OPERATOR_DEBUG=1``; its traceback then shows where it came from.
    """
    with ended_by_signals(), _no_interrupt_lost():
        try:
            from smooth_operator.cli.app import run  # here: what it imports takes a while

            return run(sys.argv[1:] if argv is None else argv)
        except KeyboardInterrupt as stop:  # with advice, where a command has some
            words = "; ".join(("smooth-operator: stopped", *map(str, stop.args)))
            with contextlib.suppress(OSError):
                print(words, file=sys.stderr, flush=True)
            return INTERRUPTED


def program() -> int:
    """The process of a command: ``main``, and an end that no thread can spoil.

    A daemon thread that is still within compiled code (a driver that does not answer, a library)
    asks for the interpreter while that ends, and is unwound through frames that do not expect it:
    the process aborts, though its work is done. So where one is left, nothing is torn down. One
    that compiles for a run that has ended is not waited for, either. Neither is anything
    torn down after a signal: Python would end the process by SIGINT if that came in an ``exec``.
    """
    status = main()
    left = [thread for thread in threading.enumerate() if thread is not threading.current_thread()]
    daemons = any(thread.daemon or thread.name == _COMPILES for thread in left)
    if not daemons and status != INTERRUPTED:
        return status
    for thread in left:
        if not thread.daemon and thread.name != _COMPILES:
            thread.join()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader is gone
            stream.flush()
    os._exit(status)


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
