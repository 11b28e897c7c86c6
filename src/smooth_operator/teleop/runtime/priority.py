"""Gives the loop real-time priority, if the system allows it.

On a busy machine, for example with a browser that draws without a graphics card, a fair scheduler
makes a thread wait some milliseconds after it wakes, which is the loop's whole budget. Linux offers
real-time scheduling for this. A process may use it as root, with ``CAP_SYS_NICE``, or with an
``rtprio`` line in ``limits.conf``.
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

# Low real-time priorities: threads of the kernel have 50. All threads of the process need one: the
# loop waits for a preempted thread that holds the GIL or runs a part of the retargeter's program.
_LOOP: Final = 3
_PYTHON: Final = 2
"""Priority of Python threads, such as those of sources and sinks."""
_NATIVE: Final = 1
"""Priority of the threads that libraries start, some of which may be compiling a method."""
_SWITCH_S: Final = 5e-4
"""Longest time that another thread keeps the interpreter when the loop needs it [s]."""


@contextlib.contextmanager
def low_jitter() -> Iterator[None]:
    """Reduces delays that other threads of this process and garbage collection cause in the loop.

    Existing objects are excluded from garbage collection inside the block: a compiled model has
    very many objects, which each collection would visit.
    """
    # Also at exit, where a collection would delay the end by seconds.
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
    turn = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(turn)


@contextlib.contextmanager
def going_first() -> Iterator[Priority]:
    """Gives the threads of this process real-time priority. Use it on the loop's thread.

    Threads and processes that start later, such as for compiling or drawing, do not get it. The
    kernel reserves a twentieth of each core for other processes.

    Yields:
        the priority that the system granted.
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
        """Set or clear (None) the real-time priority of a thread; True if the system granted it."""
        # the flag: children start as usual
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK if priority else os.SCHED_OTHER
        try:
            os.sched_setscheduler(task, policy, os.sched_param(priority or 0))
        except OSError:  # not allowed, or the thread has just ended
            return False
        return True
