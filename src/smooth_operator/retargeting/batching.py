"""Retargets many recordings in one compiled program, in parallel lanes of one frame after another.

The program of one frame is small: the call and its many short operations take longer than its
arithmetic. Here each operation covers all lanes (``jax.vmap``), and one call processes a block of
frames. A lane takes one recording after another, each from a fresh state, so recordings of any
length and rate fill it.

The result of a recording depends only on the recording, the retargeter and the number of lanes: not
on the other recordings, their order, or the lane. It equals that of ``Retargeter.run`` except for
rounding, which the solver of ``smooth`` amplifies (docs/reference/methods.md).
"""

from __future__ import annotations

import heapq
import itertools
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, UInt32
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.retargeting.compiled_program import CompiledProgram, ProgramCache
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.retargeting.program import (
    LONGEST_TICKS,
    FrameState,
    RetargetState,
    align_frame,
)
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.types import CommandTrajectory, HandRecording, Status

LANES: Final = 8
"""Number of lanes on a CPU. More lanes save little."""

LANES_GPU: Final = 1024
"""Number of lanes on a GPU."""

BLOCK: Final = 64
"""Frames of each lane in one call of the program."""

Progress: TypeAlias = Callable[[Iterable[int]], Iterable[int]]
"""Wraps an iteration over frames, for a progress bar."""


def ticks_of(stamps: Float[ArrayLike, "*R T"]) -> UInt32[np.ndarray, "*R T"]:
    """Converts (..., T) timestamps [s] to frame times for the program (see ``tick_after``)."""
    whole = np.round(np.nan_to_num(np.asarray(stamps, float), posinf=0.0, neginf=0.0) * 1e6)
    passed = np.diff(whole, axis=-1, prepend=whole[..., :1])
    ticks = whole[..., :1] + np.cumsum(np.clip(passed, -1, LONGEST_TICKS), axis=-1)
    return np.asarray(np.mod(ticks, 2.0**32)).astype(np.uint32)


@dataclass(frozen=True, eq=False)
class Tracks:
    """Input of the program: the frames of all recordings, one recording after another.

    Attributes:
        landmarks: (S, 21, 3) float32 [m].
        valid: (S, 21) True for known landmarks.
        ticks: (S,) timestamps in microseconds modulo 2^32.
        lengths: number of frames of each recording; their sum is S.
    """

    landmarks: Float[np.ndarray, "S 21 3"]
    valid: np.ndarray
    ticks: np.ndarray
    lengths: Sequence[int]

    @classmethod
    def of(
        cls, recordings: Sequence[HandRecording], landmarks: Callable[[np.ndarray], np.ndarray]
    ) -> Tracks:
        """Joins recordings; ``landmarks`` converts landmarks to the program's form."""
        if not recordings:
            none = np.empty((0, NUM_LANDMARKS, 3), np.float32)
            return cls(none, none[..., 0] > 0, np.empty(0, np.uint32), [])
        points, valid, stamps = (
            np.concatenate([getattr(recording, name) for recording in recordings], dtype=kind)
            for name, kind in (("landmarks", None), ("valid", bool), ("stamps", float))
        )
        return cls(landmarks(points), valid, ticks_of(stamps), list(map(len, recordings)))

    @cached_property
    def starts(self) -> np.ndarray:
        """(S,) True for the first frame of each recording."""
        starts = np.zeros(len(self.ticks), bool)
        starts[[part.start for part in self.slices if part.stop > part.start]] = True
        return starts

    @property
    def slices(self) -> list[slice]:
        """The frames of each recording."""
        ends = np.cumsum([0, *self.lengths]).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]


@dataclass(frozen=True, eq=False)
class BatchArrays:
    """Result of ``BatchRetargeter.batch_arrays``.

    Attributes:
        q: (R, T, m) float32 commands of the actuated joints, within their limits [rad];
            ``Hand.full_configuration`` gives the positions of all joints.
        status: (R, T) ``Status`` values.
        tracking_loss: (R, T) tracking losses; NaN where a command was held.
    """

    q: Float[np.ndarray, "R T m"]
    status: np.ndarray
    tracking_loss: Float[np.ndarray, "R T"]


