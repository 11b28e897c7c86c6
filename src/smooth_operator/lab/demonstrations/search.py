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
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
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

FINAL_SEED: Final = 2000
"""Of the worlds by which the last few candidates are compared."""

_SIGMA: Final = 0.06  # first standard deviation of a joint in a key pose [rad]
_OFF: Final = 0.015  # standard deviation by which a joint is off in a perturbed world [rad]
_ENOUGH: Final = 1.95  # merit of the centre at which little is left to gain
_KEPT: Final = 4  # candidates that are compared in the end, besides the centre
_FINAL_WORLDS: Final = 16


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a worker judges.

    Attributes:
        demonstration: the key poses.
        worlds: how many perturbed worlds it has to do, if it does the unperturbed one.
        seed: of those.
    """

    demonstration: Demonstration
    worlds: int
    seed: int = WORLDS_SEED


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
    rng = np.random.default_rng(candidate.seed)
    others = [
        tried(
            demonstration,
            draw_perturbation(number, candidate.seed),
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


def _merits(
    pool: PersistentPool[Candidate, float], tasks: list[Candidate]
) -> Float[np.ndarray, " c"]:
    merits = np.zeros(len(tasks))
    for result in pool.run(tasks):
        if result.value is None:
            raise StudyError(f"a candidate can't be judged: {result.error}")
        merits[result.index] = result.value
    return merits


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
        best: the best demonstrations so far with their merits, best first.
        merit: of the centre of the last generation.
    """

    def __init__(
        self, first: Demonstration, worlds: int, seed: int, count: int, sigma: float = _SIGMA
    ) -> None:
        hand = first.robot
        self._hand, self._worlds = hand, worlds
        self._free = _joints_of(hand)
        self.best: list[tuple[float, Demonstration]] = []
        self.merit = -np.inf
        self.state = Evolution.begin(first.poses[1:, self._free].ravel(), sigma, seed, count)
        self._base = first

    def generation(self, pool: PersistentPool[Candidate, float]) -> None:
        """Judge a generation; the first candidate is its centre.

        Raises:
            StudyError: a candidate can't be judged.
        """
        points = self.state.candidates()
        points[0] = self.state.mean
        demonstrations = [self._of(point) for point in points]
        merits = _merits(pool, [Candidate(one, self._worlds) for one in demonstrations])
        self.state = self.state.judged(points, merits)
        found = [*self.best, *zip(merits.tolist(), demonstrations, strict=True)]
        self.best = sorted(found, key=lambda one: -one[0])[:_KEPT]
        self.merit = float(merits[0])

    def result(self, pool: PersistentPool[Candidate, float]) -> tuple[Demonstration, float]:
        """The best of the few best and the centre, in worlds that the search has not seen.

        Returns:
            it, and its merit there.
        """
        last = [demonstration for _, demonstration in self.best]
        last.append(self._of(self.state.mean))
        merits = _merits(pool, [Candidate(one, _FINAL_WORLDS, FINAL_SEED) for one in last])
        top = int(np.argmax(merits))
        return last[top], float(merits[top])

    def _of(self, point: Float[np.ndarray, " n"]) -> Demonstration:
        poses = self._base.poses.copy()
        poses[1:, self._free] = point.reshape(len(poses) - 1, -1)
        poses = np.clip(poses, self._hand.limits[:, 0], self._hand.limits[:, 1])
        return replace(self._base, poses=np.round(poses, 3))

    def save(self, path: Path) -> None:
        """Write where the search is."""
        content = {
            "first": demonstration_text(self._base),
            "best": [[merit, demonstration_text(one)] for merit, one in self.best],
            "merit": self.merit,
            "state": self.state.to_json(),
        }
        with atomic_write(path) as file:
            file.write(json.dumps(content).encode())

    def resume(self, path: Path) -> None:
        """Go on from what ``save`` wrote."""
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        self._base = read_demonstration(content["first"])
        self.best = [(float(merit), read_demonstration(text)) for merit, text in content["best"]]
        self.merit = float(content["merit"])
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
                f"{given.hand} {given.task}: generation {search.state.generation}, merit: centre "
                f"{search.merit:.3f}, best {search.best[0][0]:.3f}; step "
                f"{search.state.sigma:.3f} rad",
                flush=True,
            )
            if given.state is not None:
                search.save(given.state)
        found, value = search.result(pool)
    print(f"{given.hand} {given.task}: merit {value:.3f} in {_FINAL_WORLDS} unseen worlds")
    with atomic_write(given.output) as file:
        file.write(demonstration_text(found).encode())


if __name__ == "__main__":
    main()
