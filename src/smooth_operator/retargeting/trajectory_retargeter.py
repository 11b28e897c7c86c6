"""Retargets a recording as a whole, so that the result is smooth and has no lag.

The frame-by-frame method selects the basin. From its results, all frames are solved together
(``trajectory_solver``), with the cost of each frame and of the motion between frames. A frame
without a usable hand has no cost of its own: in a short gap it takes the cheapest motion, in a
longer gap the last pose is held. The status tells these frames apart.

A long stretch is solved in windows. Each window begins where the previous one ended and looks
further ahead than the cost of motion acts, so that time is proportional to the length of the
recording, and memory grows only with the stored frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.differential import PointKinematics
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS, WRIST
from smooth_operator.retargeting.batching import BatchRetargeter, Progress, progressing
from smooth_operator.retargeting.compiled_program import CompiledProgram, ProgramCache
from smooth_operator.retargeting.known_gaps import NO_GAPS
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.retargeting.objective import TRANSITION, FrameGoal, Objective
from smooth_operator.retargeting.pinch_gaps import PinchGapEstimate, PinchGapState
from smooth_operator.retargeting.program import LONGEST_GAP, FrameClock, align_frame
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.retargeting.trajectory_solver import (
    JOINED,
    ExtraTerms,
    FrameBlocks,
    Led,
    smooth_trajectory,
)
from smooth_operator.types import CommandTrajectory, HandRecording, Status

WINDOW: Final = 2048
"""Number of frames that are solved together."""
AHEAD_S: Final = 2.0
"""Lookahead beyond a window [s]."""
CHUNK: Final = 256
"""Frames in one call of a compiled program."""


class TrajectoryRetargeter:
    """Retargets whole recordings onto one robot hand.

    Args:
        hand: the robot hand.
        config: settings.
        seed: seed of the method's random numbers.
        pinch_gaps: known gaps, as for ``Retargeter``.
        cache: keeps traced programs, as for ``Retargeter``.

    Raises:
        ConfigError: the method can't be solved for a whole recording.
    """

    def __init__(
        self,
        hand: Hand,
        config: TrajectoryMethodConfig,
        seed: int = 0,
        pinch_gaps: Mapping[str, float] | None = NO_GAPS,
        cache: ProgramCache | None = None,
    ) -> None:
        self.hand, self.config, self.seed = hand, config, seed
        self.causal = BatchRetargeter(
            hand, config=config.causal, seed=seed, pinch_gaps=pinch_gaps, cache=cache
        )
        method = self.causal.shared.method  # that of the mirror image for hands described as one
        objective, alignment = _objective(method), config.alignment
        tips = np.array([TIPS[FINGERS.index(finger)] for finger in method.hand.fingers])
        self._targets_at_first = objective.config.targets.init(objective.layout)

        def aligned(landmarks: Array, valid: Array) -> Array:
            return jax.vmap(lambda *frame: align_frame(method, alignment, *frame).aligned)(
                landmarks, valid
            )

        closing = PinchGapEstimate(method.hand)

        def closed(
            state: PinchGapState, points: Array, dt: Array, usable: Array
        ) -> tuple[PinchGapState, Array]:
            def one(
                state: PinchGapState, frame: tuple[Array, Array, Array]
            ) -> tuple[PinchGapState, Array]:
                points, dt, usable = frame
                after, points = closing.step(state, points, FrameClock(dt, dt > LONGEST_GAP))
                return jax.tree.map(lambda a, b: jnp.where(usable, a, b), after, state), points

            return jax.lax.scan(one, state, (points, dt, usable))

        def follow(
            memory: Any, points: Array, usable: Array
        ) -> tuple[Any, tuple[FrameGoal, Array]]:
            def one(memory: Any, frame: tuple[Array, Array]) -> tuple[Any, tuple[FrameGoal, Array]]:
                points, usable = frame
                after, goal = goal_alone(objective, memory, points)
                after = jax.tree.map(lambda new, old: jnp.where(usable, new, old), after, memory)
                return after, (goal, points[tips] - points[WRIST])

            return jax.lax.scan(one, memory, (points, usable))

        def costs(q: Array, goal: FrameGoal, valid: Array) -> tuple[Array, Array, Array, Array]:
            cost, gradient, hessian = jax.vmap(objective.value_grad_hess)(q, goal)
            tracking = cost - jax.vmap(objective.regularisation)(q, goal).cost
            return (
                jnp.where(valid, cost, 0.0),
                jnp.where(valid[:, None], gradient, 0.0),
                jnp.where(valid[:, None, None], hessian, 0.0),
                tracking,
            )

        def points(q: Array) -> tuple[Array, Array]:
            at, jacobian = jax.vmap(lambda one: fingertips(method.hand, one))(q)
            count = at.shape[1] * 3
            return at.reshape(len(q), count), jacobian.reshape(len(q), count, -1)

        self._aligned, self._closed, self._follow, self._costs, self._points = (
            CompiledProgram(
                f, "recording", f.__name__, hand=method.hand, config=config.causal, cache=cache
            )
            for f in (aligned, closed, follow, costs, points)
        )

    def warm_up(self) -> float:
        """Compiles the frame-by-frame program, and returns the time that it took [s]."""
        return self.causal.warm_up()

    def run(
        self,
        recording: HandRecording,
        *,
        seed: int | None = None,
        track: Progress | None = None,
        extra: ExtraTerms | None = None,
    ) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
        """Retargets a whole recording.

        Args:
            seed: seed of the random numbers; None for the retargeter's own.
            track: wraps the iteration over frames, for a progress bar.
            extra: further costs and variables of each frame.

        Returns:
            the commands, whose latencies are NaN, and the (T,) tracking loss of each frame (NaN for
            frames without a usable hand).
        """
        ((first, _),) = self.causal.batch([recording], seed=seed)
        return self._whole(recording, first, progressing(len(recording), track), extra)

    def batch(
        self,
        recordings: Sequence[HandRecording],
        *,
        seed: int | None = None,
        track: Progress | None = None,
    ) -> list[tuple[CommandTrajectory, Float[np.ndarray, " T"]]]:
        """Retargets recordings frame by frame in parallel, then solves each one as a whole.

        The results equal those of ``run`` bit for bit.

        Args:
            recordings: human hands of the retargeter's side.
            seed: random seed of each recording; None for the retargeter's own.
            track: wraps the iteration over all frames, for a progress bar.
        """
        firsts = self.causal.batch(recordings, seed=seed)
        advance = progressing(sum(map(len, recordings)), track)
        return [
            self._whole(recording, first, advance, None)
            for recording, (first, _) in zip(recordings, firsts, strict=True)
        ]

    def _whole(
        self,
        recording: HandRecording,
        first: CommandTrajectory,
        advance: Callable[[int], None],
        extra: ExtraTerms | None,
    ) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
        """Solves one recording, from its frame-by-frame commands."""
        count, hand = len(recording), self.hand
        valid = first.status == Status.OK
        q, limits = np.asarray(first.joint_positions)[:, list(hand.actuated)], hand.limits
        neutral, joints = hand.neutral, len(hand.limits)
        if extra is not None:
            q = np.concatenate([q, extra.start], axis=1)
            limits = np.concatenate([limits, extra.limits])
            neutral = np.concatenate([neutral, np.zeros(len(extra.limits))])
        stretches = segments(valid, recording.stamps, self.config.bridge)
        goals, reaches = self._goals(recording, valid, stretches)
        loss = np.full(count, np.nan)
        done = 0
        for stretch in stretches:
            for keep, poses, tracking in self._solved(
                recording, stretch, q, limits, (goals, reaches), valid, extra
            ):
                q[keep], loss[keep] = poses, tracking
                advance(keep.stop - done)
                done = keep.stop
        advance(count - done)
        hold(q, stretches, neutral)
        q = np.clip(q, limits[:, 0], limits[:, 1])
        if extra is not None:
            extra.settle(q[:, joints:])
            q = q[:, :joints]
        commands = CommandTrajectory(
            hand.full_configuration(q),
            hand.joint_names,
            recording.stamps,
            np.full(count, np.nan),
            first.status,
        )
        return commands, np.where(valid, loss, np.nan)

    def _goals(
        self, recording: HandRecording, tracked: Bool[np.ndarray, " T"], stretches: list[slice]
    ) -> tuple[FrameGoal, Float[np.ndarray, "T F 3"]]:
        """Targets of each frame, and the human's vectors from wrist to fingertips [m]."""
        landmarks, valid = self.causal.program_landmarks(recording.landmarks), recording.valid
        assert valid is not None  # filled in on construction
        count = len(recording)
        chunks = [slice(start, start + CHUNK) for start in range(0, count, CHUNK)]
        aligned = [
            np.asarray(self._aligned(_filled(landmarks[part]), _filled(valid[part])))
            for part in chunks
        ]
        method = self.causal.shared.method
        if method.pinch_gaps(method.init(self.seed)) is not None:
            dt = np.diff(recording.stamps, prepend=recording.stamps[0] - 1.0).astype(np.float32)
            state = PinchGapState.of(method.hand.fingers, self.causal.known_gaps)
            for i, part in enumerate(chunks):
                frames = aligned[i], _filled(dt[part]), _filled(tracked[part])
                state, points = self._closed(state, *frames)
                aligned[i] = np.asarray(points)
        points = np.concatenate(aligned)[:count]
        needs = list(method.needs)
        for stretch in stretches:
            noise = tracker_noise(points[stretch][:, needs], tracked[stretch])
            jump = self.config.jump + self.config.noise * noise
            points[stretch] = without_jumps(points[stretch], tracked[stretch], jump)
        memory, parts = self._targets_at_first, []
        for part in chunks:
            memory, goal = self._follow(memory, _filled(points[part]), _filled(tracked[part]))
            parts.append(goal)
        goals, reaches = jax.tree.map(lambda values: values[:count], _stacked(parts))
        return goals, reaches

    def _solved(
        self,
        recording: HandRecording,
        stretch: slice,
        start: Float[np.ndarray, "T v"],
        limits: Float[np.ndarray, "v 2"],
        problem: tuple[FrameGoal, Float[np.ndarray, "T F 3"]],
        valid: Bool[np.ndarray, " T"],
        extra: ExtraTerms | None,
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Yields the frames of each solved window, their poses and their tracking losses."""
        stamps = even_stamps(recording.stamps[stretch])
        period = stamps[1] if len(stamps) > 1 else 1.0
        ahead = int(np.ceil(AHEAD_S / period)) if period > 0 else 0
        settled = np.empty((0, start.shape[1]))
        goals, reaches = problem
        joints, more = len(self.hand.limits), len(limits) - len(self.hand.limits)
        for begin, keep, end in windows(len(stamps), WINDOW, ahead):
            previous = settled[-JOINED:]
            before = begin - len(previous)
            part = slice(stretch.start + before, stretch.start + end)
            window_goals = jax.tree.map(lambda values, part=part: values[part], goals)
            guess = np.concatenate([previous, start[part][len(previous) :]])
            tracking = np.empty(0)

            def costs(
                q: np.ndarray, own: FrameGoal = window_goals, part: slice = part
            ) -> FrameBlocks:
                nonlocal tracking
                *blocks, tracking = self._all_costs(q[:, :joints], own, valid[part])
                if extra is None:
                    return blocks[0], blocks[1], blocks[2]
                widths = ((0, 0), (0, more), (0, more))
                wide = [np.pad(v, widths[: v.ndim]) for v in blocks]
                added = extra.costs(q, part)
                return wide[0] + added[0], wide[1] + added[1], wide[2] + added[2]

            led = self._led(reaches[part], stamps[before:end], valid[part])
            trajectory = smooth_trajectory(
                costs,
                guess,
                stamps[before:end],
                limits,
                self.config.future,
                len(previous),
                led,
            ).q
            costs(trajectory)
            new = slice(len(previous), len(previous) + keep - begin)
            settled = trajectory[: new.stop]
            at = slice(stretch.start + begin, stretch.start + keep)
            yield at, trajectory[new], tracking[new]

    def _led(
        self,
        reaches: Float[np.ndarray, "T F 3"],
        stamps: Float[np.ndarray, " T"],
        valid: Bool[np.ndarray, " T"],
    ) -> Led | None:
        """Cost of fingertip motion that differs from the human's, between two valid frames."""
        future = self.config.future
        if not future.motion_weight or len(stamps) < 2:
            return None
        steps, period = np.diff(reaches, axis=0), np.diff(stamps)
        weights = future.motion_weight / (TRANSITION * period**2)
        weights = np.repeat(weights[:, None], steps.shape[1], axis=1)
        if future.motion_speed:
            speed = np.linalg.norm(steps, axis=-1) / period[:, None]
            weights = weights / (1 + (speed / future.motion_speed) ** 2)
        weights = np.where((valid[1:] & valid[:-1])[:, None], weights, 0.0)

        def points(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            joints = len(self.hand.limits)
            q, more = x[:, :joints], x.shape[1] - joints
            parts = [
                self._points(_filled(q[at : at + CHUNK].astype(np.float32)))
                for at in range(0, len(q), CHUNK)
            ]
            at, jacobian = (
                np.concatenate([np.asarray(p, np.float64) for p in column])[: len(q)]
                for column in zip(*parts, strict=True)
            )
            return at, np.pad(jacobian, ((0, 0), (0, 0), (0, more))) if more else jacobian

        return Led(points, steps.reshape(len(steps), -1), np.repeat(weights, 3, axis=1))

    def _all_costs(
        self, q: np.ndarray, goals: FrameGoal, valid: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        parts = []
        for start in range(0, len(q), CHUNK):
            part = slice(start, start + CHUNK)
            goal = jax.tree.map(lambda values, part=part: _filled(values[part]), goals)
            parts.append(
                self._costs(_filled(q[part].astype(np.float32)), goal, _filled(valid[part]))
            )
        cost, gradient, hessian, tracking = (
            np.concatenate([np.asarray(p, np.float64) for p in column])[: len(q)]
            for column in zip(*parts, strict=True)
        )
        return cost, gradient, hessian, tracking


def check_method(config: MethodConfig, hand: Hand) -> None:
    """Checks that a method can be used with a hand, frame by frame or for whole recordings;
    SmoothOperatorError with the reason if it can't be used."""
    if isinstance(config, TrajectoryMethodConfig):
        _objective(config.causal.build(hand))
    else:
        config.build(hand)


def _objective(method: Method) -> Objective:
    objective = method.trajectory_objective
    if objective is None:
        raise ConfigError(
            f"{type(method).__name__} can't be solved for a whole recording; sbr and smooth can"
        )
    return objective


def goal_alone(
    objective: Objective, memory: Any, aligned: Float[Array, "21 3"]
) -> tuple[Any, FrameGoal]:
    """Returns the target policy's state after a frame, and the frame's goal without the terms that
    depend on the last command; traceable.

    Args:
        memory: state of the target policy before the frame.
        aligned: (21, 3) landmarks in the palm frame [m].
    """
    hand, layout = objective.hand, objective.layout
    targets, memory = objective.config.targets(memory, layout, layout.human(aligned))
    neutral = jnp.asarray(hand.neutral, aligned.dtype)
    none = jnp.zeros((), aligned.dtype)
    tips = jnp.zeros((len(hand.fingers), 3), aligned.dtype)
    goal = FrameGoal(targets.vectors, targets.weights, neutral, none, tips, tips[:, 0])
    return memory, goal


def joint_motion(
    hand: Hand, q: Float[Array, " m"]
) -> tuple[Float[Array, " n"], Float[Array, "n m"]]:
    """Positions of all joints [rad], and their derivatives with respect to the actuated joints;
    traceable."""
    transmission = hand.transmission
    matrix, offset = (
        jnp.asarray(part, q.dtype) for part in (transmission.matrix, transmission.offset)
    )
    linear = matrix @ q + offset
    if not transmission.curves:
        return linear, matrix
    return transmission.curved(linear), transmission.curved(linear, 1)[:, None] * matrix


def fingertips(
    hand: Hand, q: Float[Array, " m"]
) -> tuple[Float[Array, "F 3"], Float[Array, "F 3 m"]]:
    """Fingertips at a pose [m], and their derivatives with respect to the joints [m/rad];
    traceable."""
    joints, slopes = joint_motion(hand, q)
    kinematics = PointKinematics(hand.tree, hand.tip_names)
    motion = kinematics(joints)
    spread = slopes[np.array(kinematics.order)]
    return motion.points, jnp.einsum("fjc,jm->fcm", kinematics.jacobian(motion), spread)


def _stacked(goals: list[FrameGoal]) -> FrameGoal:
    """Joins the goals of several calls along the frames, as NumPy arrays."""
    joined: FrameGoal = jax.tree.map(
        lambda *parts: np.concatenate([np.asarray(p) for p in parts]), *goals
    )
    return joined


def _filled(values: np.ndarray) -> np.ndarray:
    """Repeats the last frame up to a whole chunk, because a program has one shape."""
    lacking = CHUNK - len(values)
    return np.concatenate([values, np.repeat(values[-1:], lacking, axis=0)]) if lacking else values


def even_stamps(stamps: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Rounds times to an even grid of the median period, starting at 0 [s]; lost frames leave gaps.

    The clock of a tracker jitters although its frames are evenly spaced, and so would derivatives.

    Args:
        stamps: (T,) strictly increasing times [s].
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    steps = np.diff(stamps)
    period = float(np.median(steps))
    return np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / period), 1.0))]) * period


