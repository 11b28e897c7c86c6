"""JAX's persistent compilation cache, for what a command compiles besides the programs of frames.

Programs of frames are kept by the library itself (``program_cache``). Only the command line and its
workers switch JAX's own cache on; importing the library never does.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Final

from smooth_operator.compilation.program_cache import machine, own_folder, remove_foreign
from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache

_DAMAGED: Final = "Error reading persistent compilation cache"


def enable_cache() -> Path | None:
    """Lets JAX keep its compiled programs; call it before anything is compiled.

    Returns:
        The folder; None if it is switched off (``SWITCH``), can't be written or is open to other
        users (``own_folder``), or the user has already given JAX a folder.
    """
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return None
    import jax

    config: Any = jax.config  # its attributes are made at run time
    if config.jax_compilation_cache_dir:
        return None
    folder = own_folder(user_cache() / machine())
    if folder is None:
        return None
    if parent_process() is None:  # a worker's entries may be on their way
        try:
            remove_foreign(folder)  # JAX opens them by their names, and waits for a pipe
        except OSError:
            return None
    config.update("jax_compilation_cache_dir", str(folder))
    config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


@contextlib.contextmanager
def healing(folder: Path | None) -> Iterator[None]:
    """Around compiling: a damaged entry is thrown away, where JAX would warn of it for ever.

    JAX makes files by the umask of the process; afterwards only this user can write them.

    Args:
        folder: of ``enable_cache``.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        try:
            yield
        finally:
            for entry in [] if folder is None else folder.glob("*-cache"):
                with contextlib.suppress(OSError):
                    entry.chmod(0o600)
    for warning in caught:
        if folder is not None and str(warning.message).startswith(_DAMAGED):
            for entry in folder.glob("*-cache"):
                with contextlib.suppress(OSError):
                    entry.unlink()
        else:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
