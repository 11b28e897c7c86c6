"""``jax.jit`` for programs of one frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Final

import jax
import numpy as np

_NARROW: Final = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_experimental_ynn_fusion_type": ""}
_WIDE: Final = {**_NARROW, "xla_cpu_prefer_vector_width": 512}


def compiled(function: Callable[..., Any], *, wide: bool = False) -> Callable[..., Any]:
    """``jax.jit`` with the options that suit programs of one frame.

    Args:
        function: traceable.
        wide: whether most of its time goes to long loops over many numbers, which a processor with
            vectors of 512 bits is to run in such vectors; XLA prefers 256.
    """
    return jax.jit(function, compiler_options=_compiler_options(wide))


@cache
def _compiler_options(wide: bool) -> dict[str, Any] | None:
    """Options for a CPU, with which a program starts sooner and its loops suit the processor.

    XLA's newer emitter of fused loops takes 1.6 s longer over this program, and the program is no
    faster for it. The options are XLA's own and may go: where one is unknown, it is left out.
    """
    if jax.default_backend() != "cpu":
        return None
    for options in (_WIDE, _NARROW) if wide else (_NARROW,):
        try:
            jax.jit(lambda x: x, compiler_options=options)(np.float32(0))
        except Exception:  # what XLA raises for an unknown option has changed between versions
            continue
        return dict(options)
    return None