def segments(
    valid: Bool[np.ndarray, " T"], stamps: Float[np.ndarray, " T"], bridge: float
) -> list[slice]:
    """Splits frames at long gaps into segments that begin and end with a valid frame.

    Args:
        valid: (T,) True for frames with a usable hand.
        stamps: (T,) times [s].
        bridge: longest gap within a stretch [s].
    """
    at = np.flatnonzero(valid)
    if not len(at):
        return []
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    # half a period of tolerance, so that rounding has no effect
    cuts = np.flatnonzero(np.diff(stamps[at]) > bridge + 1.5 * period)
    starts, ends = [0, *(cuts + 1)], [*cuts, len(at) - 1]
    return [slice(int(at[i]), int(at[j]) + 1) for i, j in zip(starts, ends, strict=True)]


def tracker_noise(points: Float[np.ndarray, "T N 3"], valid: Bool[np.ndarray, " T"]) -> float:
    """Estimates the usual noise of a tracker in the second difference of a point [m].

    It is the median over the points of a frame, and over time the squared mean of square roots,
    which single large errors hardly change.

    Args:
        points: (T, N, 3) [m].
        valid: (T,) True for frames that count; three in a row are necessary.
    """
    usable = valid[2:] & valid[1:-1] & valid[:-2]
    if not usable.any():
        return 0.0
    bend = np.linalg.norm(points[2:] - 2 * points[1:-1] + points[:-2], axis=-1)[usable]
    return float(np.sqrt(np.median(bend, axis=1)).mean() ** 2)


