"""The process of a command: signal handling from the start, and a clean exit."""

from __future__ import annotations

import _thread
import atexit
import contextlib
import os
import signal
import sys
import threading
import time
import warnings

from smooth_operator.signals import ended_by_signals

TYPE_CHECKING = False  # used like typing's; Ctrl-C while importing typing would print a traceback
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from typing import Any

INTERRUPTED = 130  # exit status that shells report for SIGINT
_COMPILES = "compile"  # name of the thread in which ``smooth_operator.teleop.run`` compiles


def main(argv: Sequence[str] | None = None, set_up: Callable[[], object] = lambda: None) -> int:
    """Runs one command.

    Args:
        argv: the arguments; None for those of the process.
        set_up: called once the arguments are known to be valid, before the command works.

    Returns:
        The exit status: 0 done, 1 some recordings or cells failed (of a folder or a benchmark), 2
        an error that the user can fix (the reason is on standard error), 130 stopped by Ctrl-C or
        another termination signal, 141 standard output was closed.

    Raises:
        SmoothOperatorError: with ``--debug`` or ``SMOOTH_OPERATOR_DEBUG=1``, so that the traceback
            is shown instead of a message.
    """
    with ended_by_signals(), _no_interrupt_lost():
        try:
            # imported here, because this import takes a while
            from smooth_operator.cli.app import run

            return run(sys.argv[1:] if argv is None else argv, set_up)
        except KeyboardInterrupt as stop:  # with advice, if the command has any
            words = "; ".join(("smooth-operator: stopped", *map(str, stop.args)))
            with contextlib.suppress(OSError):
                print(words, file=sys.stderr, flush=True)
            return INTERRUPTED


def program() -> int:
    """Runs ``main`` and ends the process, even if threads are still running.

    A daemon thread may still be in compiled code (a driver that does not answer, or a library). If
    it asks for the interpreter while the interpreter shuts down, its stack is unwound through
    frames that do not expect this, and the process aborts although its work is done. Therefore, if
    such a thread is left, the process ends right after its exit functions. It also does so after a
    signal: Python would end the process by SIGINT if the signal came in an ``exec``. The process
    does not wait for a thread that compiles for a run that has ended.
    """
    global _status
    status = main(set_up=_set_up)
    left = [thread for thread in threading.enumerate() if thread is not threading.current_thread()]
    if status == INTERRUPTED or any(thread.daemon for thread in left):
        _status = status
    if any(thread.name == _COMPILES for thread in left):
        _status = status
        for thread in left:
            if not thread.daemon and thread.name != _COMPILES:
                thread.join()
        _end()
    return status


_status: int | None = None
"""Exit status of a process that ends without the usual shutdown of Python."""


def _end() -> None:
    if _status is not None:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):  # nobody reads the output any more
                stream.flush()
        os._exit(_status)


atexit.register(_end)  # before any other, and so called last


def _set_up() -> None:
    """Makes settings that a command may change but a library may not: silences other libraries."""
    import rich

    rich.get_console().quiet = True  # viser's; what commands print is on consoles of their own
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # Of a maker's model: masses and textures, which kinematics does not need.
    for text in ("compiler attribute .* is deprecated", "obj_decoder: .* texture coordinate"):
        warnings.filterwarnings("ignore", text, UserWarning)
    _keep_machine_code()


def _keep_machine_code() -> None:
    """Makes JAX keep machine code in the user's folder, unless the user has chosen another folder.

    JAX reads these variables when it is imported, and workers inherit them.
    """
    from smooth_operator.retargeting.start import jax_folder

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ and (folder := jax_folder()) is not None:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
        _forget_damaged(folder)


def _forget_damaged(folder: Path) -> None:
    """Empties a folder of machine code when JAX warns of a damaged entry; otherwise it would always
    warn.
    """
    shown = warnings.showwarning

    def show(message: Warning | str, *rest: Any, **more: Any) -> None:
        if str(message).startswith("Error reading persistent compilation cache"):
            with contextlib.suppress(OSError):
                for entry in folder.glob("*-cache"):
                    entry.unlink()
        else:
            shown(message, *rest, **more)

    warnings.showwarning = show


@contextlib.contextmanager
def _no_interrupt_lost() -> Iterator[None]:
    """Repeats a Ctrl-C that a callback of the garbage collector has swallowed.

    JAX registers a callback of the garbage collector, and Python drops every exception that is
    raised in it. A Ctrl-C at such a moment would be lost.
    """
    before, busy = sys.unraisablehook, threading.Lock()

    def later() -> None:
        with busy:  # not inside the hook, where it would be dropped as well
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
    if hasattr(signal, "pthread_kill"):  # a real signal also ends a sleep
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
