"""Building a retargeter for use: compiled or while it compiles, its programs cached, on the calling
thread."""

from __future__ import annotations

import time

from smooth_operator.compilation.compile_cache import enable_cache, healing
from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.compilation.helper_process import compile_in_helper
from smooth_operator.compilation.kept_program import before_compiling
from smooth_operator.hands.hand import Hand
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.retargeter import Retargeter


def build_retargeter(
    hand: Hand, config: MethodConfig, seed: int, *, early: bool = False
) -> tuple[Retargeter, float]:
    """A retargeter, and how long it took [s].

    Args:
        hand: the robot hand.
        config: the method's settings.
        seed: of the method's random numbers.
        early: whether it answers while it compiles; otherwise it is warmed up.

    Raises:
        ConfigError: the preset needs the whole recording.
    """
    started = time.perf_counter()
    dispatch_here(one_thread=config.one_thread)
    with healing(enable_cache()):
        retargeter = Retargeter(hand, config=config, seed=seed, early=early)
        if not early:
            retargeter.warm_up()
    return retargeter, time.perf_counter() - started


def build_for_running_loop(hand: Hand, config: MethodConfig, seed: int) -> Retargeter:
    """A retargeter, warmed up, for a loop that runs in this process meanwhile.

    What was not kept is compiled by another process and then read; where it can't be kept, as for
    the methods of plugins and where the cache is off, it is compiled here.

    Raises:
        ConfigError: the preset needs the whole recording.
    """
    asked = False

    def notice(can_be_kept: bool) -> bool:
        nonlocal asked
        first, asked = can_be_kept and not asked, asked or can_be_kept
        return first and compile_in_helper(hand, config)

    with before_compiling(notice):
        return build_retargeter(hand, config, seed)[0]
