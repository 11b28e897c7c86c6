"""Programs that run on the thread that calls them, rather than on threads that have to be woken."""

from __future__ import annotations

import contextlib
import os
from typing import Any, Final

_SIZES: Final = ("PJRT_NPROC", "NPROC")
"""Environment variables from which XLA takes the size of its pool of threads, when it starts."""


def dispatch_here(*, one_thread: bool = False) -> None:
    """Makes JAX run CPU programs on the calling thread; call it before JAX is first used.

    JAX hands a program to its own thread, so that the caller can go on with something else. A
    retargeter has nothing else to do, and being woken takes longer than its smaller programs: an
    evaluation of an objective for SLSQP takes 25 to 40 µs directly, and 48 to 80 µs handed over.
    It is a setting of the process: only the command line and its workers do this.

    Args:
        one_thread: whether XLA's pool has one thread, which saves ``smooth`` a sixth of a frame.
    """
    import jax

    config: Any = jax.config  # its attributes are made at run time
    with contextlib.suppress(AttributeError):  # a JAX that has no such option
        config.update("jax_cpu_enable_async_dispatch", False)
    if one_thread and os.environ.keys().isdisjoint(_SIZES):
        os.environ[_SIZES[0]] = "1"
        jax.devices()  # starts the pool
        del os.environ[_SIZES[0]]  # this process's own
