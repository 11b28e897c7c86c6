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
from jaxtyping import Array, Bool, Float, UInt32
from numpy.typing import ArrayLike

from smooth_operator.compilation.compiled_program import CompiledProgram
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.human.alignment import (
    AlignmentConfig,
)
from smooth_operator.methods.frame import (
    FrameResult,
    FrameState,
    Program,
    RetargetState,
    StateLayout,
    Step,
    align_frame,
    packed_result,
)
from smooth_operator.methods.method import Method, MethodConfig
from smooth_operator.types import Status


def frame_step(method: Method, alignment: AlignmentConfig) -> Step:
    """One frame as a function to be compiled, by itself or in a longer program.

    Raises:
        ConfigError: the method's ``step`` takes other arguments.
    """
    try:
        inspect.signature(method.step).bind(None, None, None)
    except TypeError:
        raise ConfigError(
            f"{type(method).__name__}.step{inspect.signature(method.step)} must be step(state, "
            "aligned, ticks); see docs/reference/methods.md, Your own"
        ) from None

    def step(
        state: FrameState,
        landmarks: Float[Array, "21 3"],
        valid: Bool[Array, "21"],
        ticks: UInt32[Array, ""],
    ) -> tuple[FrameState, FrameResult]:
        frame = align_frame(method, alignment, landmarks, valid)
        after, output = method.step(state.method, frame.aligned, ticks)
        solved = jnp.isfinite(output.q).all()
        status = jnp.where(
            (frame.status == Status.OK) & ~solved, Status.SOLVER_FAILED, frame.status
        )
        # a frame changes nothing unless its status is OK
        state = jax.tree.map(
            lambda new, old: jnp.where(status == Status.OK, new, old),
            FrameState(after, jnp.asarray(output.q)),
            state,
        )
        loss = jnp.asarray(output.tracking_loss)
        return state, FrameResult(state.q, status, loss, frame.scale)

    return step


def frame_program(method: Method, config: MethodConfig, cached: bool = True) -> Program:
    """The program of one frame; it compiles when it is first called, or is read from the user's
    cache if ``cached``."""
    compiling = functools.partial(
        CompiledProgram,
        hand=method.hand,
        config=config,
        constants=method.constants,
        cached=cached,
    )
    if method.on_host:
        from smooth_operator.methods.host_method import HostMethod, host_program

        assert isinstance(method, HostMethod)
        return host_program(method, config.alignment, compiling)
    step = frame_step(method, config.alignment)
    neutral = np.asarray(method.hand.neutral, np.float32)

    def packed(
        words: Array, others: tuple[Any, ...], landmarks: Array, valid: Array, ticks: Array
    ) -> tuple[Array, tuple[Any, ...], Array]:
        layout = StateLayout.of(FrameState(method.init(0), neutral))
        state, result = step(layout.unpack(words, others), landmarks, valid, ticks)
        flat = packed_result(result.q, result.status, result.tracking_loss, result.scale)
        return *layout.pack(state), flat

    run = compiling(packed, "frame")

    def program(
        state: RetargetState, landmarks: np.ndarray, valid: np.ndarray, ticks: np.uint32
    ) -> tuple[RetargetState, FrameResult]:
        words, others, flat = run(state.words, state.others, landmarks, valid, ticks)
        numbers = np.asarray(flat)
        status, loss, scale = numbers[-3:].tolist()
        after = RetargetState(words, others, state.layout)
        return after, FrameResult(numbers[:-3], int(status), loss, scale)

    return program


def ticks_of(stamp: Float[ArrayLike, "*n"]) -> UInt32[np.ndarray, "*n"]:
    """Time as the programs take it: microseconds modulo 2^32, whose differences are right for half
    an hour, where a float32 of the time of day is not good to a minute.

    Args:
        stamp: [s]; one that is not finite counts as 0.
    """
    whole = np.round(np.nan_to_num(np.asarray(stamp, float), posinf=0.0, neginf=0.0) * 1e6)
    return np.asarray(np.mod(whole, 2.0**32)).astype(np.uint32)


def tick_of(stamp: float) -> np.uint32:
    """``ticks_of`` of one stamp [s], in a tenth of its time."""
    return np.uint32(round(stamp * 1e6) % 2**32 if math.isfinite(stamp) else 0)


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
