"""The program of one frame: landmarks and state to a command, a status and the next state."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32
from numpy.typing import ArrayLike

from smooth_operator.compilation.compiled_program import CompiledProgram
from smooth_operator.errors import ConfigError
from smooth_operator.human.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    palm_range,
    reference_landmarks,
)
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.io.anatomy import implausible
from smooth_operator.methods.method import Compiling, HostMethod, Method, MethodConfig
from smooth_operator.methods.state import FrameState, RetargetState, StateLayout
from smooth_operator.types import Status


class FrameResult(NamedTuple):
    """The result of one frame, as the compiled program returns it.

    Attributes:
        q: (m,) command of the actuated joints [rad], the last good one unless the status is OK.
        status: a ``Status``.
        tracking_loss: tracking loss of the command.
        scale: robot size over human size in this frame's alignment.
    """

    q: Float[Array, " m"] | Float[np.ndarray, " m"]
    status: Int[Array, ""] | int
    tracking_loss: Float[Array, ""] | float
    scale: Float[Array, ""] | float


Step: TypeAlias = Callable[[FrameState, Array, Array, Array], tuple[FrameState, FrameResult]]
"""State, (21, 3) landmarks [m], (21,) validity and the frame's ticks (``ticks_of``) to the next
state and the result; traceable."""

Program: TypeAlias = Callable[
    [RetargetState, np.ndarray, np.ndarray, np.uint32], tuple[RetargetState, FrameResult]
]
"""The same on the host, compiled."""


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
    """The program of one frame; it compiles when it is first called.

    Args:
        method: the method for one hand.
        config: its settings.
        cached: compiled programs are read from the user's cache, and written there.
    """
    compiling = functools.partial(
        CompiledProgram,
        hand=method.hand,
        config=config,
        constants=method.constants,
        cached=cached,
    )
    if method.host is not None:
        return _host_program(method.host, config.alignment, compiling)
    step = frame_step(method, config.alignment)
    neutral = np.asarray(method.hand.neutral, np.float32)

    def packed(
        words: Array, others: tuple[Any, ...], landmarks: Array, valid: Array, ticks: Array
    ) -> tuple[Array, tuple[Any, ...], Array]:
        layout = StateLayout.of(FrameState(method.init(0), neutral))
        state, result = step(layout.unpack(words, others), landmarks, valid, ticks)
        flat = _pack(result.q, result.status, result.tracking_loss, result.scale)
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


def _pack(*parts: Array | np.ndarray | float) -> Array:
    """One array: what the host reads costs by the piece, not by the byte."""
    return jnp.concatenate([jnp.atleast_1d(jnp.asarray(part, jnp.float32)) for part in parts])


class AlignedFrame(NamedTuple):
    """A frame in the palm frame; one that can't be used has reference landmarks instead.

    Attributes:
        aligned: (21, 3) landmarks in the palm frame [m]; NaN where one is not known.
        status: a ``Status``.
        scale: robot size over human size in this frame's alignment.
    """

    aligned: Float[Array, "21 3"]
    status: Int[Array, ""]
    scale: Float[Array, ""]


def align_frame(
    method: Method, alignment: AlignmentConfig, landmarks: Array, valid: Array
) -> AlignedFrame:
    """Landmarks into the palm frame; whatever the input, the arithmetic stays finite."""
    hand, operator = method.hand, alignment.operator
    corrected = () if operator is None else operator.needs(hand)
    needs = np.array(sorted({*method.needs, *hand.align_indices, *corrected}))
    finite = jnp.isfinite(landmarks).all(axis=-1) & valid
    present = finite[needs].all()
    finite_landmarks = jnp.where(finite[:, None], landmarks, jnp.nan)
    safe = jnp.where(
        present, finite_landmarks, jnp.asarray(reference_landmarks(hand), landmarks.dtype)
    )
    palm = palm_alignment(safe, hand, alignment)
    well_posed = palm.condition >= MIN_CONDITION  # False for NaN
    odd = implausible(landmarks, finite, palm_range(hand))
    status = jnp.where(
        ~present,
        Status.INVALID_LANDMARKS,
        jnp.where(
            ~well_posed,
            Status.DEGENERATE_PALM,
            jnp.where(odd, Status.IMPLAUSIBLE_HAND, Status.OK),
        ),
    )
    aligned = palm.apply(safe)
    if operator is not None:
        aligned = operator.correct(aligned, palm.scale, hand, human_palm_axes(hand))
    return AlignedFrame(aligned, status, palm.scale)


def _host_program(method: HostMethod, alignment: AlignmentConfig, compiling: Compiling) -> Program:
    def prepare(state: Any, landmarks: Array, valid: Array, ticks: Array) -> tuple[Any, Array]:
        frame = align_frame(method, alignment, landmarks, valid)
        return method.prepare(state, frame.aligned, ticks), _pack(frame.status, frame.scale)

    before = compiling(prepare, "frame")
    method.compile_with(compiling)

    def program(
        state: RetargetState, landmarks: np.ndarray, valid: np.ndarray, ticks: np.uint32
    ) -> tuple[RetargetState, FrameResult]:
        problem, flat = before(state.method, landmarks, valid, ticks)
        code, scale = np.asarray(flat).tolist()
        if code != Status.OK:
            return state, FrameResult(state.q, int(code), np.nan, scale)
        after, output = method.solve(state.method, problem)
        loss = float(output.tracking_loss)
        if not np.isfinite(output.q).all():
            return state, FrameResult(state.q, Status.SOLVER_FAILED, loss, scale)
        state = RetargetState.of(FrameState(after, np.asarray(output.q)), joined=False)
        return state, FrameResult(output.q, int(code), loss, scale)

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
