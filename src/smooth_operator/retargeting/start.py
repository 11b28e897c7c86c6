"""Configures JAX in a process of your own, and finds the folder for its compiled code."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from smooth_operator.own_files import make_room, own_folder
from smooth_operator.user_folders import is_off, user_cache


def start_jax(*, one_thread: bool = True) -> None:
    """Makes JAX run CPU programs on the calling thread. Call it before JAX is first used.

    By default, JAX runs a program on its own thread, so that the caller can do something else. A
    retargeter has nothing else to do, and waking a thread takes longer than its smaller programs.

    With one thread, XLA does not split a program, and a frame of ``smooth`` takes a quarter less
    time. XLA starts one thread per core that the process may use. The process is therefore limited
    to one core while XLA starts, and uses all cores afterwards. Systems that can't limit the cores
    (macOS, Windows) keep all threads. Results are the same.

    These settings affect the whole process, so only the command or your own program calls this.

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


def jax_folder() -> Path | None:
    """This user's folder for JAX's compilation cache, with machine code for this processor.

    None if it is disabled (``SWITCH``) or there is no safe folder. Files that were not used for
    long are removed. The command enables it; your program may too (docs/reference/methods.md).
    """
    folder = None if is_off() else own_folder(user_cache() / machine())
    if folder is not None:
        with contextlib.suppress(OSError):
            make_room(folder)
    return folder


@functools.cache
def machine() -> str:
    """Digest of the processor's features and of jaxlib, which determine whether machine code is
    valid. So machines that share a home folder don't load each other's machine code."""
    features = [platform.system(), platform.machine(), version("jaxlib")]
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            features += [next(each for each in lines if each.startswith(("flags", "Features")))]
    except (OSError, StopIteration):
        features += [platform.processor(), platform.node()]
    return hashlib.sha256("\n".join(features).encode()).hexdigest()[:16]
