"""Many recordings in one compiled program: side by side in lanes, and frame after frame in time.

A frame alone is a small program: entering it and its many short operations takes longer than its
arithmetic. Here one operation is that of all lanes (``jax.vmap``), and a call of the program is a
block of frames. A lane takes one recording after another, each from a
fresh state, so recordings of any length fill it; times between frames are each recording's own.

A recording's result depends on nothing but the recording, the retargeter and the number of lanes:
not on the other recordings, their order, or the lane. It is that of ``Retargeter.run`` but for
rounding.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from smooth_operator.compilation.compiled_program import CompiledProgram
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.methods.method import Method, MethodConfig
from smooth_operator.methods.program import align_frame, ticks_of
from smooth_operator.methods.state import FrameState, RetargetState
from smooth_operator.types import CommandTrajectory, HandRecording, Status

LANES: Final = 8
"""Lanes on a CPU. More save little, and a step takes as long as the lane that takes longest."""

LANES_GPU: Final = 1024
"""Lanes on a GPU."""

BLOCK: Final = 64
"""Frames of each lane in a call of the program."""

Progress: TypeAlias = Callable[[Iterable[int]], Iterable[int]]
"""Wraps an iteration over frames, for a progress bar."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What came of one recording.

    Attributes:
        q: (T, m) commands of the actuated joints [rad], as the program gave them.
        status: (T,) ``Status`` values.
        loss: (T,) tracking losses.
    """

    q: Float[np.ndarray, "T m"]
    status: np.ndarray
    loss: Float[np.ndarray, " T"]

    def trajectory(
        self, hand: Hand, recording: HandRecording
    ) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
        """Commands of a recording, and the (T,) tracking losses; NaN where a command was held."""
        none = np.full(len(recording), np.nan)
        q = np.clip(self.q.astype(float), hand.limits[:, 0], hand.limits[:, 1])
        full = hand.full_configuration(q)
        commands = CommandTrajectory(full, hand.joint_names, recording.stamps, none, self.status)
        return commands, np.where(self.status == Status.OK, self.loss.astype(float), np.nan)


@dataclass(frozen=True, eq=False)
class Track:
    """One recording as the program takes it.

    Attributes:
        landmarks: (T, 21, 3) float32 [m].
        valid: (T, 21) which of them are known.
        ticks: (T,) stamps in microseconds modulo 2^32.
    """

    landmarks: Float[np.ndarray, "T 21 3"]
    valid: np.ndarray
    ticks: np.ndarray

    @classmethod
    def of(cls, recording: HandRecording, landmarks: Float[np.ndarray, "T 21 3"]) -> Track:
        """A recording with its landmarks as the program takes them."""
        assert recording.valid is not None  # filled in on construction
        return cls(landmarks, recording.valid, ticks_of(recording.stamps))


def progressing(total: int, track: Progress | None) -> Callable[[int], None]:
    """A function that moves a progress bar by so many frames.

    Args:
        total: how many there are.
        track: wraps the iteration over them; None for no bar.
    """
    steps, left = iter(range(total) if track is None else track(range(total))), total

    def advance(count: int) -> None:
        nonlocal left
        left -= count
        for _ in range(count + (left == 0)):  # once more at the end, so that a bar knows it
            next(steps, None)

    return advance


def default_lanes() -> int:
    """Lanes that suit JAX's default device."""
    return LANES if jax.default_backend() == "cpu" else LANES_GPU


