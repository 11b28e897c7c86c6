"""Number of starts near a solution of the default method that end in one minimum, by Newton steps.

    python research/benchmarks/convergence.py RECORDING --frames 1449 1517 1590
        [--hand allegro_hand] [--starts 60]

The recording is named as for ``smooth-operator bench``. The method runs up to each frame; then the
frame's objective is descended from random starts with a standard deviation of 0.3 rad.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.batching import ticks_of
from smooth_operator.retargeting.levenberg import STILL, damped_newton
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.program import align_frame
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.retargeting.smooth import Smooth, SmoothConfig, frame_limits
from smooth_operator_benchmark.recordings import load_sources, parse_request

SETTINGS: Final = ((6, STILL), (SmoothConfig().iterations, STILL), (500, 1e-5))
"""Iterations, and the step that ends a descent [rad]."""
SPREAD: Final = 0.3
SAME: Final = 0.05  # largest difference of a joint between ends in one minimum [rad]


class Posed(Smooth):
    """``smooth`` that keeps the goal of a frame and does not solve it."""

    goal: FrameGoal

    def solve(self, goal: FrameGoal, *_: Any) -> Any:
        """Returns the last command."""
        self.goal = goal
        return goal.previous


def descent(method: Posed, iterations: int, still: float) -> Callable[..., Any]:
    """Compiles a function from start, state, landmarks, validity and ticks to final pose and
    cost."""

    def run(start: Any, state: Any, landmarks: Any, valid: Any, ticks: Any) -> Any:
        aligned = align_frame(method, method.config.alignment, landmarks, valid).aligned
        method.step(state, aligned, ticks)
        goal = method.goal
        limits = frame_limits(method.hand, goal.vectors[: len(method.hand.fingers)])
        return damped_newton(
            lambda one: method.objective.value_grad_hess(one, goal),
            jnp.clip(start, limits[:, 0], limits[:, 1]),
            limits,
            iterations,
            still,
        )[:2]

    return jax.jit(run)


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a table: settings by frame, starts that end in the best minimum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording")
    parser.add_argument("--frames", type=int, nargs="+", required=True)
    parser.add_argument("--hand", default="allegro_hand")
    parser.add_argument("--starts", type=int, default=60)
    options = parser.parse_args(arguments)
    recording = load_sources([parse_request(options.recording)])[0].recording
    assert recording is not None  # a recording that can't be read is an error before
    hand = load_hand(options.hand)
    config = method_config("smooth")
    assert isinstance(config, SmoothConfig)
    method = Posed(hand, config)
    runs = [descent(method, *settings) for settings in SETTINGS]
    retargeter, rng = Retargeter(hand), np.random.default_rng(0)
    state, rows = retargeter.init(), []
    for number, frame in enumerate(recording[: max(options.frames) + 1]):
        before = state.method
        state, result = retargeter.step(state, frame)
        if number not in options.frames:
            continue
        q = np.asarray(result.command.joint_positions)[list(hand.actuated)]
        noise = rng.normal(0.0, SPREAD, (options.starts, len(hand.limits)))
        starts = np.clip(q + noise, *hand.limits.T).astype(np.float32)
        inputs = (before, np.float32(frame.landmarks), frame.valid, ticks_of([frame.time])[0])
        ends = [[run(start, *inputs) for start in starts] for run in runs]
        poses = np.array([[np.asarray(q) for q, _ in one] for one in ends])
        costs = np.array([[float(cost) for _, cost in one] for one in ends])
        best = poses[np.unravel_index(costs.argmin(), costs.shape)]
        rows.append((np.abs(poses - best).max(axis=-1) < SAME).sum(axis=1))
    print("| iterations | to | " + " | ".join(map(str, sorted(options.frames))) + " |")
    print("|---:|---:|" + "---:|" * len(rows))
    for (iterations, still), *ended in zip(SETTINGS, *rows, strict=True):
        print(f"| {iterations} | {still:g} rad | {' | '.join(map(str, ended))} |")


if __name__ == "__main__":
    main()
