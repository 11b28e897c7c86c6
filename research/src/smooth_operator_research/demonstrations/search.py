r"""Makes a demonstration of a task for a robot hand, by search in physics.

    python -m smooth_operator_research.demonstrations.search allegro_hand cube --output cube.json

The first guess are the key poses of another hand, by fingertip inverse kinematics, or those of a
file. Separable CMA-ES then moves the key poses of thumb, index and middle finger and the times
between them. Candidates are judged by how far they get in the unperturbed world and in perturbed
ones, other ones in each generation: the object's pose, friction and mass differ, and the joints are
off as if a retargeter followed an operator with other bones and a noisy tracker. Self-penetration
of the commanded poses counts against a candidate. The seeds are not those of the benchmark's
worlds. The search goes on where it stopped if its file ``--state`` exists.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import StudyError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.parallel import PersistentPool
from smooth_operator_research.demonstrations.demonstration import (
    DEFAULT_HAND,
    Demonstration,
    demonstration_text,
    load_demonstration,
    read_demonstration,
)
from smooth_operator_research.demonstrations.evolution import Evolution
from smooth_operator_research.demonstrations.judging import MARGIN, Candidate, World, judge
from smooth_operator_research.demonstrations.seed import FINGERS, transferred

WORLDS_SEED: Final = 1000
"""Of the worlds that the search sees; the benchmark's have others."""

FINAL_SEED: Final = 2000
"""Of the worlds by which the last few candidates are compared."""

_SIGMA: Final = 0.06  # first standard deviation of a joint in a key pose [rad]
_PACE: Final = 2.0  # of the logarithm of a duration, against a radian of a joint
_FASTEST: Final = 0.5  # least and most factor of a duration, against the first guess
_ENOUGH: Final = 0.5  # share of the margin in the centre's merit at which little is left to gain
_MEMORY: Final = 0.8  # of the centre's merit from generation to generation: worlds differ
_KEPT: Final = 4  # candidates that are compared in the end, besides the centre
_FIRST: Final = 0.4  # share of the worlds in which all candidates are judged
_OBJECTS: Final = 32  # worlds that differ in object, friction and mass
_FINAL_WORLDS: Final = 32

_Pool = PersistentPool[Candidate, list[float]]


def _joints_of(hand: Hand) -> list[int]:
    """The actuated joints that move thumb, index or middle finger."""
    index = [hand.fingers.index(name) for name in FINGERS if name in hand.fingers]
    poses = hand.neutral + 0.01 * np.eye(len(hand.neutral))
    moved = hand.tips(hand.full_configuration(poses)) - hand.tips(
        hand.full_configuration(hand.neutral)
    )
    return [int(k) for k in np.flatnonzero(np.abs(moved[:, index]).max(axis=(1, 2)) > 1e-6)]


def _worlds(generation: int, count: int, seed: int) -> tuple[World, ...]:
    """The unperturbed world and others; objects come again, operators don't."""
    numbers = generation * count + np.arange(count)
    others = (World(seed, 1 + int(n) % _OBJECTS, 1 + int(n)) for n in numbers)
    return (World(seed, 0), *others)


