"""One solver over one recording, frame after frame, each frame begun at the answer to the last."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.lab.benchmark.latency import Watch
from smooth_operator.metrics.joints import joint_acceleration, joint_jitter
from smooth_operator.objective.loss import Objective
from smooth_operator.objective.terms import FrameGoal
from smooth_operator.solvers.random_words import frame_key, seed_words
from smooth_operator_research.paper.compared_solvers import (
    CompiledSolver,
    Slsqp,
    Solver,
    slsqp_objective,
    soft_mean,
)
from smooth_operator_research.paper.problems import Problem

CHUNK: Final = 20
"""Frames in one call of a program: few enough that Ctrl-C is heard and a bar moves."""

Arrays = dict[str, np.ndarray]
Advance = Callable[[float], None]
"""Called with the share of a cell that was done since the last call."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a solver did on a problem.

    Attributes:
        q: (T, m) its answers [rad].
        frame_ms: (C,) time a frame, one number for each call of the program [ms].
        evaluations: (T,) iterations or evaluations of each frame.
        others: share of the cores that other processes took meanwhile; NaN where unknown.
    """

    q: Float[np.ndarray, "T m"]
    frame_ms: Float[np.ndarray, " C"]
    evaluations: Float[np.ndarray, " T"]
    others: float

    @staticmethod
    def of(arrays: Arrays) -> Run:
        """From a kept cell."""
        return Run(arrays["q"], arrays["frame_ms"], arrays["evaluations"], float(arrays["others"]))

    def arrays(self) -> Arrays:
        """For a kept cell."""
        return {
            "q": self.q,
            "frame_ms": self.frame_ms,
            "evaluations": self.evaluations,
            "others": np.array(self.others),
        }


def measure_run(problem: Problem, run: Run, velocity_weight: float) -> dict[str, float]:
    """Figures of a run.

    Returns:
        ``loss``: mean tracking loss, the first term of Eq. (1); ``cost``: mean of all of it;
        ``jitter``: mean |second difference| of the joint positions [rad], coupled joints included;
        ``acceleration``: the same over time squared [rad/s²]; ``frame_ms``: median time a frame;
        ``evaluations``: mean.
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
    """A solver over a recording.

    Args:
        problem: the recording.
        solver: the solver.
        velocity_weight: w_v; the objective's own is not looked at.
        seed: of its random numbers, where it has any.
        advance: called with the share that was done.
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
    """A program, and whether it was compiled already."""

    run: Callable[..., Any]
    warm: bool = False


@lru_cache(maxsize=32)
def _program(objective: Objective, solver: CompiledSolver) -> _Program:
    """Some frames as one compiled program, the same for all values of the knobs."""

    def program(q: Array, frames: Any, weight: Array, words: Array, knobs: Array) -> Any:
        def frame(q: Array, frame_data: tuple[Array, Array, Array]) -> Any:
            vectors, weights, at = frame_data
            goal = FrameGoal(vectors, weights, q, weight)
            pose, spent = solver.solve(objective, goal, q, frame_key(words, at), knobs)
            # an answer that is no number is none: the last one is held
            pose = jnp.where(jnp.isfinite(pose).all(), pose, q)
            return pose, (pose, spent)

        return jax.lax.scan(frame, q, frames)[1]

    return _Program(compiled(program))


@lru_cache(maxsize=16)
def _evaluation(objective: Objective) -> Callable[..., Array]:
    return compiled(slsqp_objective(objective))


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
        ]  # fmt: skip
        costs = np.array([result.value for result in results])
        if np.isfinite(costs).any():  # or the last answer is held
            q = soft_mean(np.stack([r.x for r in results], axis=-1), costs, starts.temperature)
        times.append(time.perf_counter() - started)
        poses.append(q)
        evaluations.append(float(np.mean([result.evaluations for result in results])))
        advance(1 / len(problem))
    return np.stack(poses), np.array(times), np.array(evaluations)
