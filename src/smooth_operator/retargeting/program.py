"""The program of one frame: landmarks and state to a command, a status and the next state.

Retargeters that would compile the same program share one (``shared_program``): those of one hand
and configuration, and those of a hand and of its mirror image, which is served by the other's
program with the landmarks reflected. Figures of a hand are constants of its program: as arguments,
a frame took 2.1 to 3.5 times as long.
"""

from __future__ import annotations

import functools
import inspect
import math
import threading
from collections import OrderedDict
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32
from numpy.typing import ArrayLike

from smooth_operator.compilation.compiled_program import CompiledProgram
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.retargeting.frame import (
    FrameResult,
    FrameState,
    Program,
    RetargetState,
    StateLayout,
    align_frame,
    packed_result,
)
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.types import Status


def frame_program(method: Method, config: MethodConfig, cached: bool = True) -> Program:
    """The program of one frame; it compiles when it is first called, or is read from the user's
    cache if ``cached``.

    Raises:
        ConfigError: the method's ``step`` takes other arguments.
    """
    compiling = functools.partial(
        CompiledProgram,
        hand=method.hand,
        config=config,
        constants=method.constants,
        cached=cached,
    )
    if method.on_host:
        from smooth_operator.retargeting.host_method import HostMethod, host_program

        assert isinstance(method, HostMethod)
        return host_program(method, config.alignment, compiling)
    try:
        inspect.signature(method.step).bind(None, None, None)
    except TypeError:
        raise ConfigError(
            f"{type(method).__name__}.step{inspect.signature(method.step)} must be step(state, "
            "aligned, ticks); see docs/reference/methods.md, Your own"
        ) from None
    layout = StateLayout.of(FrameState(method.init(0), np.asarray(method.hand.neutral, np.float32)))

    def frame(
        words: Array, others: tuple[Any, ...], landmarks: Array, valid: Array, ticks: Array
    ) -> tuple[Array, tuple[Any, ...], Array]:
        palm, before = align_frame(method, config.alignment, landmarks, valid), (words, others)

        def solved() -> tuple[Any, Any, Array, Array]:
            last = layout.unpack(words, others)
            after, output = method.step(last.method, palm.aligned, ticks)
            finite = jnp.isfinite(output.q).all()
            # a frame changes nothing unless its status is OK
            following = jax.tree.map(
                lambda new, old: jnp.where(finite, new, old).astype(old.dtype),
                FrameState(after, jnp.asarray(output.q)),
                last,
            )
            status = jnp.where(finite, int(Status.OK), int(Status.SOLVER_FAILED))
            loss = jnp.asarray(output.tracking_loss, jnp.float32)
            return layout.pack(following), following.q, status, loss

        def refused() -> tuple[Any, Any, Array, Array]:
            return before, layout.unpack(*before).q, palm.status, jnp.float32(jnp.nan)

        # A solver would take longest with landmarks that are no hand. A branch copies what it takes
        # and gives by the array, so the state's arrays stay in one.
        after, *result = lax.cond(palm.status == Status.OK, solved, refused)
        return *after, packed_result(*result, palm.scale)

    run = compiling(frame, "frame")

    def program(
        state: RetargetState, landmarks: np.ndarray, valid: np.ndarray, ticks: np.uint32
    ) -> tuple[RetargetState, FrameResult]:
        words, others, flat = run(state.words, state.others, landmarks, valid, ticks)
        numbers = np.asarray(flat)
        status, loss, scale = numbers[-3:].tolist()
        after = RetargetState(words, others, state.layout)
        return after, FrameResult(numbers[:-3], int(status), loss, scale)

    return program


LONGEST_TICKS: Final = 2**31 - 1
"""Longest time between two frames in ticks, 36 minutes: a longer one counts as this. Differences
are modulo 2^32, so that without a bound a gap of 72 minutes would count as none."""


def ticks_of(stamps: Float[ArrayLike, "*R T"]) -> UInt32[np.ndarray, "*R T"]:
    """Time as the programs take it: microseconds modulo 2^32, whose differences are right, where a
    float32 of the time of day is not good to a minute.

    Args:
        stamps: (..., T) times of the frames of recordings [s]. One that is not finite counts as 0.
            A step back counts as -1 tick, one over ``LONGEST_TICKS`` as that.
    """
    whole = np.round(np.nan_to_num(np.asarray(stamps, float), posinf=0.0, neginf=0.0) * 1e6)
    passed = np.diff(whole, axis=-1, prepend=whole[..., :1])
    ticks = whole[..., :1] + np.cumsum(np.clip(passed, -1, LONGEST_TICKS), axis=-1)
    return np.asarray(np.mod(ticks, 2.0**32)).astype(np.uint32)


def tick_after(answered: tuple[float, int] | None, stamp: float) -> int:
    """``ticks_of`` for frames that come one by one.

    Args:
        answered: stamp [s] and ticks of the last frame that got a command; None for the first.
        stamp: stamp of the frame [s].
    """
    if answered is None:
        return round(stamp * 1e6) % 2**32 if math.isfinite(stamp) else 0
    passed = (stamp - answered[0]) * 1e6
    whole = round(min(passed, LONGEST_TICKS)) if passed >= 0 else -1  # of NaN, too
    return (answered[1] + whole) % 2**32


_KEPT: Final = 16
_programs: OrderedDict[tuple[str, MethodConfig, bool], SharedProgram] = OrderedDict()
_lock = threading.Lock()


class SharedProgram(NamedTuple):
    """A program, and whose it is.

    Attributes:
        method: the method that it was made from.
        run: the program of one frame.
        reflects: it is that of the hand's mirror image, and takes landmarks reflected.
        compiled: set once it has answered a frame with the status OK.
    """

    method: Method
    run: Program
    reflects: bool
    compiled: threading.Event


def shared_program(hand: Hand, config: MethodConfig, cache: bool = True) -> SharedProgram:
    """The program of a frame for a hand, or for its mirror image if it is described as one; with
    ``cache`` it is read from the user's cache, and stored there.

    Raises:
        SmoothOperatorError: the method can't serve the hand.
    """
    if not config.shareable:
        return _built(hand, config, False, cache)
    reflects = hand.spec.mirror
    served = load_hand_spec(hand.spec.mirrored) if reflects else hand
    key = (fingerprint(served), config, cache)
    try:
        with _lock:
            stored = _programs.get(key)
    except TypeError:  # a configuration of the user's own that has no hash
        return _built(served, config, reflects, cache)
    program = (stored or _built(served, config, reflects, cache))._replace(reflects=reflects)
    with _lock:
        _programs[key] = program
        _programs.move_to_end(key)
        while len(_programs) > _KEPT:
            _programs.popitem(last=False)
    return program


def _built(hand: Hand, config: MethodConfig, reflects: bool, cache: bool) -> SharedProgram:
    method = config.build(hand)
    return SharedProgram(method, frame_program(method, config, cache), reflects, threading.Event())
