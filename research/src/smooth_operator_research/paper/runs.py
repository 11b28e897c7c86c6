"""Minimisation problems from recordings, and runs of a solver that starts each frame at the last
solution.

A problem has the targets of every frame, computed once for all solvers.

The latches of DexPilot's targets depend on the human hand only, so targets and weights are the same
for all solvers; only the start of a frame, the solution of the previous one, differs.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.metrics.joints import joint_acceleration, joint_jitter
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.sbr.newton import newton_minimise
from smooth_operator.retargeting.sbr.published import ObjectiveConfig
from smooth_operator.retargeting.sbr.random_numbers import frame_key, seed_words
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.sbr.sampling import SamplingConfig, sample_minimise
from smooth_operator.retargeting.targets import Targets
from smooth_operator_benchmark.quality import Watch
from smooth_operator_benchmark.recordings import Source
from smooth_operator_research.paper.compared_solvers import (
    NEWTON_CONFIG,
    CompiledSolver,
    Slsqp,
    Solver,
    slsqp_objective,
    soft_mean,
)

FEWEST_FRAMES: Final = 10
"""Smallest number of usable frames for a meaningful jitter."""

_SETTLE_ROUNDS: Final = 6
_SETTLE = SamplingConfig(samples=512, elites=48, cycles=8, sigma=0.4, draws="quasi")


@dataclass(frozen=True, eq=False)
class Problem:
    """A recording as a sequence of minimisations.

    Attributes:
        name: name of the recording.
        unit: the independent unit that it belongs to.
        objective: the minimised objective, with its hand and weights.
        vectors: (T, K, 3) targets [m].
        weights: (T, K) their weights.
        start: (m,) start of every solver: the minimum of the first frame [rad].
        stamps: (T,) times [s].
        frames: the frames of the recording that are used.
    """

    name: str
    unit: str
    objective: SampledObjective
    vectors: Float[np.ndarray, "T K 3"]
    weights: Float[np.ndarray, "T K"]
    start: Float[np.ndarray, " m"]
    stamps: Float[np.ndarray, " T"]
    frames: tuple[int, int]

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def hand(self) -> Hand:
        """The robot hand."""
        return self.objective.hand

    @property
    def rate_hz(self) -> float:
        """Median frame rate [Hz]."""
        return float(1 / np.median(np.diff(self.stamps)))

    @cached_property
    def digest(self) -> str:
        """Digest of everything that the solutions depend on."""
        total = hashlib.sha256(repr((self.objective.config, self.hand.name)).encode())
        for array in (self.vectors, self.weights, self.start, self.stamps, self.hand.limits):
            total.update(np.ascontiguousarray(array, "<f8").tobytes())
        return total.hexdigest()

    def goal(self, t: int, previous: Float[np.ndarray, " m"], velocity_weight: float) -> FrameGoal:
        """Goal of frame t, given the solution of the previous frame."""
        return FrameGoal(
            jnp.asarray(self.vectors[t], jnp.float32),
            jnp.asarray(self.weights[t], jnp.float32),
            jnp.asarray(previous, jnp.float32),
            jnp.float32(velocity_weight),
        )

    def tracking_loss(self, q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        """First term of Eq. (1) at a solution of each frame."""
        layout, hand = self.objective.layout, self.hand
        moving = dict(
            zip(hand.tree.names, np.moveaxis(hand.landmark_positions(q), -2, 0), strict=True)
        )
        keypoints = self.hand.tree.keypoints
        points = [
            moving[name]
            if name in moving
            else np.broadcast_to(keypoints[name].position, (len(q), 3))
            for name in (LANDMARKS[i] for i in layout.landmarks)
        ]
        errors = layout.among(np.stack(points, axis=-2)) - self.vectors
        components = [jnp.asarray(errors[..., c]) for c in range(3)]
        price = self.objective.keyvectors.price
        prices = np.asarray(price(components, jnp.asarray(self.weights)), np.float64)
        return np.asarray(prices.sum(axis=-1))

    def cost(self, q: Float[np.ndarray, "T m"], velocity_weight: float) -> Float[np.ndarray, " T"]:
        """Eq. (1) at a solution of each frame, given the solution before it."""
        before = np.concatenate([self.start[None], q[:-1]])
        goal = FrameGoal(self.vectors, self.weights, before, velocity_weight)
        rest = self.objective.regularisation(np.asarray(q), goal).cost
        return np.asarray(self.tracking_loss(q) + rest)


def make_problems(
    sources: Sequence[Source], hand: str, config: ObjectiveConfig, frames: int
) -> list[Problem]:
    """Makes the problems of the readable recordings.

    Args:
        sources: recordings.
        hand: name of the robot hand.
        frames: largest number of frames of each recording.
    """
    return [make_problem(s, hand, config, frames) for s in sources if s.recording is not None]


def make_problem(source: Source, hand: str, config: ObjectiveConfig, frames: int) -> Problem:
    """Makes the problem of one recording."""
    recording = source.recording
    assert recording is not None  # of a source that could be read
    objective = _objective(hand, recording.side, config)
    aligned = align_recording(recording, objective.hand, AlignmentConfig())
    usable = np.isfinite(aligned[:, list(objective.layout.landmarks)]).all(axis=(1, 2))
    cut = unbroken(usable, frames)
    if cut.stop - cut.start < FEWEST_FRAMES:
        raise RecordingError(
            f"{source.name}: the longest unbroken run of usable frames is "
            f"{cut.stop - cut.start}; an experiment needs {FEWEST_FRAMES}"
        )
    vectors, weights = _targets(objective, aligned[cut])
    first = source.frames[0] if source.frames else 0
    return Problem(
        source.name,
        source.request.unit,
        objective,
        vectors,
        weights,
        _settled(objective, vectors[0], weights[0]),
        np.asarray(recording.stamps[cut], np.float64),
        (first + cut.start, first + cut.stop),
    )


def unbroken(usable: Bool[np.ndarray, " T"], most: int) -> slice:
    """First run of ``most`` usable frames; the longest run if none is that long."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    whole = [run for run in runs if run[1] - run[0] >= most]
    start, stop = whole[0] if whole else max(runs, key=lambda r: r[1] - r[0], default=(0, 0))
    return slice(start, min(stop, start + most))


