"""JAX's persistent compilation cache, in a folder of this user: the second start is faster.

Traced programs are kept in another folder there (``exported_program``). Results are the same, bit
for bit. Only the command line and its workers do this; importing the library never does. Figures:
docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import secrets
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache

_programs: Path | None = None
_DAMAGED: Final = "Error reading persistent compilation cache"


def enable_cache() -> Path | None:
    """Lets JAX keep its compiled programs; call it before anything is compiled.

    Returns:
        The folder; None if it is switched off (``SWITCH``), can't be written, or the user has
        already given JAX a folder.
    """
    global _programs
    wanted = os.environ.get(SWITCH, "").strip()
    if wanted.lower() in OFF:
        return None
    import jax

    programs = user_cache() / "programs"
    _programs = programs if _writable(programs) else None

    config: Any = jax.config  # its attributes are made at run time
    if config.jax_compilation_cache_dir:
        return None
    # Compiled code fits one kind of processor: a home on a network disk serves several.
    folder = user_cache() / _machine()
    if not _writable(folder):
        return None
    config.update("jax_compilation_cache_dir", str(folder))
    config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


def kept_programs() -> Path | None:
    """The folder of exported programs; None until ``enable_cache`` was called, and without one."""
    return _programs


@contextlib.contextmanager
def healing(folder: Path | None) -> Iterator[None]:
    """Around compiling: a damaged entry is thrown away, where JAX would warn of it for ever.

    Args:
        folder: of ``enable_cache``.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        yield
    for warning in caught:
        if folder is not None and str(warning.message).startswith(_DAMAGED):
            for entry in folder.glob("*-cache"):
                with contextlib.suppress(OSError):
                    entry.unlink()
        else:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )


def _machine() -> str:
    features = [platform.machine(), platform.processor(), version("jaxlib")]
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        features += sorted({line for line in lines if line.startswith(("flags", "Features"))})
    return hashlib.sha256("\n".join(features).encode()).hexdigest()[:16]


def _writable(folder: Path) -> bool:
    probe = folder / f".{secrets.token_hex(4)}"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False  # what someone else put there is not run
        probe.touch()
        probe.unlink()
    except OSError:
        return False
    return True