class LaneProgram:
    """The program of one method and hand for a number of lanes; it compiles when first called.

    Args:
        method: a method that is one compiled program.
        config: its configuration.
        lanes: how many.
        cached: the program is read from the user's cache, and written there.
    """

    def __init__(
        self, method: Method, config: MethodConfig, lanes: int, cached: bool = True
    ) -> None:
        self.method, self.lanes = method, lanes
        alignment = config.alignment

        def align(landmarks: Any, valid: Any) -> Any:
            frame = align_frame(method, alignment, landmarks, valid)
            return frame.aligned, frame.status

        def block(
            initial: Any, state: Any, landmarks: Any, valid: Any, ticks: Any, new: Any
        ) -> Any:
            # All frames are aligned side by side, since none needs the one before it.
            flat = [x.reshape(-1, *x.shape[2:]) for x in (landmarks, valid)]
            aligned, status = jax.vmap(align)(*flat)
            aligned, status = aligned.reshape(landmarks.shape), status.reshape(ticks.shape)

            def frame(state: Any, now: Any) -> Any:
                points, status, ticks, new = now
                state = _chosen(new, initial, state)
                active = status == Status.OK
                # A lane without a hand repeats the work of one that has a hand, since a loop takes
                # as many turns as the lane that needs most.
                which = jnp.where(active, jnp.arange(lanes), jnp.argmax(active))
                work = jax.tree.map(lambda leaf: leaf[which], (state.method, points, ticks))

                def solved() -> tuple[FrameState, Array]:
                    after, output = jax.vmap(method.step)(*work)
                    return FrameState(after, output.q), jnp.asarray(
                        output.tracking_loss, jnp.float32
                    )

                after, loss = lax.cond(
                    active.any(), solved, lambda: (state, jnp.zeros(lanes, jnp.float32))
                )
                failed = active & ~jnp.isfinite(after.q).all(axis=1)
                status = jnp.where(failed, int(Status.SOLVER_FAILED), status)
                state = _chosen(status == Status.OK, after, state)
                return state, (state.q, status.astype(jnp.int8), loss)

            return lax.scan(frame, state, (aligned, status, ticks, new))

        self._block = CompiledProgram(
            block,
            "lanes",
            lanes,
            BLOCK,
            hand=method.hand,
            config=config,
            constants=method.constants,
            cached=cached,
        )

    def run(
        self, initial: RetargetState, tracks: Sequence[Track], track: Progress | None = None
    ) -> list[Answers]:
        """Every recording, each from the same state.

        Args:
            initial: the state before a first frame.
            tracks: the recordings.
            track: wraps the iteration over all frames, for a progress bar.

        Returns:
            the answers, in the order of the recordings.
        """
        start = jax.tree.map(self._everywhere, initial.trees)
        answers = [self._empty(len(one.ticks), initial) for one in tracks]
        queues = _shared_out([len(one.ticks) for one in tracks], self.lanes)
        length = max((sum(len(tracks[i].ticks) for i in queue) for queue in queues), default=0)
        advance = progressing(sum(len(one.ticks) for one in tracks), track)
        state = start
        for begin in range(0, length, BLOCK):
            taken = list(_pieces(queues, tracks, begin, begin + BLOCK))
            state, (q, status, loss) = self._block(start, state, *self._filled(tracks, taken))
            q, status, loss = (np.asarray(each) for each in (q, status, loss))
            for lane, which, source, at in taken:
                answers[which].q[source] = q[at, lane]
                answers[which].status[source] = status[at, lane]
                answers[which].loss[source] = loss[at, lane]
                advance(source.stop - source.start)
        return answers

    def _everywhere(self, leaf: Any) -> jax.Array:
        one = jnp.asarray(leaf)
        # On a device by name, as the program's results are: otherwise it is compiled for both.
        placed: jax.Array = jax.device_put(
            jnp.broadcast_to(one, (self.lanes, *one.shape)), one.device
        )
        return placed

    def _empty(self, count: int, initial: RetargetState) -> Answers:
        size = len(initial.q)
        q, loss = (np.empty(shape, np.float32) for shape in ((count, size), count))
        return Answers(q, np.empty(count, np.int8), loss)

    def _filled(self, tracks: Sequence[Track], taken: Sequence[Piece]) -> tuple[np.ndarray, ...]:
        """The inputs of a block; lanes that have nothing left see no hand."""
        shape = (BLOCK, self.lanes, NUM_LANDMARKS, 3)
        landmarks = np.full(shape, np.nan, np.float32)
        valid = np.zeros((BLOCK, self.lanes, NUM_LANDMARKS), bool)
        ticks = np.zeros((BLOCK, self.lanes), np.uint32)
        new = np.zeros((BLOCK, self.lanes), bool)
        for lane, which, source, at in taken:
            landmarks[at, lane] = tracks[which].landmarks[source]
            valid[at, lane] = tracks[which].valid[source]
            ticks[at, lane] = tracks[which].ticks[source]
            new[at.start, lane] |= source.start == 0
        return landmarks, valid, ticks, new


Piece: TypeAlias = tuple[int, int, slice, slice]
"""A lane, a recording, frames of it, and where they are in a block."""


def _chosen(which: Bool[Array, " L"], new: Any, old: Any) -> Any:
    """New values in some lanes, old ones in the others; trees of arrays with the lanes first."""

    def one(a: Array, b: Array) -> Array:
        return jnp.where(which.reshape(-1, *[1] * (b.ndim - 1)), a, b)

    return jax.tree.map(one, new, old)


def _shared_out(lengths: Sequence[int], lanes: int) -> list[list[int]]:
    """Which recordings each lane takes: the longest first, to the lane that ends first."""
    queues: list[list[int]] = [[] for _ in range(lanes)]
    filled = [0] * lanes
    for which in sorted(range(len(lengths)), key=lambda i: (-lengths[i], i)):
        lane = filled.index(min(filled))
        queues[lane].append(which)
        filled[lane] += lengths[which]
    return queues


def _pieces(
    queues: Sequence[Sequence[int]], tracks: Sequence[Track], begin: int, end: int
) -> Iterable[Piece]:
    """What the lanes hold between two places of their queues."""
    for lane, queue in enumerate(queues):
        first = 0
        for which in queue:
            last = first + len(tracks[which].ticks)
            low, high = max(first, begin), min(last, end)
            if low < high:
                yield (
                    lane,
                    which,
                    slice(low - first, high - first),
                    slice(low - begin, high - begin),
                )
            first = last


_KEPT: Final = 8
_programs: Final[OrderedDict[tuple[int, AlignmentConfig, int, bool], LaneProgram]] = OrderedDict()
_lock: Final = threading.Lock()


def lane_program(
    method: Method, config: MethodConfig, lanes: int | None, cached: bool = True
) -> LaneProgram:
    """The program of a method, kept a while; None for the number of lanes that suits the device."""
    count = lanes or default_lanes()
    key = (id(method), config.alignment, count, cached)  # a kept program keeps its method
    with _lock:
        made = _programs.get(key) or LaneProgram(method, config, count, cached)
        _programs[key] = made
        _programs.move_to_end(key)
        while len(_programs) > _KEPT:
            _programs.popitem(last=False)
    return made