@lru_cache(maxsize=16)
def _objective(hand: str, side: str, config: ObjectiveConfig) -> SampledObjective:
    """Objective of a hand and configuration; cached, because compiled programs belong to it."""
    return SampledObjective(load_hand(hand, side), config)


def _targets(
    objective: SampledObjective, aligned: Float[np.ndarray, "T 21 3"]
) -> tuple[Float[np.ndarray, "T K 3"], Float[np.ndarray, "T K"]]:
    run = _target_program(objective)
    state = objective.config.targets.init(objective.layout)
    targets = []
    for frame in np.nan_to_num(aligned).astype(np.float32):  # NaN where nothing looks
        (vectors, weights), state = run(frame, state)
        targets.append((np.asarray(vectors), np.asarray(weights)))
    return np.stack([v for v, _ in targets]), np.stack([w for _, w in targets])


def _settled(
    objective: SampledObjective, vectors: Float[np.ndarray, "K 3"], weights: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " m"]:
    """Minimum of the first frame, by repeated wide sampling and descent."""
    run = _settling_program(objective)
    q = jnp.asarray(objective.hand.neutral, jnp.float32)
    for i in range(_SETTLE_ROUNDS):
        goal = FrameGoal(jnp.asarray(vectors), jnp.asarray(weights), q, jnp.float32(0.0))
        q = run(q, frame_key(jnp.asarray(seed_words(0)), jnp.uint32(i)), goal)
    return np.asarray(q, np.float64)


@lru_cache(maxsize=16)
def _target_program(objective: SampledObjective) -> Callable[..., tuple[Targets, Any]]:
    layout, policy = objective.layout, objective.config.targets

    def step(landmarks: Array, state: Any) -> tuple[Targets, Any]:
        return policy(state, layout, layout.human(landmarks))

    return jax.jit(step)