def progressing(total: int, track: Progress | None) -> Callable[[int], None]:
    """Returns a function that advances a progress bar of ``total`` frames by a number of frames.
    It does nothing if ``track`` is None."""
    steps, left = iter(range(total) if track is None else track(range(total))), total

    def advance(count: int) -> None:
        nonlocal left
        if track is None:
            return
        left -= count
        for _ in range(count + (left == 0)):  # one more at the end, so that the bar ends
            next(steps, None)

    return advance


class LaneProgram:
    """Compiled program for one method, one hand and a number of lanes. It is compiled at its first
    call.

    Args:
        method: a method that is one compiled program.
        config: its configuration.
        lanes: number of lanes.
        threads: number of calls of the program in parallel.
        cache: keeps traced programs, as for ``Retargeter``.
    """

    def __init__(
        self,
        method: Method,
        config: MethodConfig,
        lanes: int,
        threads: int = 1,
        cache: ProgramCache | None = None,
    ) -> None:
        self.method, self.lanes, self.threads = method, lanes, threads
        alignment = config.alignment

        def align(landmarks: Any, valid: Any) -> Any:
            frame = align_frame(method, alignment, landmarks, valid)
            return frame.aligned, frame.status

        def block(
            initial: Any, state: Any, landmarks: Any, valid: Any, ticks: Any, new: Any
        ) -> Any:
            # The alignment of a frame does not need the previous frame.
            flat = [x.reshape(-1, *x.shape[2:]) for x in (landmarks, valid)]
            aligned, status = jax.vmap(align)(*flat)
            aligned, status = aligned.reshape(landmarks.shape), status.reshape(ticks.shape)

            def frame(state: Any, now: Any) -> Any:
                points, status, ticks, new = now
                state = _chosen(new, initial, state)
                active = status == Status.OK
                # A loop runs until its slowest lane ends, so a lane without a hand repeats the work
                # of a lane that has a hand.
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
            cache=cache,
            graphs=True,
        )

    def run(
        self, initial: RetargetState, tracks: Tracks, track: Progress | None = None
    ) -> tuple[Float[np.ndarray, "S m"], np.ndarray, Float[np.ndarray, " S"]]:
        """Returns, for all frames, commands of the actuated joints [rad] that are not clipped to
        the limits, ``Status`` values and tracking losses. Each recording starts from the same
        state."""
        total = len(tracks.ticks)
        # the last row takes the results of lanes without a recording
        q = np.empty((total + 1, len(initial.trees.q)), np.float32)
        status, loss = np.empty(total + 1, np.int8), np.empty(total + 1, np.float32)
        advance, lock, ended = progressing(total, track), threading.Lock(), threading.Event()

        def store(at: np.ndarray, parts: tuple[Any, ...]) -> None:
            q[at], status[at], loss[at] = (np.asarray(part) for part in parts)
            with lock:
                advance(int(np.count_nonzero(at < total)))

        columns = _frames_of_lanes(tracks, self.lanes * self.threads)
        with ThreadPoolExecutor(self.threads) as threads:
            runs = [
                threads.submit(self._run_lanes, initial, tracks, frames, store, ended)
                for frames in np.split(columns, self.threads, axis=1)
            ]
            try:
                for each in runs:
                    each.result()
            finally:
                ended.set()  # after an error or an interrupt, all threads stop
        return q[:-1], status[:-1], loss[:-1]

    def _run_lanes(
        self,
        initial: RetargetState,
        tracks: Tracks,
        frames: np.ndarray,
        store: Callable[[np.ndarray, tuple[Any, ...]], None],
        ended: threading.Event,
    ) -> None:
        """Runs the (B, lanes) frames of one thread. While the device computes a block, another
        thread prepares the next block and stores the results of the previous one."""
        blocks = [frames[at : at + BLOCK] for at in range(0, len(frames), BLOCK)]
        state = start = jax.tree.map(self._everywhere, initial.trees)
        with ThreadPoolExecutor(1) as thread:
            stored: list[Future[None]] = []
            filled = [thread.submit(_filled, tracks, block) for block in blocks[:1]]
            for block, next in itertools.zip_longest(blocks, blocks[1:]):
                if ended.is_set():
                    return
                inputs = filled.pop().result()
                if next is not None:
                    filled.append(thread.submit(_filled, tracks, next))
                state, parts = self._block(start, state, *inputs)
                stored.append(thread.submit(store, block, parts))
                if len(stored) > 1:
                    stored.pop(0).result()
            for each in stored:
                each.result()

    def run_arrays(
        self,
        initial: RetargetState,
        landmarks: Float[np.ndarray, "R T 21 3"],
        stamps: Float[np.ndarray, "R T"] | Float[np.ndarray, " T"],
        limits: Float[np.ndarray, "m 2"],
        prepared: Callable[[np.ndarray], np.ndarray],
    ) -> BatchArrays:
        """Does the work of ``BatchRetargeter.batch_arrays``; ``prepared`` converts landmarks to the
        data type and side that the compiled program takes."""
        count, length = np.shape(landmarks)[:2] if np.ndim(landmarks) == 4 else (-1, -1)
        if np.shape(landmarks) != (count, length, NUM_LANDMARKS, 3):
            raise RecordingError(f"landmarks must be (R, T, 21, 3), not {np.shape(landmarks)}")
        if np.shape(stamps) not in ((length,), (count, length)):
            raise RecordingError(
                f"stamps must be (R, T) or (T,), as {count} recordings of {length} frames have "
                f"them, not {np.shape(stamps)}"
            )
        ticks = np.broadcast_to(ticks_of(stamps), (count, length)).reshape(-1)
        points = prepared(np.asarray(landmarks).reshape(-1, NUM_LANDMARKS, 3))
        all_valid = np.ones((len(ticks), NUM_LANDMARKS), bool)
        q, status, loss = self.run(initial, Tracks(points, all_valid, ticks, [length] * count))
        low, high = limits.T.astype(np.float32)
        q = np.clip(q, low, high, out=q).reshape(count, length, len(low))
        loss = np.where(status == Status.OK, loss, np.float32(np.nan))
        return BatchArrays(q, status.reshape(count, length), loss.reshape(count, length))

    def _everywhere(self, leaf: Any) -> jax.Array:
        one = jnp.asarray(leaf)
        # The program's results are on a named device. Other inputs would compile it once more.
        placed: jax.Array = jax.device_put(
            jnp.broadcast_to(one, (self.lanes, *one.shape)), one.device
        )
        return placed


