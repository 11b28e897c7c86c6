"""Programs that run on the calling thread, and retargeters that are compiled for use."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:  # their imports take a second
    from smooth_operator.hands.hand import Hand
    from smooth_operator.retargeting.method import MethodConfig
    from smooth_operator.retargeting.retargeter import Retargeter

_SIZES: Final = ("PJRT_NPROC", "NPROC")
"""Environment variables from which XLA takes the size of its pool of threads, when it starts."""


def dispatch_here(*, one_thread: bool = False) -> None:
    """Makes JAX run CPU programs on the calling thread; call it before JAX is first used.

    JAX hands a program to its own thread, so that the caller can go on with something else. A
    retargeter has nothing else to do, and being woken takes longer than its smaller programs: an
    evaluation of an objective for SLSQP takes 25 to 40 µs directly, and 48 to 80 µs handed over.
    It is a setting of the process: only the command line and its workers do this.

    Args:
        one_thread: XLA's pool has one thread, which saves ``smooth`` a sixth of a frame.
    """
    import jax

    config: Any = jax.config  # its attributes are made at run time
    with contextlib.suppress(AttributeError):  # a JAX that has no such option
        config.update("jax_cpu_enable_async_dispatch", False)
    if one_thread and os.environ.keys().isdisjoint(_SIZES):
        os.environ[_SIZES[0]] = "1"
        jax.devices()  # starts the pool
        del os.environ[_SIZES[0]]  # this process's own


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
    dispatch_here(one_thread=config.one_thread)
    retargeter = Retargeter(hand, config=config, seed=seed, pinch_gaps=pinch_gaps)
    retargeter.warm_up()
    return retargeter, time.perf_counter() - started
