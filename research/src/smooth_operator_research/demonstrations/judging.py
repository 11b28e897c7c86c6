"""Does candidates for a demonstration in perturbed worlds; what a search asks of a worker."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.tasks.task_registry import task_named
from smooth_operator.simulation.tasks.trial_loop import perform
from smooth_operator.types import as_side
from smooth_operator_research.demonstrations.demonstration import (
    PERIOD_S,
    Demonstration,
    read_demonstration,
)
from smooth_operator_research.demonstrations.errors import joint_errors
from smooth_operator_research.demonstrations.overlap import excess
from smooth_operator_research.demonstrations.perturbation import draw_perturbation
from smooth_operator_research.demonstrations.progress import MARGIN, progress

_SUCCESS: Final = 0.4  # what a success is worth more than the most progress without one
_OVERLAP: Final = 20.0  # merit that a metre of forbidden self-penetration costs


class World(NamedTuple):
    """A perturbed world of a search.

    Attributes:
        seed: of all that is drawn.
        number: object pose, friction and mass are those of this world; 0 leaves them as they are.
        operator: bones, tracker noise and dropped frames are those of this one; 0 has none.
    """

    seed: int
    number: int
    operator: int = 0


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a worker judges.

    Attributes:
        demonstration: the key poses.
        worlds: in which it is done.
        centre: text of the demonstration by which the operators' errors are computed; the same for
            all candidates of a generation, which are near it.
        share: of those errors that counts.
        filtered: see ``joint_errors``.
        margin: what a success with the best margin is worth more than one with none.
    """

    demonstration: Demonstration
    worlds: tuple[World, ...]
    centre: str
    share: float = 1.0
    filtered: bool = False
    margin: float = MARGIN


def judge(candidate: Candidate) -> list[float]:
    """What a candidate is worth in each of its worlds; 1 and the margin for success, else less.

    The self-penetration that it commands is taken off.
    """
    penalty = _OVERLAP * excess(candidate.demonstration)
    values = []
    for world in candidate.worlds:
        errors = None
        if world.operator:
            errors = candidate.share * _errors(candidate.centre, world, candidate.filtered)
        reached = tried(candidate.demonstration, world, errors)
        more = candidate.margin / MARGIN * (reached - 1.0)
        values.append((1.0 + more if reached >= 1.0 else (1.0 - _SUCCESS) * reached) - penalty)
    return values


def tried(
    demonstration: Demonstration, world: World, errors: Float[np.ndarray, "t m"] | None = None
) -> float:
    """How far a demonstration gets in a world; see ``progress``.

    Args:
        demonstration: what is done.
        world: with which object.
        errors: (t, m) by how much each actuated joint is off, period by period [rad]; the last
            holds on. None: not at all.
    """
    hand, task = demonstration.robot, task_named(demonstration.task)
    physics = _physics(demonstration.task, hand.name, demonstration.side, world.seed, world.number)
    physics.restart()
    off = np.zeros((1, len(hand.actuated))) if errors is None else errors
    moments = list(
        perform(
            physics,
            task,
            lambda time, state, physics: hand.full_configuration(
                demonstration.pose(time + PERIOD_S) + off[min(round(time / PERIOD_S), len(off) - 1)]
            ),
            seconds=float(demonstration.times[-1]),
        )
    )
    return 0.0 if physics.resets else progress(task.name, moments)


@lru_cache(maxsize=64)
def _physics(task: str, hand_name: str, side: str, seed: int, number: int) -> ScenePhysics:
    """A scene to use again and again: most of a short trial's time goes into making it."""
    hand = load_hand(hand_name, as_side(side))
    world = draw_perturbation(number, seed)
    physics = ScenePhysics(hand, world.scene(scene_for(task, hand)))
    world.prepare(physics)
    return physics


@lru_cache(maxsize=2)
def _centre(text: str) -> Demonstration:
    return read_demonstration(text)


@lru_cache(maxsize=64)
def _errors(centre: str, world: World, filtered: bool) -> Float[np.ndarray, "t m"]:
    drawn = draw_perturbation(world.operator, world.seed)
    return joint_errors(_centre(centre), drawn, filtered)
