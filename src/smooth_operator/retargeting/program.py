"""The program of one frame: landmarks and state to a command, a status and the next state.

Traced functions take the state as trees of arrays; between frames it is one array, which a program
takes and returns in a third of the time of twenty.

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
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, UInt32
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import array_namespace
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.io.anatomy import implausible
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    palm_range,
    reference_landmarks,
)
from smooth_operator.retargeting.compiled_program import CompiledProgram
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.types import Status

_WORDS: Final = tuple(map(np.dtype, ("float32", "int32", "uint32", "bool")))
"""Kinds of arrays that fit into an array of float32 bit for bit."""

_EMPTY: Final = np.zeros(0, np.float32)


class FrameState(NamedTuple):
    """The state as trees of arrays, as traceable functions take it.

    Attributes:
        method: state of the method.
        q: (m,) last good command of the actuated joints [rad].
    """

    method: Any
    q: Float[Array, " m"] | Float[np.ndarray, " m"]


@dataclass(frozen=True)
class StateLayout:
    """Structure, shapes and kinds of the arrays of a ``FrameState``, in the order of its leaves.

    Attributes:
        structure: JAX's structure of the tree.
        shapes: shape of each leaf that has a kind.
        kinds: kind of each leaf; None for one that is no array, or stays as it is.
    """

    structure: Any
    shapes: tuple[tuple[int, ...], ...]
    kinds: tuple[np.dtype | None, ...]

    @classmethod
    def of(cls, state: FrameState) -> StateLayout:
        """The layout of a state whose arrays of 32 bits are in one."""
        leaves, structure = jax.tree.flatten(state)
        kinds = (getattr(leaf, "dtype", None) for leaf in leaves)
        return cls(structure, tuple(map(np.shape, leaves)), tuple(kinds))

    def pack(self, state: FrameState) -> tuple[Float[Array, " n"], tuple[Any, ...]]:
        """One array with the leaves of 32 bits, bit for bit, and all other leaves.

        NumPy's arrays give one of NumPy's; traceable.
        """
        leaves = jax.tree.leaves(state)
        words = [leaf for leaf, kind in zip(leaves, self.kinds, strict=True) if kind in _WORDS]
        others = [leaf for leaf, kind in zip(leaves, self.kinds, strict=True) if kind not in _WORDS]
        xp = array_namespace(*words)
        parts = [_as(xp.asarray(leaf).ravel(), np.dtype(np.float32)) for leaf in words]
        return xp.concatenate(parts or [_EMPTY]), tuple(others)

    def unpack(
        self, words: Float[Array, " n"] | Float[np.ndarray, " n"], others: tuple[Any, ...]
    ) -> FrameState:
        """The state that ``pack`` took; traceable."""
        leaves, rest, done = [], iter(others), 0
        for shape, kind in zip(self.shapes, self.kinds, strict=True):
            if kind is None or kind not in _WORDS:
                leaves.append(next(rest))
                continue
            size = math.prod(shape)
            leaves.append(_as(words[done : done + size].reshape(shape), kind))
            done += size
        state: FrameState = jax.tree.unflatten(self.structure, leaves)
        return state


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["words", "others", "stamp", "answered"],
    meta_fields=["layout"],
)
@dataclass(frozen=True, eq=False)
class RetargetState:
    """All that a retargeter remembers between frames; a pytree.

    Attributes:
        words: (n,) arrays of 32 bits of the method's state, and the last command, in one.
        others: further arrays of the method's state.
        layout: places of the arrays of the state in ``words`` and ``others``.
        stamp: stamp of the last frame [s], where the retargeter counts frames by a rate; else None.
            It stays on the host.
        answered: stamp [s] and ticks (``tick_after``) of the last frame that got a command; None
            before the first. They stay on the host, in the precision of a stamp.
    """

    words: Float[Array, " n"] | Float[np.ndarray, " n"]
    others: tuple[Any, ...]
    layout: StateLayout
    stamp: float | None = None
    answered: tuple[float, int] | None = None

    @classmethod
    def of(cls, state: FrameState, joined: bool = True) -> RetargetState:
        """A state from its trees. Unless ``joined`` all arrays stay as they are, which is faster
        for a method whose solver runs on the host."""
        if not joined:
            leaves, structure = jax.tree.flatten(state)
            count = len(leaves)
            return cls(
                _EMPTY, tuple(leaves), StateLayout(structure, ((),) * count, (None,) * count)
            )
        state = jax.device_get(state)
        layout = StateLayout.of(state)
        return cls(*layout.pack(state), layout)

    @cached_property
    def trees(self) -> FrameState:
        """The state as trees of NumPy's arrays."""
        return self.layout.unpack(np.asarray(self.words), self.others)

    @property
    def method(self) -> Any:
        """State of the method."""
        return self.trees.method

    @property
    def q(self) -> Float[np.ndarray, " m"]:
        """(m,) last good command of the actuated joints [rad]."""
        return np.asarray(self.trees.q)


def _as(part: Any, kind: np.dtype) -> Any:
    """The same bits as another kind of 32 bits; truth as 0 or 1."""
    if part.dtype.kind == "b":
        return part.astype(kind)
    if kind.kind == "b":
        return part != 0
    if isinstance(part, np.ndarray):
        return part.view(kind)
    return jax.lax.bitcast_convert_type(part, jnp.dtype(kind))


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


Program: TypeAlias = Callable[
    [RetargetState, np.ndarray, np.ndarray, np.uint32], tuple[RetargetState, FrameResult]
]
"""State, (21, 3) landmarks [m], (21,) validity and the frame's ticks (``ticks_of``) to the next
state and the result; on the host, compiled."""


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
    hand = method.hand
    needs = np.array(sorted({*method.needs, *hand.align_indices}))
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
    return AlignedFrame(palm.apply(safe), status, palm.scale)


def packed_result(*parts: Array | np.ndarray | float) -> Array:
    """One array: what the host reads costs by the piece, not by the byte."""
    return jnp.concatenate([jnp.atleast_1d(jnp.asarray(part, jnp.float32)) for part in parts])


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
