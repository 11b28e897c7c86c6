r"""Makes a demonstration of a task for a robot hand, by search in physics.

    python -m smooth_operator.lab.demonstrations.search allegro_hand cube --output cube.json

The first guess are the key poses of another hand, by fingertip inverse kinematics. Separable CMA-ES
then moves the key poses of thumb, index and middle finger. A candidate is first judged in the
unperturbed world by how far it gets; one that succeeds there is judged in perturbed worlds as well,
in which the object's pose, friction and mass differ and every joint is a little off. Their seed is
not that of the benchmark's worlds. The search goes on where it stopped if its file ``--state``
exists.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.io.atomic import atomic_write
from smooth_operator.lab.demonstrations.evolution import Evolution
from smooth_operator.lab.demonstrations.progress import progress
from smooth_operator.lab.demonstrations.seed import FINGERS, transferred
from smooth_operator.parallel import PersistentPool
from smooth_operator.simulation.scenes import Scene, ScenePhysics, scene_for
from smooth_operator.simulation.tasks.demonstration import (
    DEFAULT_HAND,
    PERIOD_S,
    Demonstration,
    demonstration_text,
    load_demonstration,
    read_demonstration,
)
from smooth_operator.simulation.tasks.perturbation import Perturbation, draw_perturbation
from smooth_operator.simulation.tasks.task_registry import task_named
from smooth_operator.simulation.tasks.trial_loop import perform
from smooth_operator.types import as_side

WORLDS_SEED: Final = 1000
"""Of the worlds that the search sees; the benchmark's have others."""