class Search:
    """A search for one demonstration.

    Args:
        first: the first guess.
        worlds: perturbed worlds of a generation.
        seed: of the random numbers.
        count: candidates in a generation.
        sigma: first standard deviation of a joint in a key pose [rad].
        share: of the operators' errors that counts.
        filtered: whether noise is removed from them; see ``joint_errors``.
        margin: what a success with the best margin is worth more than one with none.

    Attributes:
        state: of the evolution.
        best: the best demonstrations so far with their merits, best first.
        merit: of the centre of the last generations, on average.
        enough: that merit, at which little is left to gain.
    """

    def __init__(
        self, first: Demonstration, worlds: int, seed: int, count: int,
        sigma: float = _SIGMA, share: float = 1.0, filtered: bool = False, margin: float = MARGIN,
    ) -> None:  # fmt: skip
        hand = first.robot
        self._hand, self._worlds, self._errors = hand, worlds, (share, filtered, margin)
        self.enough = 1.0 + _ENOUGH * margin
        self._free = _joints_of(hand)
        self.best: list[tuple[float, Demonstration]] = []
        self.merit = -np.inf
        paces = np.zeros(len(first.times) - 1)
        point = np.concatenate([first.poses[1:, self._free].ravel(), paces])
        self.state = Evolution.begin(point, sigma, seed, count)
        self._base = first

    def generation(self, pool: _Pool) -> None:
        """Judge a generation; the first candidate is its centre.

        All are judged in some worlds, the better half of them and the centre in all.

        Raises:
            StudyError: a candidate can't be judged.
        """
        points = self.state.candidates()
        points[0] = self.state.mean
        candidates = [self._of(point) for point in points]
        worlds = _worlds(self.state.generation, self._worlds, WORLDS_SEED)
        now = max(2, round(_FIRST * len(worlds)))
        centre = demonstration_text(candidates[0])
        early = self._judged(pool, candidates, worlds[:now], centre)
        half = np.argsort(-early.mean(axis=1), kind="stable")[: len(candidates) // 2]
        again = sorted({0, *half.tolist()})
        late = self._judged(pool, [candidates[k] for k in again], worlds[now:], centre)
        whole = np.concatenate([early[again], late], axis=1).mean(axis=1)
        merits = early.mean(axis=1) - 10.0  # behind all that were judged in all worlds
        merits[half] = whole[np.searchsorted(again, half)]
        before = self.merit if np.isfinite(self.merit) else float(whole[0])
        self.merit = _MEMORY * before + (1.0 - _MEMORY) * float(whole[0])
        self.state = self.state.judged(points, merits)
        better = [(float(value), candidates[k]) for k, value in zip(again, whole, strict=True)]
        self.best = sorted([*self.best, *better], key=lambda one: -one[0])[:_KEPT]

    def result(self, pool: _Pool) -> tuple[Demonstration, float]:
        """The best of the few best and the centre, in worlds that the search has not seen.

        Returns:
            it, and its merit there.
        """
        last = [self._of(self.state.mean), *(demonstration for _, demonstration in self.best)]
        worlds = _worlds(0, _FINAL_WORLDS, FINAL_SEED)
        merits = self._judged(pool, last, worlds, demonstration_text(last[0])).mean(axis=1)
        top = int(np.argmax(merits))
        return last[top], float(merits[top])

    def _judged(
        self, pool: _Pool, candidates: list[Demonstration], worlds: tuple[World, ...], centre: str
    ) -> Float[np.ndarray, "c w"]:
        values = np.zeros((len(candidates), len(worlds)))
        tasks = [Candidate(one, worlds, centre, *self._errors) for one in candidates]
        for result in pool.run(tasks):
            if result.value is None:
                raise StudyError(f"a candidate can't be judged: {result.error}")
            values[result.index] = result.value
        return values

    def _of(self, point: Float[np.ndarray, " n"]) -> Demonstration:
        base = self._base
        count = len(base.times) - 1
        poses = base.poses.copy()
        poses[1:, self._free] = point[:-count].reshape(count, -1)
        poses = np.clip(poses, self._hand.limits[:, 0], self._hand.limits[:, 1])
        pace = np.clip(np.exp(_PACE * point[-count:]), _FASTEST, 1.0 / _FASTEST)
        times = np.concatenate([[0.0], np.cumsum(np.diff(base.times) * pace)])
        return replace(base, poses=np.round(poses, 3), times=np.round(times, 2))

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


def _first(name: str, task: str, hand: str) -> Demonstration:
    """The first guess from a file, or from a hand that has a demonstration."""
    if name.endswith(".json"):
        demonstration = read_demonstration(Path(name).read_text(encoding="utf-8"))
        if demonstration.task != task:
            raise StudyError(f"{name} demonstrates task {demonstration.task!r}, not {task!r}")
    else:
        demonstration = load_demonstration(task, name)
    return (
        demonstration if demonstration.hand == hand else transferred(demonstration, load_hand(hand))
    )


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("hand", help="name of the robot hand")
    parser.add_argument("task", help="card, cube or screwdriver")
    parser.add_argument("--output", type=Path, required=True, help="JSON file of the result")
    parser.add_argument(
        "--first", default=DEFAULT_HAND,
        help="first guess: a hand with a demonstration, or the JSON file of one",
    )  # fmt: skip
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--candidates", type=int, default=16, help="in a generation")
    parser.add_argument("--worlds", type=int, default=8, help="perturbed worlds of a generation")
    parser.add_argument("--sigma", type=float, default=_SIGMA, help="first step [rad]")
    parser.add_argument(
        "--errors", type=float, default=1.0, help="share of the operators' errors; 0: none"
    )
    parser.add_argument(
        "--filtered", action="store_true",
        help="remove the noise from those errors as smooth does",
    )  # fmt: skip
    parser.add_argument(
        "--margin", type=float, default=MARGIN,
        help="what a success with the best margin is worth more than one with none",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=None, help="processes; 0: none")
    parser.add_argument("--state", type=Path, help="file to resume from, and to go on writing")
    options = parser.parse_args(arguments)
    search = Search(
        _first(options.first, options.task, options.hand),
        options.worlds, options.seed, options.candidates,
        options.sigma, options.errors, options.filtered, options.margin,
    )  # fmt: skip
    if options.state is not None and options.state.exists():
        search.resume(options.state)
    with PersistentPool(judge, options.workers) as pool:
        while search.state.generation < options.generations and search.merit < search.enough:
            search.generation(pool)
            print(
                f"{options.hand} {options.task}: generation {search.state.generation}, merit: "
                "centre "
                f"{search.merit:.3f}, best {search.best[0][0]:.3f}; step "
                f"{search.state.sigma:.3f} rad",
                flush=True,
            )
            if options.state is not None:
                search.save(options.state)
        best, value = search.result(pool)
    print(f"{options.hand} {options.task}: merit {value:.3f} in {_FINAL_WORLDS} unseen worlds")
    with atomic_write(options.output) as file:
        file.write(demonstration_text(best).encode())


if __name__ == "__main__":
    main()
