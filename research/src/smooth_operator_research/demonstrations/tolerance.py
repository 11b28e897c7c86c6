r"""How steady a hand must be for a demonstration: success with noise on its own joint positions.

    python -m smooth_operator_research.demonstrations.tolerance mimic_p050 screwdriver --worlds 50

No retargeter takes part. Each actuated joint is off by Gaussian noise of a standard deviation and
correlation time, in worlds in which object, friction and mass differ. What a filter of a tracker's
noise leaves can be held against the table.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.parallel import run_tasks
from smooth_operator_research.demonstrations.demonstration import (
    PERIOD_S,
    Demonstration,
    load_demonstration,
    read_demonstration,
)
from smooth_operator_research.demonstrations.judging import World, tried
from smooth_operator_research.physics.demonstrations import STAYS_S
from smooth_operator_research.run_report import markdown

SIZES: Final = (0.002, 0.004, 0.008)
"""Standard deviations of a joint [rad]."""

TIMES: Final = (0.0, 0.05, 0.2, 1.0)
"""Correlation times [s]; 0 is white noise."""


@dataclass(frozen=True, eq=False)
class Trial:
    """What a worker tries.

    Attributes:
        demonstration: what is done.
        size: standard deviation of each joint [rad].
        time: its correlation time [s].
        world: of object, friction and mass.
        seed: of the noise, and the worlds.
    """

    demonstration: Demonstration
    size: float
    time: float
    world: int
    seed: int


def noise(trial: Trial) -> Float[np.ndarray, "t m"]:
    """(t, m) by how much each actuated joint is off, period by period [rad]."""
    count = int(np.ceil(trial.demonstration.times[-1] / PERIOD_S)) + 1
    rng = np.random.default_rng([trial.seed, trial.world])
    draws = rng.standard_normal((count, trial.demonstration.poses.shape[1]))
    keeps = np.exp(-PERIOD_S / trial.time) if trial.time > 0.0 else 0.0
    for k in range(1, count):
        draws[k] = keeps * draws[k - 1] + np.sqrt(1.0 - keeps**2) * draws[k]
    return trial.size * draws


def succeeds(trial: Trial) -> bool:
    """Whether the trial scores 1."""
    return tried(trial.demonstration, World(trial.seed, trial.world), noise(trial)) >= 1.0


def staying(demonstration: Demonstration, seconds: float = STAYS_S) -> Demonstration:
    """The same, and the last pose held on."""
    return replace(
        demonstration,
        times=np.append(demonstration.times, demonstration.times[-1] + seconds),
        poses=np.concatenate([demonstration.poses, demonstration.poses[-1:]]),
    )


def spread(demonstration: Demonstration, size: float) -> float:
    """Standard deviation of a coordinate of index tip less thumb tip at the last pose [m]."""
    hand = demonstration.robot
    thumb, index = hand.fingers.index("thumb"), hand.fingers.index("index")
    joints = demonstration.poses[-1] + size * np.random.default_rng(0).standard_normal(
        (2000, len(hand.actuated))
    )
    tips = hand.tips(hand.full_configuration(joints))
    return float((tips[:, index] - tips[:, thumb]).std(axis=0).mean())


def table(
    demonstration: Demonstration,
    worlds: int,
    seed: int,
    workers: int | None,
    sizes: Sequence[float] = SIZES,
    times: Sequence[float] = TIMES,
) -> str:
    """Share of successes, a row for each size and a column for each correlation time.

    Raises:
        StudyError: a trial can't be done.
    """
    whole = staying(demonstration)
    cells = [(size, time) for size in sizes for time in times]
    trials = [Trial(whole, *cell, world, seed) for cell in cells for world in range(1, worlds + 1)]
    done = np.zeros(len(trials))
    for count, result in enumerate(run_tasks(succeeds, trials, workers=workers), 1):
        if result.value is None:
            raise StudyError(f"a trial could not be done: {result.error}")
        done[result.index] = result.value
        if sys.stderr.isatty():
            print(f"\r{count} of {len(trials)} trials", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    shares = done.reshape(len(sizes), len(times), worlds).mean(axis=-1)
    head = ["joint [rad]", "index to thumb [mm]", *(f"{1e3 * time:g} ms" for time in times)]
    rows = [
        [f"{size:g}", f"{1e3 * spread(demonstration, size):.2f}", *(f"{x:.2f}" for x in row)]
        for size, row in zip(sizes, shares, strict=True)
    ]
    return markdown(head, rows)


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("hand", help="name of the robot hand")
    parser.add_argument("task", help="card, cube or screwdriver")
    parser.add_argument("--file", type=Path, help="JSON file of another demonstration")
    parser.add_argument("--worlds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=None, help="processes; 0: none")
    options = parser.parse_args(arguments)
    demonstration = (
        load_demonstration(options.task, options.hand)
        if options.file is None
        else read_demonstration(options.file.read_text(encoding="utf-8"))
    )
    print(table(demonstration, options.worlds, options.seed, options.workers))


if __name__ == "__main__":
    main()
