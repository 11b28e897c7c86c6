"""The start of JAX in a process of one's own, and retargeters that are compiled for use."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # their imports take a second
    from smooth_operator.hands.hand import Hand
    from smooth_operator.retargeting.method import MethodConfig
    from smooth_operator.retargeting.retargeter import Retargeter


def start_jax(*, one_thread: bool = True) -> None:
    """Has JAX run CPU programs on the calling thread; call it before JAX is first used.

    JAX hands a program to its own thread, so that the caller can go on with something else. A
    retargeter has nothing else to do, and being woken takes longer than its smaller programs.

    With one thread, XLA hands no parts of a program to others, and a frame of ``smooth``
    takes a quarter less. XLA takes as many threads as the process may use cores when it starts. So
    the process uses one core while it does, and all of them afterwards. Systems without a choice of
    cores (macOS, Windows) keep all threads. Results are the same.

    These are settings of the process: only the command line, or a program of yours, calls this.

    Args:
        one_thread: start XLA now, with one thread; better for all presets but ``sbr:paper``.
    """
    import jax

    config: Any = jax.config  # its attributes are made at run time
    with contextlib.suppress(AttributeError):  # a JAX that has no such option
        config.update("jax_cpu_enable_async_dispatch", False)
    if not one_thread or not hasattr(os, "sched_setaffinity"):
        return
    cores = os.sched_getaffinity(0)
    with contextlib.suppress(OSError):  # a sandbox may forbid it
        os.sched_setaffinity(0, {min(cores)})
    try:
        jax.devices()
    finally:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, cores)


def build_retargeter(
    hand: Hand, config: MethodConfig, seed: int, pinch_gaps: Mapping[str, float] | None
) -> tuple[Retargeter, float]:
    """A compiled retargeter, and the time that it took [s].

    Args:
        pinch_gaps: known gaps, as for ``Retargeter``.

    Raises:
        ConfigError: the preset needs the whole recording.
    """
    from smooth_operator.retargeting.retargeter import Retargeter

    started = time.perf_counter()
    retargeter = Retargeter(hand, config=config, seed=seed, pinch_gaps=pinch_gaps)
    retargeter.warm_up()
    return retargeter, time.perf_counter() - started