@lru_cache(maxsize=16)
def _settling_program(objective: SampledObjective) -> Callable[..., Array]:
    limits = objective.hand.limits

    def settle(q: Array, key: Array, goal: FrameGoal) -> Array:
        q = sample_minimise(lambda c: objective(c, goal), q, limits, key, _SETTLE)
        return newton_minimise(
            lambda one: objective.value_grad_hess(one, goal), q, limits, NEWTON_CONFIG
        )[0]

    return jax.jit(settle)


CHUNK: Final = 20
"""Frames per call of a program; few, so that Ctrl-C and progress bars respond."""

Arrays = dict[str, np.ndarray]
Advance = Callable[[float], None]
"""Function of the fraction of a cell that was done since the last call."""


@dataclass(frozen=True, eq=False)
class Run:
    """Solutions of a problem by a solver.

    Attributes:
        q: (T, m) the solutions [rad].
        frame_ms: (C,) time per frame, one number for each call of the program [ms].
        evaluations: (T,) iterations or evaluations of each frame.
        others: fraction of the cores that other processes used meanwhile; NaN if unknown.
    """

    q: Float[np.ndarray, "T m"]
    frame_ms: Float[np.ndarray, " C"]
    evaluations: Float[np.ndarray, " T"]
    others: float

    @staticmethod
    def of(arrays: Arrays) -> Run:
        """Restores a run from a stored cell."""
        return Run(**{**arrays, "others": float(arrays["others"])})  # type: ignore[arg-type]

    def arrays(self) -> Arrays:
        """Arrays for a stored cell."""
        return {name: np.asarray(value) for name, value in vars(self).items()}


def measure_run(problem: Problem, run: Run, velocity_weight: float) -> dict[str, float]:
    """Measures a run.

    Returns:
        ``loss``: mean tracking loss, the first term of Eq. (1); ``cost``: mean of all terms;
        ``jitter``: mean |second difference| of the joint positions [rad], coupled joints included;
        ``acceleration``: jitter over time squared [rad/s²]; ``frame_ms``: median time per frame;
        ``evaluations``: mean number of evaluations.
    """
    joints = problem.hand.full_configuration(run.q)
    jitter = joint_jitter(joints)
    acceleration = joint_acceleration(joints, problem.stamps)
    return {
        "loss": float(problem.tracking_loss(run.q).mean()),
        "cost": float(problem.cost(run.q, velocity_weight).mean()),
        "jitter": float("nan") if jitter is None else jitter,
        "acceleration": float("nan") if acceleration is None else acceleration,
        "frame_ms": float(np.median(run.frame_ms)),
        "evaluations": float(run.evaluations.mean()),
    }


def run_solver(
    problem: Problem,
    solver: Solver,
    velocity_weight: float,
    seed: int,
    advance: Advance = lambda share: None,
) -> Run:
    """Runs a solver over a recording.

    Args:
        velocity_weight: w_v, used instead of the objective's own.
        advance: called with the fraction that was done.
    """
    watch = Watch()
    if isinstance(solver, Slsqp):
        q, times, evaluations = _on_host(problem, solver, velocity_weight, seed, advance)
    else:
        assert isinstance(solver, CompiledSolver)  # there is no third kind
        q, times, evaluations = _compiled(problem, solver, velocity_weight, seed, advance)
    others = watch.others()
    return Run(
        np.clip(q, problem.hand.limits[:, 0], problem.hand.limits[:, 1]),  # float32 may round out
        1e3 * times,
        evaluations,
        float("nan") if others is None else others,
    )


