"""Building a retargeter for use: compiled, its programs cached, on the calling thread."""

from __future__ import annotations

import time

from smooth_operator.compilation.compile_cache import enable_cache, healing
from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.hands.hand import Hand
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.retargeter import Retargeter


def build_retargeter(hand: Hand, config: MethodConfig, seed: int) -> tuple[Retargeter, float]:
    """A retargeter, warmed up, and how long that took [s].

    Raises:
        ConfigError: the preset needs the whole recording.
    """
    started = time.perf_counter()
    dispatch_here(one_thread=config.one_thread)
    with healing(enable_cache()):
        retargeter = Retargeter(hand, config=config, seed=seed)
        retargeter.warm_up()
    return retargeter, time.perf_counter() - started
