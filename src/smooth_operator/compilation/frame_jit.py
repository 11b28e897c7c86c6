"""``jax.jit`` for programs of one frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import numpy as np


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """``jax.jit`` with the options that suit programs of one frame."""
    return jax.jit(function, compiler_options=_compiler_options())


@cache
def _compiler_options() -> dict[str, Any] | None:
    """Options that make a CPU program start sooner.

    XLA's newer emitter of fused loops takes 1.6 s longer over this program, and the program is no
    faster for it. The option is XLA's own and may go: where it is unknown, there is none.
    """
    if jax.default_backend() != "cpu":
        return None
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x, compiler_options=options)(np.float32(0))
    except Exception:  # what XLA raises for an unknown option has changed between versions
        return None
    return options
