"""One thread for each worker, so that workers do not fight over the cores.

Small programs are faster so: preset realtime takes 0.6 ms a frame on one of XLA's threads and
0.8 ms on two. And where there are as many workers as cores, it keeps them apart.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any


@contextmanager
def one_thread(slot: int) -> Iterator[Callable[[], None]]:
    """Libraries that start their threads in this block start one.

    XLA and BLAS size their pools once, by the cores that the process may use at that moment; so it
    may use one, and all of them again afterwards, since a worker that is tied to one core waits
    where another process needs that core. XLA's own switch (``xla_cpu_multi_thread_eigen``) is not
    touched: it changes the compiled program, and with it the last bits of the results.

    Where a process can't choose its cores (macOS, Windows) nothing is limited; the results are
    the same.

    Args:
        slot: number of the worker; neighbours start on different cores.

    Yields:
        a function to call when all libraries are imported: XLA, where it is there, then starts its
        threads immediately and not at its first use.
    """
    # Several processes share an accelerator; by default the first would take all its memory.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    if not hasattr(os, "sched_setaffinity"):
        yield _start_threads
        return
    all_cores = os.sched_getaffinity(0)
    with suppress(OSError):  # a sandbox may forbid it
        os.sched_setaffinity(0, {sorted(all_cores)[slot % len(all_cores)]})
    try:
        yield _start_threads
    finally:
        with suppress(OSError):
            os.sched_setaffinity(0, all_cores)


def _start_threads() -> None:
    # Not imported: who does not compute with JAX must not wait for it.
    jax: Any = sys.modules.get("jax")
    if jax is not None:
        with suppress(AttributeError):  # a JAX that has no such option
            # On the thread that calls: the other one would wait for it, and be woken for nothing.
            jax.config.update("jax_cpu_enable_async_dispatch", False)
        jax.devices()