def without_jumps(
    points: Float[np.ndarray, "T N 3"], valid: Bool[np.ndarray, " T"], jump: float
) -> Float[np.ndarray, "T N 3"]:
    """Removes jumps from the motion of points, without delay.

    The points are filtered forwards and backwards in time, and the mean is used. Each filter
    follows only a fraction of a step, which falls with its length. Steady motion is as late in one
    direction as it is early in the other; a jump is spread over the frames before and after it.

    Args:
        points: (T, N, 3) [m].
        valid: (T,) True for frames that count; the others are not changed.
        jump: length of a step of which half is followed in a frame [m]; 0 follows all.
    """
    at = np.flatnonzero(valid)
    if not jump or len(at) < 2:
        return points
    followed = np.zeros((2, *points.shape))
    for k, order in enumerate((at, at[::-1])):
        last = points[order[0]].astype(np.float64)
        for t in order:
            step = points[t] - last
            size = np.sqrt((step * step).sum(axis=-1, keepdims=True))
            last = last + step / (1.0 + size / jump)
            followed[k, t] = last
    out = points.copy()
    out[at] = followed.mean(axis=0)[at]
    return out


def windows(count: int, size: int, ahead: int) -> list[tuple[int, int, int]]:
    """Splits a segment of frames into windows: (first frame, end of the result, end of the
    lookahead)."""
    parts = []
    for start in range(0, max(count, 1), size):
        keep = min(start + size, count)
        if count - keep <= ahead:  # a short rest belongs to this window
            keep = count
        parts.append((start, keep, min(keep + ahead, count)))
        if keep == count:
            break
    return parts


def hold(
    q: Float[np.ndarray, "T m"], stretches: list[slice], neutral: Float[np.ndarray, " m"]
) -> None:
    """Fills the frames outside segments: the neutral pose before the first, and the last pose
    after."""
    last, done = neutral, 0
    for stretch in [*stretches, slice(len(q), len(q))]:
        q[done : stretch.start] = last
        if stretch.stop > stretch.start:
            last, done = q[stretch.stop - 1], stretch.stop
