"""Real-time priority of the loop, where the system allows it.

On a machine that is busy, such as with a browser that draws without a graphics card, a thread that
wakes waits for its turn: with a fair scheduler that is some milliseconds, which are the loop's
whole budget. Linux has real-time scheduling for this; it needs a right (root, ``CAP_SYS_NICE``, or
an ``rtprio`` line in ``limits.conf``).
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import sys
import threading
from collections.abc import Iterator
from typing import Final, Literal, TypeAlias

Priority: TypeAlias = Literal["real-time", "normal"]

# Low among real-time priorities: threads of the kernel are at 50. None of the process's threads can
# stay behind: one that has lost its turn while it holds the interpreter, or does a part of the
# retargeter's program, makes the loop wait for it.
_LOOP: Final = 3
_PYTHON: Final = 2
"""Sources, sinks, and other holders of the interpreter."""
_NATIVE: Final = 1
"""Those of libraries, which compile, too, if another method is asked for while the loop runs."""
_SWITCH_S: Final = 5e-4
"""Time that another thread may keep the interpreter before the loop gets it [s]."""


@contextlib.contextmanager
def low_jitter() -> Iterator[None]:
    """The loop before the rest of this process: short turns for other threads, few collections.

    What exists now is left out of garbage collection meanwhile: a compiled model is a great many
    objects, which each collection would visit.
    """
    # nor at the end of the process, when it would delay the end by seconds after Ctrl-C
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
    turn = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(turn)


@contextlib.contextmanager
def going_first() -> Iterator[Priority]:
    """The threads of this process go before those of others; use it on the loop's thread.

    Threads and processes that start later are not concerned: what compiles, or draws, stays behind.
    The kernel keeps a twentieth of each core for the others whatever happens.

    Yields:
        what the system granted.
    """
    if sys.platform != "linux" or not _set(0, _LOOP):
        yield "normal"
        return
    own, python = threading.get_native_id(), {t.native_id for t in threading.enumerate()}
    others = [task for task in map(int, os.listdir("/proc/self/task")) if task != own]
    for task in others:
        _set(task, _PYTHON if task in python else _NATIVE)
    try:
        yield "real-time"
    finally:
        for task in (own, *others):
            _set(task, None)


if sys.platform == "linux":

    def _set(task: int, priority: int | None) -> bool:
        """Real-time priority of a thread, None for none; whether it was granted."""
        # the flag: children start as usual
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK if priority else os.SCHED_OTHER
        try:
            os.sched_setscheduler(task, policy, os.sched_param(priority or 0))
        except OSError:  # not allowed, or the thread has just ended
            return False
        return True
