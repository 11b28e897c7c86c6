"""The program of one frame: computes command, status and next state from landmarks and state.

Traced functions take the state as trees of arrays. Between frames the state is one array, which a
program takes and returns in a third of the time of twenty. The parameters of a hand are constants
of its program; as arguments, they made a frame 2.1 to 3.5 times as slow.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import array_namespace
from smooth_operator.io.anatomy import implausible
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    palm_range,
    reference_landmarks,
)
from smooth_operator.retargeting.compiled_program import CompiledProgram, ProgramCache
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.settings import RATE_RANGE_HZ
from smooth_operator.types import Status

_WORDS: Final = tuple(map(np.dtype, ("float32", "int32", "uint32", "bool")))
"""Kinds of arrays that fit into an array of float32 bit for bit."""


class FrameState(NamedTuple):
    """State of a retargeter as trees of arrays, for traceable functions.

    Attributes:
        method: state of the method.
        q: (m,) last good command of the actuated joints [rad].
    """

    method: Any
    q: Float[Array, " m"] | Float[np.ndarray, " m"]


@dataclass(frozen=True)
class StateLayout:
    """Structure, shapes and kinds of the arrays in a ``FrameState``, in the order of its leaves.

    Attributes:
        structure: JAX's structure of the tree.
        shapes: shape of each leaf that has a kind.
        kinds: kind of each leaf; None for a leaf that is not an array.
    """

    structure: Any
    shapes: tuple[tuple[int, ...], ...]
    kinds: tuple[np.dtype | None, ...]

    @classmethod
    def of(cls, state: FrameState) -> StateLayout:
        """Makes the layout of a state whose 32-bit arrays are packed into one array."""
        leaves, structure = jax.tree.flatten(state)
        kinds = tuple(getattr(leaf, "dtype", None) for leaf in leaves)
        return cls(structure, tuple(map(np.shape, leaves)), kinds)

    def pack(self, state: FrameState) -> tuple[Float[Array, " n"], tuple[Any, ...]]:
        """Packs all 32-bit leaves into one array; returns it and the other leaves. NumPy or JAX."""
        leaves = [*zip(jax.tree.leaves(state), self.kinds, strict=True)]
        words = [(leaf, kind) for leaf, kind in leaves if kind in _WORDS]
        xp = array_namespace(*(leaf for leaf, _ in words))
        parts = [_as(xp.asarray(leaf, kind).ravel(), np.dtype(np.float32)) for leaf, kind in words]
        others = tuple(leaf for leaf, kind in leaves if kind not in _WORDS)
        return xp.concatenate(parts), others

    def unpack(
        self, words: Float[Array, " n"] | Float[np.ndarray, " n"], others: tuple[Any, ...]
    ) -> FrameState:
        """Restores the state from the results of ``pack``; traceable."""
        leaves, rest, done = [], iter(others), 0
        for shape, kind in zip(self.shapes, self.kinds, strict=True):
            if kind is None or kind not in _WORDS:
                leaves.append(next(rest))
            else:
                end = done + math.prod(shape)
                leaves.append(_as(words[done:end].reshape(shape), kind))
                done = end
        return cast(FrameState, jax.tree.unflatten(self.structure, leaves))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class RetargetState:
    """Everything that a retargeter remembers between frames; a pytree.

    Attributes:
        words: (n,) joined 32-bit arrays of the method's state and the last command.
        others: further arrays of the method's state.
        layout: positions of the state's arrays in ``words`` and ``others``.
        stamp: timestamp of the last frame [s] with a frame rate, otherwise None; on the host.
        answered: timestamp [s] and ticks (``tick_after``) of the last frame with a command; None
            before the first. They stay on the host, in the precision of a timestamp.
    """

    words: Float[Array, " n"] | Float[np.ndarray, " n"]
    others: tuple[Any, ...]
    layout: StateLayout = field(metadata={"static": True})
    stamp: float | None = None
    answered: tuple[float, int] | None = None

    @classmethod
    def of(cls, state: FrameState) -> RetargetState:
        """Creates a state from its trees."""
        state = jax.device_get(state)
        layout = StateLayout.of(state)
        return cls(*layout.pack(state), layout)

    @cached_property
    def trees(self) -> FrameState:
        """The state as trees of NumPy arrays."""
        return self.layout.unpack(np.asarray(self.words), self.others)

    @property
    def method(self) -> Any:
        """State of the method."""
        return self.trees.method


def _as(part: Any, kind: np.dtype) -> Any:
    """Reinterprets bits as another 32-bit type; booleans become 0 or 1."""
    boolean = "b" in (part.dtype.kind, kind.kind)
    return part.astype(kind) if boolean else part.view(kind)


class FrameResult(NamedTuple):
    """The result of one frame, in the form that the compiled program returns.

    Attributes:
        q: (m,) command of the actuated joints [rad]; the last good command unless the status is OK.
        status: a ``Status``.
        tracking_loss: tracking loss of the command.
        scale: robot size over human size in this frame's alignment.
    """

    q: Float[Array, " m"] | Float[np.ndarray, " m"]
    status: Int[Array, ""] | int
    tracking_loss: Float[Array, ""] | float
    scale: Float[Array, ""] | float


Program: TypeAlias = Callable[
    [RetargetState, np.ndarray, np.ndarray, np.uint32], tuple[RetargetState, FrameResult]
]
"""Compiled function, called on the host: maps the state, (21, 3) landmarks [m], (21,) validity and
the frame's ticks (``tick_after``) to the next state and the result."""