_SIGMA: Final = 0.06  # first standard deviation of a joint in a key pose [rad]
_OFF: Final = 0.01  # standard deviation by which a joint is off in a perturbed world [rad]
_ENOUGH: Final = 1.93  # merit at which nothing is left to gain


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a worker judges.

    Attributes:
        demonstration: the key poses.
        worlds: how many perturbed worlds it has to do, if it does the unperturbed one.
    """

    demonstration: Demonstration
    worlds: int


@cache
def _place(task: str, name: str, side: str) -> tuple[Hand, Scene]:
    hand = load_hand(name, as_side(side))
    return hand, scene_for(task, hand)


def tried(
    demonstration: Demonstration, world: Perturbation, off: Float[np.ndarray, " m"] | float = 0.0
) -> float:
    """How far a demonstration gets in a world; see ``progress``.

    Args:
        demonstration: what is done.
        world: with which object; operator and tracker don't matter.
        off: (m,) by how much each actuated joint is off [rad].
    """
    hand, scene = _place(demonstration.task, demonstration.hand, demonstration.side)
    physics = ScenePhysics(hand, world.scene(scene))
    world.prepare(physics)
    task = task_named(demonstration.task)
    moments = list(
        perform(
            physics,
            task,
            lambda time, state, physics: hand.full_configuration(
                demonstration.pose(time + PERIOD_S) + off
            ),
            seconds=float(demonstration.times[-1]),
        )
    )
    return 0.0 if physics.resets else progress(task.name, moments)


def merit(candidate: Candidate) -> float:
    """0 to 1 by how far it gets unperturbed; one that succeeds, 1 to 2.1 by the other worlds."""
    demonstration = candidate.demonstration
    value = tried(demonstration, draw_perturbation(0))
    if value < 1.0:
        return value
    rng = np.random.default_rng(WORLDS_SEED)
    others = [
        tried(
            demonstration,
            draw_perturbation(number, WORLDS_SEED),
            _OFF * rng.standard_normal(demonstration.poses.shape[1]),
        )
        for number in range(1, candidate.worlds + 1)
    ]
    return 1.0 + float(np.mean([value, *others]))


def _joints_of(hand: Hand) -> list[int]:
    """The actuated joints that move thumb, index or middle finger."""
    index = [hand.fingers.index(name) for name in FINGERS if name in hand.fingers]
    poses = hand.neutral + 0.01 * np.eye(len(hand.neutral))
    moved = hand.tips(hand.full_configuration(poses)) - hand.tips(
        hand.full_configuration(hand.neutral)
    )
    return [int(k) for k in np.flatnonzero(np.abs(moved[:, index]).max(axis=(1, 2)) > 1e-6)]


class Search:
    """A search for one demonstration.

    Args:
        first: the first guess.
        worlds: perturbed worlds.
        seed: of the random numbers.
        count: candidates in a generation.
        sigma: first standard deviation of a joint in a key pose [rad].

    Attributes:
        state: of the evolution.
        best: the best demonstration so far.
        merit: its merit.
    """

    def __init__(
        self, first: Demonstration, worlds: int, seed: int, count: int, sigma: float = _SIGMA
    ) -> None:
        hand = load_hand(first.hand, as_side(first.side))
        self._hand, self._worlds = hand, worlds
        self._free = _joints_of(hand)
        self.best, self.merit = first, -np.inf
        self.state = Evolution.begin(first.poses[1:, self._free].ravel(), sigma, seed, count)
        self._base = first

    def generation(self, pool: PersistentPool[Candidate, float]) -> None:
        """Judge a generation; the best so far is in it.

        Raises:
            StudyError: a candidate can't be judged.
        """
        points = self.state.candidates()
        if self.state.generation == 0:
            points[0] = self.state.mean
        demonstrations = [self._of(point) for point in points]
        merits = np.zeros(len(points))
        tasks = [Candidate(one, self._worlds) for one in demonstrations]
        for result in pool.run(tasks):
            if result.value is None:
                raise StudyError(f"a candidate can't be judged: {result.error}")
            merits[result.index] = result.value
        self.state = self.state.judged(points, merits)
        top = int(np.argmax(merits))
        if merits[top] > self.merit:
            self.best, self.merit = demonstrations[top], float(merits[top])

    def _of(self, point: Float[np.ndarray, " n"]) -> Demonstration:
        poses = self._base.poses.copy()
        poses[1:, self._free] = point.reshape(len(poses) - 1, -1)
        poses = np.clip(poses, self._hand.limits[:, 0], self._hand.limits[:, 1])
        return replace(self._base, poses=np.round(poses, 3))

    def save(self, path: Path) -> None:
        """Write where the search is."""
        content = {
            "first": demonstration_text(self._base),
            "best": demonstration_text(self.best),
            "merit": self.merit,
            "state": self.state.to_json(),
        }
        with atomic_write(path) as file:
            file.write(json.dumps(content).encode())

    def resume(self, path: Path) -> None:
        """Go on from what ``save`` wrote."""
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        self._base = read_demonstration(content["first"])
        self.best, self.merit = read_demonstration(content["best"]), float(content["merit"])
        self.state = Evolution.from_json(content["state"])


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("hand", help="name of the robot hand")
    parser.add_argument("task", help="card, cube or screwdriver")
    parser.add_argument("--output", type=Path, required=True, help="JSON file of the result")
    parser.add_argument(
        "--first", default=DEFAULT_HAND, help="hand whose demonstration is the first guess"
    )
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--candidates", type=int, default=16, help="in a generation")
    parser.add_argument("--worlds", type=int, default=4, help="perturbed worlds of a candidate")
    parser.add_argument("--sigma", type=float, default=_SIGMA, help="first step [rad]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=None, help="processes; 0: none")
    parser.add_argument("--state", type=Path, help="file to resume from, and to go on writing")
    given = parser.parse_args(arguments)
    first = load_demonstration(given.task, given.first)
    if given.hand != given.first:
        first = transferred(first, load_hand(given.hand))
    search = Search(first, given.worlds, given.seed, given.candidates, given.sigma)
    if given.state is not None and given.state.exists():
        search.resume(given.state)
    with PersistentPool(merit, given.workers) as pool:
        while search.state.generation < given.generations and search.merit < _ENOUGH:
            search.generation(pool)
            print(
                f"{given.hand} {given.task}: generation {search.state.generation}, "
                f"merit {search.merit:.3f}, step {search.state.sigma:.3f} rad",
                flush=True,
            )
            if given.state is not None:
                search.save(given.state)
            with atomic_write(given.output) as file:
                file.write(demonstration_text(search.best).encode())


if __name__ == "__main__":
    main()
