"""No collection of garbage while something is traced and compiled."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def uncollected(*, freeze: bool = False) -> Iterator[None]:
    """No collection of garbage meanwhile.

    A collection has the interpreter to itself: a full one over what tracing a method leaves takes
    20 to 80 ms, and a loop would miss as many of its commands.

    Args:
        freeze: nor of what was made, afterwards. It stays anyway: JAX keeps compiled programs.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if freeze:
            gc.freeze()
        if enabled:
            gc.enable()