def _chosen(which: Bool[Array, " L"], new: Any, old: Any) -> Any:
    """Takes new values in some lanes and old values in the others; lanes are the first axis."""

    def one(a: Array, b: Array) -> Array:
        return jnp.where(which.reshape(-1, *[1] * (b.ndim - 1)), a, b)

    return jax.tree.map(one, new, old)


def _frames_of_lanes(tracks: Tracks, lanes: int) -> np.ndarray:
    """(B, lanes) index of the frame of each lane at each time; S where a lane has none. B is a
    multiple of ``BLOCK``."""
    queues, slices = _shared_out(tracks.lengths, lanes), tracks.slices
    length = max((sum(tracks.lengths[i] for i in queue) for queue in queues), default=0)
    rows = -(-length // BLOCK) * BLOCK
    frames = np.full((lanes, rows), len(tracks.ticks), np.int64)
    for lane, queue in enumerate(queues):
        first = 0
        for which in queue:
            part = slices[which]
            last = first + part.stop - part.start
            frames[lane, first:last] = np.arange(part.start, part.stop)
            first = last
    return np.ascontiguousarray(frames.T)


def _shared_out(lengths: Sequence[int], lanes: int) -> list[list[int]]:
    """Assigns recordings to lanes, the longest first, each to the lane that ends first."""
    queues: list[list[int]] = [[] for _ in range(lanes)]
    ends = [(0, lane) for lane in range(lanes)]
    for which in sorted(range(len(lengths)), key=lambda i: (-lengths[i], i)):
        filled, lane = ends[0]
        queues[lane].append(which)
        heapq.heapreplace(ends, (filled + lengths[which], lane))
    return queues


def _filled(tracks: Tracks, block: np.ndarray) -> tuple[np.ndarray, ...]:
    """Inputs of a block. Lanes without a frame get no valid landmarks."""
    there = block < len(tracks.ticks)
    at = np.where(there, block, 0)
    valid = tracks.valid[at] & there[..., None]
    return tracks.landmarks[at], valid, tracks.ticks[at], tracks.starts[at] & there


def lane_counts(method: Method, lanes: int | None) -> tuple[int, int]:
    """Returns the number of lanes and the number of parallel calls. If ``lanes`` is None, they suit
    the device."""
    if jax.default_backend() != "cpu":
        return lanes or LANES_GPU, 1
    if method.uneven:
        # a worker of a pool has only one core
        own = multiprocessing.parent_process() is not None
        return 1, lanes or (1 if own else os.cpu_count() or 1)
    return lanes or LANES, 1


class BatchRetargeter(Retargeter):
    """A ``Retargeter`` that also retargets many recordings at once."""

    def batch(
        self,
        recordings: Sequence[HandRecording],
        *,
        seed: int | None = None,
        track: Progress | None = None,
        lanes: int | None = None,
    ) -> list[tuple[CommandTrajectory, Float[np.ndarray, " T"]]]:
        """Retargets recordings of any length in parallel in one program, each starting from a fresh
        state.

        A result equals that of ``run`` except for rounding and for latencies, which are NaN. It
        does not depend on the other recordings. Methods with a solver on the host run in turn.

        Args:
            recordings: recordings of the retargeter's side; the other side raises ``ConfigError``.
            seed: random seed of each recording; None for the retargeter's own.
            track: wraps the iteration over all frames, for a progress bar.
            lanes: number of recordings in parallel. Default: 1024 on a GPU and 8 on a CPU, or one
                per core for methods like ``smooth`` whose solver time varies between frames.
        """
        for recording in recordings:
            self.check_side(recording.side)
        if self.method.on_host:
            return self._one_by_one(recordings, seed, track)
        tracks = Tracks.of(recordings, self.program_landmarks)
        q, statuses, loss = self._lanes(lanes).run(self.init(seed), tracks, track)
        q = np.clip(q.astype(float), *self.hand.limits.T)
        loss = np.where(statuses == Status.OK, loss.astype(float), np.nan)
        batch = []
        for recording, part in zip(recordings, tracks.slices, strict=True):
            none, positions = np.full(len(recording), np.nan), self.hand.full_configuration(q[part])
            commands = CommandTrajectory(
                positions, self.hand.joint_names, recording.stamps, none, statuses[part]
            )
            batch.append((commands, loss[part]))
        return batch

    def _one_by_one(
        self, recordings: Sequence[HandRecording], seed: int | None, track: Progress | None
    ) -> list[tuple[CommandTrajectory, Float[np.ndarray, " T"]]]:
        """``batch`` for a method whose solver runs on the host."""
        advance = progressing(sum(map(len, recordings)), track)
        batch = []
        for recording in recordings:
            commands, loss = self.run(recording, seed=seed)
            batch.append((replace(commands, latency_ms=np.full(len(commands), np.nan)), loss))
            advance(len(recording))
        return batch

    def batch_arrays(
        self,
        landmarks: Float[np.ndarray, "R T 21 3"],
        stamps: Float[np.ndarray, "R T"] | Float[np.ndarray, " T"],
        *,
        seed: int | None = None,
        lanes: int | None = None,
    ) -> BatchArrays:
        """Retargets recordings that are stored in one array. Works like ``batch``, without creating
        objects.

        On a GPU, ``batch`` spends half of its time on objects. Unknown landmarks are NaN, and so
        are the missing frames at the end of shorter recordings.

        Args:
            landmarks: (R, T, 21, 3) of R hands of the retargeter's side [m]; float32 avoids copies.
            stamps: (R, T) timestamps of the frames [s], or (T,) for all recordings.
            seed: random seed of each recording; None for the retargeter's own.
            lanes: number of recordings in parallel. Default: 1024 on a GPU and 8 on a CPU, or one
                per core for methods like ``smooth`` whose solver time varies between frames.

        Returns:
            commands of the actuated joints, status and tracking loss of every frame.

        Raises:
            RecordingError: an array has the wrong shape.
            ConfigError: the method's solver runs on the host.
        """
        if self.method.on_host:
            raise ConfigError("this method's solver runs on the host, frame by frame: use batch()")
        program = self._lanes(lanes)
        return program.run_arrays(
            self.init(seed), landmarks, stamps, self.hand.limits, self.program_landmarks
        )

    def _lanes(self, lanes: int | None) -> LaneProgram:
        count, threads = lane_counts(self.method, lanes)
        if (count, threads) not in self.shared.lanes:
            self.shared.lanes[count, threads] = LaneProgram(
                self.method, self.config, count, threads, self.cache
            )
        program: LaneProgram = self.shared.lanes[count, threads]
        return program