def _compiled(
    problem: Problem,
    solver: CompiledSolver,
    velocity_weight: float,
    seed: int,
    advance: Advance,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    program = _program(problem.objective, solver.program_key())
    knobs = jnp.asarray(solver.knobs, jnp.float32)
    weight, words = jnp.float32(velocity_weight), jnp.asarray(seed_words(seed))
    q = jnp.asarray(problem.start, jnp.float32)
    count = len(problem)
    poses, times, evaluations = [], [], []

    def call(first: int, q: Array) -> tuple[np.ndarray, np.ndarray]:
        at = np.arange(first, first + CHUNK)
        inside = np.minimum(at, count - 1)  # what is too much is thrown away
        frames = (
            problem.vectors[inside].astype(np.float32),
            problem.weights[inside].astype(np.float32),
            at.astype(np.uint32),
        )
        rows, spent = program.run(q, frames, weight, words, knobs)
        try:
            return np.asarray(rows), np.asarray(spent)
        except KeyboardInterrupt:
            # waiting was given up, not the work: a process that ends under it crashes
            rows.block_until_ready()
            raise

    if not program.warm:
        call(0, q)  # compiles, which is not in the time
        program.warm = True
    for first in range(0, count, CHUNK):
        started = time.perf_counter()
        rows, spent = call(first, q)
        times.append((time.perf_counter() - started) / CHUNK)
        inside = min(CHUNK, count - first)
        q = jnp.asarray(rows[inside - 1])
        poses.append(rows[:inside].astype(np.float64))
        evaluations.append(spent[:inside].astype(np.float64))
        advance(inside / count)
    return np.concatenate(poses), np.array(times), np.concatenate(evaluations)


@dataclass(eq=False)
class _Program:
    """A program, and a flag for whether it is compiled."""

    run: Callable[..., Any]
    warm: bool = False


@lru_cache(maxsize=32)
def _program(objective: SampledObjective, solver: CompiledSolver) -> _Program:
    """Compiled program for some frames, shared by all values of the knobs."""

    def program(q: Array, frames: Any, weight: Array, words: Array, knobs: Array) -> Any:
        def frame(q: Array, frame_data: tuple[Array, Array, Array]) -> Any:
            vectors, weights, at = frame_data
            goal = FrameGoal(vectors, weights, q, weight)
            pose, spent = solver.solve(objective, goal, q, frame_key(words, at), knobs)
            # an answer that is no number is none: the last one is held
            pose = jnp.where(jnp.isfinite(pose).all(), pose, q)
            return pose, (pose, spent)

        return jax.lax.scan(frame, q, frames)[1]

    return _Program(jax.jit(program))


@lru_cache(maxsize=16)
def _evaluation(objective: SampledObjective) -> Callable[..., Array]:
    return jax.jit(slsqp_objective(objective))


def _on_host(
    problem: Problem, solver: Slsqp, velocity_weight: float, seed: int, advance: Advance
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    evaluate, limits, starts = (
        _evaluation(problem.objective),
        problem.hand.limits,
        solver.starts,
    )
    q = problem.start
    evaluate(q.astype(np.float32), problem.goal(0, q, velocity_weight))  # compiles
    poses, times, evaluations = [], [], []
    for t in range(len(problem)):
        started = time.perf_counter()
        goal = problem.goal(t, q, velocity_weight)
        rng = np.random.default_rng([seed, t])
        moves = starts.spread * rng.standard_normal((starts.count, len(q)))
        moves[0] = 0.0

        def objective(x: np.ndarray, goal: FrameGoal = goal) -> np.ndarray:
            return np.asarray(evaluate(x.astype(np.float32), goal), np.float64)

        results = [
            solver.minimise(objective, np.clip(q + move, limits[:, 0], limits[:, 1]), limits)
            for move in moves
        ]
        costs = np.array([result.value for result in results])
        if np.isfinite(costs).any():  # or the last answer is held
            q = soft_mean(np.stack([r.x for r in results], axis=-1), costs, starts.temperature)
        times.append(time.perf_counter() - started)
        poses.append(q)
        evaluations.append(float(np.mean([result.evaluations for result in results])))
        advance(1 / len(problem))
    return np.stack(poses), np.array(times), np.array(evaluations)
