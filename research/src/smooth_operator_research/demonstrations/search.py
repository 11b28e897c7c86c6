r"""Makes a demonstration of a task for a robot hand, by search in physics.

    python -m smooth_operator_research.demonstrations.search allegro_hand cube --output cube.json

The first guess is the key poses of another hand, transferred by inverse kinematics of the
fingertips, or those of a file. Separable CMA-ES (Ros and Hansen, "A Simple Modification in CMA-ES
Achieving Linear Time and Space Complexity", PPSN 2008) then moves the key poses of thumb, index and
middle finger and the times between them. Candidates are judged by how far they get in the
unperturbed world and in perturbed ones, which are new in each generation: the object's pose,
friction and mass differ, and ``smooth`` follows an operator with other bones through one of the
``--trackers``, because people practise with their own tracker. Self-penetration of the poses lowers
a candidate's merit. The seeds are not those of the benchmark's worlds. If the file ``--state``
exists, the search resumes from it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import StudyError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.parallel import PersistentPool
from smooth_operator.simulation.scenes import scene_for
from smooth_operator_research.demonstrations.demonstration import (
    DEFAULT_HAND,
    Demonstration,
    demonstration_text,
    load_demonstration,
    read_demonstration,
)
from smooth_operator_research.demonstrations.judging import MARGIN, Candidate, World, judge


@dataclass(frozen=True, eq=False)
class Evolution:
    """State of a search; immutable.

    Attributes:
        mean: (n,) centre of the candidates.
        sigma: step size.
        variance: (n,) variance of each number, in units of ``sigma``.
        path: (n,) evolution path of the step size.
        path_c: (n,) evolution path of the variances.
        generation: number of generations that have been judged.
        seed: seed of the random numbers.
        count: number of candidates per generation.
    """

    mean: Float[np.ndarray, " n"]
    sigma: float
    variance: Float[np.ndarray, " n"]
    path: Float[np.ndarray, " n"]
    path_c: Float[np.ndarray, " n"]
    generation: int = 0
    seed: int = 0
    count: int = 16

    @classmethod
    def begin(cls, mean: Float[np.ndarray, " n"], sigma: float, seed: int, count: int) -> Self:
        """Starts a search around a point."""
        zero = np.zeros_like(mean)
        return cls(mean, sigma, np.ones_like(mean), zero, zero, 0, seed, count)

    def candidates(self) -> Float[np.ndarray, "c n"]:
        """(c, n) points to judge next; they depend only on the state."""
        rng = np.random.default_rng([self.seed, self.generation])
        draws = rng.standard_normal((self.count, len(self.mean)))
        return np.asarray(self.mean + self.sigma * np.sqrt(self.variance) * draws)

    def judged(self, candidates: Float[np.ndarray, "c n"], merits: Float[np.ndarray, " c"]) -> Self:
        """Returns the next state; higher merit is better."""
        n, half = len(self.mean), self.count // 2
        weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
        weights /= weights.sum()
        mass = 1.0 / (weights**2).sum()
        c_sigma = (mass + 2.0) / (n + mass + 5.0)
        damping = 1.0 + c_sigma + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
        c_c = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
        c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
        c_mu = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
        faster = (n + 2.0) / 3.0  # what a diagonal allows
        c_1, c_mu = min(c_1 * faster, 0.5), min(c_mu * faster, 0.5)
        best = candidates[np.argsort(-merits, kind="stable")[:half]]
        steps = (best - self.mean) / self.sigma
        step = weights @ steps
        path = (1.0 - c_sigma) * self.path + np.sqrt(
            c_sigma * (2.0 - c_sigma) * mass
        ) * step / np.sqrt(self.variance)
        usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
        length = float(np.linalg.norm(path))
        still = length / np.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (self.generation + 1)))
        grows = still < (1.4 + 2.0 / (n + 1.0)) * usual
        path_c = (1.0 - c_c) * self.path_c + grows * np.sqrt(c_c * (2.0 - c_c) * mass) * step
        variance = (
            (1.0 - c_1 - c_mu) * self.variance + c_1 * path_c**2 + c_mu * (weights @ steps**2)
        )
        sigma = self.sigma * float(np.exp(c_sigma / damping * (length / usual - 1.0)))
        return replace(
            self,
            mean=self.mean + self.sigma * step,
            sigma=sigma,
            variance=variance,
            path=path,
            path_c=path_c,
            generation=self.generation + 1,
        )

    def to_json(self) -> dict[str, Any]:
        """Converts to JSON values."""
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Self:
        """Restores the state from ``to_json``."""
        values: dict[str, Any] = {
            name: np.array(value) if isinstance(value, list) else value
            for name, value in content.items()
        }
        return cls(**values)


FINGERS: Final = ("thumb", "index", "middle")
"""The fingers that do the tasks."""

_REST: Final = 0.2  # of a radian from the pose before, against a millimetre of the tips


def transferred(demonstration: Demonstration, hand: Hand) -> Demonstration:
    """Transfers key poses to another hand, whose fingertips move to those of the first hand.

    Positions are relative to the object, because each hand has its own scene with the object within
    its reach. Fingers other than thumb, index and middle finger stay in the neutral pose.
    """
    first = demonstration.robot
    here, there = (scene_for(demonstration.task, one) for one in (first, hand))
    fingers = [name for name in FINGERS if name in hand.fingers and name in first.fingers]
    own = [first.fingers.index(name) for name in fingers]
    tips = first.tips(first.full_configuration(demonstration.poses))[:, own]
    at, turn = here.mount.palm
    against_object = at + tips @ turn.T - here.start[0]
    at, turn = there.mount.palm
    goals = (against_object + there.start[0] - at) @ turn
    poses = [hand.neutral]
    for goal in goals[1:]:
        poses.append(_reach(hand, fingers, goal, poses[-1]))
    return Demonstration(
        demonstration.task, hand.name, hand.spec.side, demonstration.times, np.array(poses)
    )


def _reach(
    hand: Hand,
    fingers: Sequence[str],
    goal: Float[np.ndarray, "f 3"],
    start: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """The pose near ``start`` whose fingertips are nearest to a goal."""
    index = [hand.fingers.index(name) for name in fingers]

    def residuals(pose: Float[np.ndarray, " m"]) -> Float[np.ndarray, " r"]:
        tips = hand.tips(hand.full_configuration(pose))[index] - goal
        return np.concatenate([1e3 * tips.ravel(), _REST * (pose - start)])

    return np.asarray(least_squares(residuals, start, bounds=hand.limits.T).x)


WORLDS_SEED: Final = 1000
"""Seed of the worlds of the search; the benchmark has other seeds."""

FINAL_SEED: Final = 2000
"""Seed of the worlds in which the last few candidates are compared."""

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


def _worlds(generation: int, count: int, seed: int, trackers: Sequence[str]) -> tuple[World, ...]:
    """The unperturbed world and perturbed ones; objects repeat, operators do not."""
    numbers = [int(n) for n in generation * count + np.arange(count)]
    others = (
        World(seed, 1 + n % _OBJECTS, 1 + n, trackers[n % len(trackers)] if trackers else None)
        for n in numbers
    )
    return (World(seed, 0), *others)


class Search:
    """A search for one demonstration.

    Args:
        worlds: number of perturbed worlds per generation.
        count: number of candidates per generation.
        sigma: initial standard deviation of a joint in a key pose [rad].
        trackers: kinds of trackers, used in turn; empty: the joints follow the demonstration.
        margin: additional merit of a success with the best margin over one without margin.
        kept: number of key poses, from the first, that are not changed; at least 1.
        beyond: amount by which a key pose may exceed the joints' limits [rad].

    Attributes:
        state: state of the evolution.
        best: the best demonstrations so far with their merits, best first.
        merit: mean merit of the centre over the last generations.
        enough: value of ``merit`` at which the search has little left to gain.
    """

    def __init__(
        self,
        first: Demonstration,
        worlds: int,
        seed: int,
        count: int,
        sigma: float = _SIGMA,
        trackers: Sequence[str] = ("glove",),
        margin: float = MARGIN,
        kept: int = 1,
        beyond: float = 0.0,
    ) -> None:
        hand = first.robot
        self._worlds, self._trackers, self._margin, self._kept = worlds, trackers, margin, kept
        self._bounds = hand.limits + np.array([-beyond, beyond])
        self.enough = 1.0 + _ENOUGH * margin
        self._free = _joints_of(hand)
        self.best: list[tuple[float, Demonstration]] = []
        self.merit = -np.inf
        paces = np.zeros(len(first.times) - kept)
        point = np.concatenate([first.poses[kept:, self._free].ravel(), paces])
        self.state = Evolution.begin(point, sigma, seed, count)
        self._base = first

    def generation(self, pool: _Pool) -> None:
        """Judges a generation; its first candidate is the centre.

        All candidates are judged in some worlds; the better half and the centre in all of them.
        """
        points = self.state.candidates()
        points[0] = self.state.mean
        candidates = [self._of(point) for point in points]
        worlds = _worlds(self.state.generation, self._worlds, WORLDS_SEED, self._trackers)
        now = max(2, round(_FIRST * len(worlds)))
        early = self._judged(pool, candidates, worlds[:now])
        half = np.argsort(-early.mean(axis=1), kind="stable")[: len(candidates) // 2]
        again = sorted({0, *half.tolist()})
        late = self._judged(pool, [candidates[k] for k in again], worlds[now:])
        whole = np.concatenate([early[again], late], axis=1).mean(axis=1)
        merits = early.mean(axis=1) - 10.0  # behind all that were judged in all worlds
        merits[half] = whole[np.searchsorted(again, half)]
        before = self.merit if np.isfinite(self.merit) else float(whole[0])
        self.merit = _MEMORY * before + (1.0 - _MEMORY) * float(whole[0])
        self.state = self.state.judged(points, merits)
        better = [(float(value), candidates[k]) for k, value in zip(again, whole, strict=True)]
        self.best = sorted([*self.best, *better], key=lambda one: -one[0])[:_KEPT]

    def result(self, pool: _Pool) -> tuple[Demonstration, float]:
        """Selects the best of the centre and a few candidates, in worlds that the search has not
        used.

        Returns:
            that demonstration, and its merit in these worlds.
        """
        last = [self._of(self.state.mean), *(demonstration for _, demonstration in self.best)]
        worlds = _worlds(0, _FINAL_WORLDS, FINAL_SEED, self._trackers)
        merits = self._judged(pool, last, worlds).mean(axis=1)
        top = int(np.argmax(merits))
        return last[top], float(merits[top])

    def _judged(
        self, pool: _Pool, candidates: list[Demonstration], worlds: tuple[World, ...]
    ) -> Float[np.ndarray, "c w"]:
        values = np.zeros((len(candidates), len(worlds)))
        tasks = [Candidate(one, worlds, self._margin) for one in candidates]
        for result in pool.run(tasks):
            if result.value is None:
                raise StudyError(f"a candidate can't be judged: {result.error}")
            values[result.index] = result.value
        return values

    def _of(self, point: Float[np.ndarray, " n"]) -> Demonstration:
        base = self._base
        count = len(base.times) - self._kept
        poses = base.poses.copy()
        poses[self._kept :, self._free] = point[:-count].reshape(count, -1)
        poses = np.clip(poses, self._bounds[:, 0], self._bounds[:, 1])
        lasts = np.diff(base.times)
        lasts[-count:] *= np.clip(np.exp(_PACE * point[-count:]), _FASTEST, 1.0 / _FASTEST)
        times = np.concatenate([[0.0], np.cumsum(lasts)])
        return replace(base, poses=np.round(poses, 3), times=np.round(times, 2))

    def save(self, path: Path) -> None:
        """Saves the state of the search."""
        content = {
            "first": demonstration_text(self._base),
            "best": [[merit, demonstration_text(one)] for merit, one in self.best],
            "merit": self.merit,
            "state": self.state.to_json(),
        }
        with atomic_write(path) as file:
            file.write(json.dumps(content).encode())

    def resume(self, path: Path) -> None:
        """Resumes from the state that ``save`` wrote."""
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        self._base = read_demonstration(content["first"])
        self.best = [(float(merit), read_demonstration(text)) for merit, text in content["best"]]
        self.merit = float(content["merit"])
        self.state = Evolution.from_json(content["state"])


def _first(name: str, task: str, hand: str) -> Demonstration:
    """First guess, from a file or from a hand that has a demonstration."""
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
    """Runs the search from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("hand", help="name of the robot hand")
    parser.add_argument("task", help="card, cube or screwdriver")
    parser.add_argument("--output", type=Path, required=True, help="JSON file of the result")
    parser.add_argument(
        "--first",
        default=DEFAULT_HAND,
        help="first guess: a hand with a demonstration, or the JSON file of one",
    )
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--candidates", type=int, default=16, help="in a generation")
    parser.add_argument(
        "--worlds", type=int, default=8, help="number of perturbed worlds in a generation"
    )
    parser.add_argument("--sigma", type=float, default=_SIGMA, help="first step [rad]")
    parser.add_argument(
        "--trackers",
        default="glove",
        help="trackers, comma-separated, used in turn; empty: the joints follow the "
        "demonstration exactly",
    )
    parser.add_argument(
        "--keep", type=int, default=1, help="number of key poses to keep, from the first"
    )
    parser.add_argument(
        "--beyond",
        type=float,
        default=0.0,
        help="amount by which the operator may exceed the joint limits [rad]",
    )
    parser.add_argument(
        "--margin",
        type=float,
        default=MARGIN,
        help="additional merit of a success with the best margin over one with none",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=None, help="processes; 0: none")
    parser.add_argument(
        "--state", type=Path, help="file of the search's state, to resume and to save"
    )
    options = parser.parse_args(arguments)
    search = Search(
        _first(options.first, options.task, options.hand),
        options.worlds,
        options.seed,
        options.candidates,
        options.sigma,
        [one for one in options.trackers.split(",") if one],
        options.margin,
        options.keep,
        options.beyond,
    )
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