class AlignedFrame(NamedTuple):
    """A frame, transformed to the palm frame. An unusable frame has reference landmarks instead.

    Attributes:
        aligned: (21, 3) landmarks in the palm frame [m]; NaN if unknown.
        status: a ``Status``.
        scale: robot size over human size in this frame's alignment.
    """

    aligned: Float[Array, "21 3"]
    status: Int[Array, ""]
    scale: Float[Array, ""]


def align_frame(
    method: Method, alignment: AlignmentConfig, landmarks: Array, valid: Array
) -> AlignedFrame:
    """Transforms landmarks to the palm frame. No input leads to values that are not finite."""
    hand = method.hand
    needs = np.array(sorted({*method.needs, *hand.align_indices}))
    finite = jnp.isfinite(landmarks).all(axis=-1) & valid
    present = finite[needs].all()
    reference = jnp.asarray(reference_landmarks(hand), landmarks.dtype)
    safe = jnp.where(present, jnp.where(finite[:, None], landmarks, jnp.nan), reference)
    palm = palm_alignment(safe, hand, alignment)
    well_posed = palm.condition >= MIN_CONDITION  # False for NaN
    odd = implausible(landmarks, finite, palm_range(hand))
    status = jnp.where(odd, Status.IMPLAUSIBLE_HAND, Status.OK)
    status = jnp.where(well_posed, status, Status.DEGENERATE_PALM)
    status = jnp.where(present, status, Status.INVALID_LANDMARKS)
    return AlignedFrame(palm.apply(safe), status, palm.scale)


def packed_result(*parts: Array | np.ndarray | float) -> Array:
    """Packs the result of a frame into one array, because reading several takes longer."""
    return jnp.concatenate([jnp.atleast_1d(jnp.asarray(part, jnp.float32)) for part in parts])


def frame_program(
    method: Method, config: MethodConfig, cache: ProgramCache | None = None
) -> Program:
    """Creates the program of one frame, which is traced or read from a cache, and compiled, at its
    first call. Raises ConfigError if the method's ``step`` takes other arguments."""
    compiling = functools.partial(
        CompiledProgram, hand=method.hand, config=config, constants=method.constants, cache=cache
    )
    if method.on_host:
        solved_on_host: Program = cast(Any, method).program(config.alignment, compiling)
        return solved_on_host
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

        def solved() -> tuple[Any, Array, Array]:
            after, output = method.step(layout.unpack(*before).method, palm.aligned, ticks)
            loss = jnp.asarray(output.tracking_loss, jnp.float32)
            return layout.pack(FrameState(after, output.q)), jnp.isfinite(output.q).all(), loss

        def refused() -> tuple[Any, Array, Array]:
            return before, jnp.bool_(True), jnp.float32(jnp.nan)

        # A solver would take longest with implausible landmarks. A branch copies its inputs and
        # outputs array by array, so the state stays in one array.
        after, finite, loss = lax.cond(palm.status == Status.OK, solved, refused)
        # a frame does not change the state unless its status is OK
        after = jax.tree.map(lambda new, old: jnp.where(finite, new, old), after, before)
        status = jnp.where(finite, palm.status, Status.SOLVER_FAILED)
        return *after, packed_result(layout.unpack(*after).q, status, loss, palm.scale)

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
"""Longest time between two frames in ticks, 36 minutes, because differences are modulo 2^32."""


def tick_after(answered: tuple[float, int] | None, stamp: float) -> int:
    """Time of a frame for the program: microseconds modulo 2^32, whose differences are exact,
    unlike those of float32. A timestamp that is not finite counts as 0, a step back as -1 tick.

    Args:
        answered: timestamp [s] and ticks of the last frame with a command; None for the first.
        stamp: timestamp of the frame [s].
    """
    if answered is None:
        return round(stamp * 1e6) % 2**32 if math.isfinite(stamp) else 0
    passed = (stamp - answered[0]) * 1e6
    whole = round(min(passed, LONGEST_TICKS)) if passed >= 0 else -1  # of NaN, too
    return (answered[1] + whole) % 2**32


_SHORTEST: Final = 0.5 / RATE_RANGE_HZ[1]
"""Shortest time between frames [s], half a period of the fastest tracker. It limits bursts."""


USUAL_RATE: Final = 100.0
"""Frame rate that is assumed if timestamps do not increase [Hz]."""

LONGEST_GAP: Final = 0.25
"""Longest time between frames that counts as motion [s]; after it, the last command is not used."""


class FrameClock(NamedTuple):
    """Time since the last frame, and whether motion restarts with this frame.

    Attributes:
        dt: that time [s].
        restart: True if there is no previous frame, or if it is too old to count as motion.
    """

    dt: Float[Array, ""]
    restart: Bool[Array, ""]

    @classmethod
    def of(cls, passed: UInt32[Array, ""], frames: UInt32[Array, ""]) -> FrameClock:
        """Makes the time of a frame from the ticks since the last frame and the number of earlier
        frames; traceable."""
        elapsed = passed.astype(jnp.int32) * 1e-6
        # a timestamp that goes back belongs to another recording
        restart = (frames == 0) | (elapsed > LONGEST_GAP) | (elapsed < 0)
        stamped = (passed > 0) & ~restart
        dt = jnp.where(stamped, jnp.maximum(elapsed, _SHORTEST), 1 / USUAL_RATE).astype(jnp.float32)
        return cls(dt, restart)
