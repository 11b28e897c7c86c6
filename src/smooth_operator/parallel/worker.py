"""A worker process: imports the function, runs tasks, exits on request or without a parent."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from types import FrameType
from typing import Any, Final

from smooth_operator.parallel.results import describe, timed
from smooth_operator.parallel.threads import one_thread
from smooth_operator.signals import leave_to_parent

READY: Final = "ready"
"""First message of a worker: the function is there."""

BROKEN: Final = "broken"
"""First message of a worker that can't import the function, with the reason."""


_AGAIN_S: Final = 1.0


class _Stopped(BaseException):
    """The parent wants this worker to end; not an Exception, so that no function swallows it."""


def serve(link: Connection[Any, Any], slot: int) -> None:
    """Answers tasks until the parent closes the link.

    Messages in: the function, then tasks. Messages out: (``READY``, None) or (``BROKEN``,
    reason), then (value, error, seconds) per task. Running code ends with its clean-up on SIGTERM.

    Args:
        link: to the parent.
        slot: number of this worker in its pool.
    """
    leave_to_parent()
    signal.signal(signal.SIGTERM, _stop)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _stop)
    sys.unraisablehook = _unraisable
    threading.Thread(target=_die_with_parent, daemon=True).start()
    try:
        with one_thread(slot) as start_threads:
            try:
                function = link.recv()
                start_threads()
            except EOFError:
                return
            except Exception as error:
                link.send((BROKEN, describe(error)))
                return
        link.send((READY, None))
        while True:
            _answer(link, function)
    except (EOFError, OSError, _Stopped):  # the parent is done, or gone
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)


def _answer(link: Connection[Any, Any], function: Callable[[object], object]) -> None:
    raw = link.recv_bytes()
    answer = timed(lambda _: function(ForkingPickler.loads(raw)), None)
    try:
        link.send(answer)
    except OSError:
        raise
    except Exception as error:  # nothing was sent: pickling comes first
        link.send((None, f"the result can't be sent back: {describe(error)}", answer[2]))


def _stop(_signal: int, _frame: FrameType | None) -> None:
    if hasattr(signal, "setitimer"):
        # Once more in a while: raised in a callback of the garbage collector, it would be lost.
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
    raise _Stopped


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not _Stopped:
        sys.__unraisablehook__(lost)


def _die_with_parent() -> None:
    # A parent that was killed closes nothing; a worker must not go on writing during a second run.
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
