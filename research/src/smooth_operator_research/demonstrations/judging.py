"""Runs candidates for a demonstration in perturbed worlds, in the workers of a search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.capsules import parts_apart
from smooth_operator.hands.collision import owners
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.task_scenes import CardScene
from smooth_operator.simulation.tasks.catalogue import task_named
from smooth_operator.simulation.tasks.task import (
    GOAL,
    HOLD_S,
    OVER,
    SCREWDRIVER_STILL,
    TOLERANCE,
    CardScorer,
    CubeScorer,
    ScrewdriverScorer,
    pinches,
)
from smooth_operator.types import as_side
from smooth_operator_research.demonstrations.demonstration import (
    Demonstration,
    DemonstrationLandmarks,
    own_commands,
)
from smooth_operator_research.demonstrations.perturbation import (
    PerturbedLandmarks,
    draw_perturbation,
)
from smooth_operator_research.demonstrations.trial_loop import (
    Moment,
    perform,
    retargeted_commands,
)

PINCH: Final = 0.004
"""Allowed overlap of thumb and finger [m], because pads are soft and a grip needs force."""

ELSEWHERE: Final = 0.001
"""Allowed overlap of other parts [m]."""


def excess(demonstration: Demonstration) -> float:
    """Self-penetration beyond the allowed depth, summed over key poses and poses halfway [m]."""
    hand, times = demonstration.robot, demonstration.times
    every = np.sort(np.concatenate([times, (times[1:] + times[:-1]) / 2]))
    poses = hand.full_configuration([demonstration.pose(float(time)) for time in every])
    return sum(
        float(np.maximum((depths - _allowed(hand)).max(axis=1), 0.0).sum())
        for _, depths in parts_apart(hand).depths(poses)
    )


@cache
def _allowed(hand: Hand) -> Float[np.ndarray, " P"]:
    """Depth that each pair of ``parts_apart`` may have [m]."""
    apart = parts_apart(hand)
    of = owners(hand)[[capsule.body for capsule in apart.capsules]][apart.pairs]
    pinch = (of >= 0).all(axis=1) & ((of == 0).sum(axis=1) == 1)
    return np.where(pinch, PINCH, ELSEWHERE)


MARGIN: Final = 0.1
"""Additional merit of a success with the best margin."""

_LIFT: Final = 0.005  # of the card above the table that counts in full [m]
_LOST: Final = 0.5  # what progress is worth after a drop
_LAST_S: Final = 1.5  # end of a trial in which a screwdriver's stillness counts [s]


def progress(task: str, moments: Sequence[Moment]) -> float:
    """Progress of a trial.

    Args:
        task: name of the task.
        moments: the trial, moment by moment.

    Returns:
        0 for no progress, below 1 without success; 1 to 1.1 for success with score 1, higher for
        a better margin.
    """
    last = moments[-1].run
    part, margin = _PARTS[task](moments)
    if last.outcome is not None and last.outcome.score == 1.0:
        return 1.0 + MARGIN * margin
    lost = last.outcome is not None and last.outcome.ended == "drop"
    return 0.99 * part * (_LOST if lost else 1.0)


def _card(moments: Sequence[Moment]) -> tuple[float, float]:
    scorers = [_scorer(moment, CardScorer) for moment in moments]
    scene = scorers[-1].scene
    assert isinstance(scene, CardScene)
    lies = np.array([moment.state.support > 0.0 for moment in moments])
    beyond = np.array([scorer.protrusion for scorer in scorers])
    slid = max([0.0, *(beyond[lies] + 0.004)]) / (OVER + 0.004)
    over = np.array([scorer.over for scorer in scorers])
    pinched = np.array([pinches(moment.state) for moment in moments]) & over
    height = np.array([moment.state.position[2] for moment in moments]) - scene.start[0][2]
    lifted = max([0.0, *height[pinched]]) / _LIFT
    clear = _share(pinched & ~lies, moments)
    below = max([0.0, *(m.state.force[0] > 0 for m, o in zip(moments, over, strict=True) if o)])
    part = 0.3 * _capped(slid) + 0.1 * below + 0.15 * _share(pinched, moments)
    part += 0.15 * _capped(lifted) + 0.3 * clear
    final = moments[-1].state.force
    return part, _capped(min(final[0], max(final[1:])) / 2.0)


def _cube(moments: Sequence[Moment]) -> tuple[float, float]:
    scorers = [_scorer(moment, CubeScorer) for moment in moments]
    last = scorers[-1]
    off = abs(abs(last.turned) - GOAL)
    turned = _capped(1.0 - off / GOAL)
    settled = _share(np.array([scorer.settled is not None for scorer in scorers]), moments)
    flat = 0.0 if last.flipped or last.leaning is not None else 1.0
    return 0.7 * turned + 0.1 * flat + 0.2 * settled, _capped(1.0 - off / TOLERANCE)


def _screwdriver(moments: Sequence[Moment]) -> tuple[float, float]:
    scorers = [_scorer(moment, ScrewdriverScorer) for moment in moments]
    held = np.array([scorer.held for scorer in scorers])
    angle = np.array([scorer.angle for scorer in scorers])
    force = np.array([moment.state.force for moment in moments])
    gripped = (force[:, 0] > 0.3) & ((force[:, 1:] > 0.3).sum(axis=1) >= 2)
    freed = float(not moments[-1].state.fixed)
    turned = max([0.0, *(1.0 - angle[held] / (np.pi / 2))])
    ends = max(0.0, 1.0 - angle[-1] / (np.pi / 2)) if held[-1] else 0.0
    points = np.array([scorer.pointing is not None for scorer in scorers])
    spin = np.array([np.linalg.norm(moment.state.spin) for moment in moments])
    last = moments[-1].state.time - np.array([m.state.time for m in moments]) < _LAST_S
    rest = float((held & (spin < SCREWDRIVER_STILL))[last].mean())
    part = 0.1 * _capped(4.0 * float(gripped.mean())) + 0.1 * freed + 0.05 * float(held.mean())
    part += 0.15 * turned + 0.25 * ends + 0.1 * rest + 0.1 * float(points[last].mean())
    part += 0.15 * _share(points, moments)
    return part, _capped(1.0 - angle[-1] / np.radians(10.0))


_PARTS: Final[dict[str, Callable[[Sequence[Moment]], tuple[float, float]]]] = {
    "card": _card,
    "cube": _cube,
    "screwdriver": _screwdriver,
}
"""Task -> functions for the progress of a failed trial and for the margin of a success, 0 to 1."""


def _scorer(moment: Moment, kind: type[Any]) -> Any:
    scorer = moment.run.scorer
    assert isinstance(scorer, kind)
    return scorer


def _share(holds: np.ndarray, moments: Sequence[Moment]) -> float:
    """Longest uninterrupted time in which a condition holds, divided by the time that the goal
    needs."""
    most = now = 0
    for one in holds:
        now = now + 1 if one else 0
        most = max(most, now)
    period = (
        moments[0].state.time
        if len(moments) < 2
        else (moments[-1].state.time - moments[0].state.time) / (len(moments) - 1)
    )
    return _capped(most * period / HOLD_S)


def _capped(value: float) -> float:
    return float(np.clip(value, 0.0, 1.0))


_SUCCESS: Final = 0.4  # what a success is worth more than the most progress without one
_OVERLAP: Final = 20.0  # merit that a metre of forbidden self-penetration costs


class World(NamedTuple):
    """A perturbed world of a search.

    Attributes:
        seed: seed of all random values.
        number: world that sets object pose, friction and mass; 0 for the unperturbed ones.
        operator: world that sets bones, shake and lost frames.
        tracker: kind of tracker through which ``smooth`` sees the operator; None for the
            demonstration's own joint positions, without an operator.
    """

    seed: int
    number: int
    operator: int = 0
    tracker: str | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate demonstration, and the worlds in which it is judged.

    Attributes:
        demonstration: the key poses.
        worlds: worlds in which it is performed.
        margin: additional merit of a success with the best margin over one without margin.
    """

    demonstration: Demonstration
    worlds: tuple[World, ...]
    margin: float = MARGIN


def judge(candidate: Candidate) -> list[float]:
    """Merit of a candidate in each of its worlds: 1 plus the margin for a success, less otherwise.

    The commanded self-penetration is subtracted.
    """
    penalty = _OVERLAP * excess(candidate.demonstration)
    source = DemonstrationLandmarks(candidate.demonstration)
    values = []
    for world in candidate.worlds:
        reached = tried(candidate.demonstration, world, source)
        more = candidate.margin / MARGIN * (reached - 1.0)
        values.append((1.0 + more if reached >= 1.0 else (1.0 - _SUCCESS) * reached) - penalty)
    return values


def tried(
    demonstration: Demonstration, world: World, source: DemonstrationLandmarks | None = None
) -> float:
    """Progress of a demonstration in a world; see ``progress``.

    Args:
        source: the demonstration's landmarks, if they are already known.
    """
    task = task_named(demonstration.task)
    physics = _physics(task.name, demonstration.hand, demonstration.side, world.seed, world.number)
    physics.restart()
    if world.tracker is None:
        commands = own_commands(demonstration)
    else:
        operator = draw_perturbation(world.operator, world.seed, tracker=world.tracker)
        seen = PerturbedLandmarks(source or DemonstrationLandmarks(demonstration), operator)
        retargeter = _retargeter(demonstration.hand, demonstration.side, world.tracker)
        commands = retargeted_commands(retargeter, seen)
    seconds = float(demonstration.times[-1])
    moments = list(perform(physics, task, commands, seconds=seconds))
    return 0.0 if physics.resets else progress(task.name, moments)


@lru_cache(maxsize=64)
def _physics(task: str, hand_name: str, side: str, seed: int, number: int) -> ScenePhysics:
    """Scene that is reused, because making it takes most of a short trial's time."""
    hand = load_hand(hand_name, as_side(side))
    world = draw_perturbation(number, seed)
    physics = ScenePhysics(hand, world.scene(scene_for(task, hand)))
    world.prepare(physics)
    return physics


@lru_cache(maxsize=4)
def _retargeter(hand: str, side: str, tracker: str) -> Retargeter:
    return Retargeter(hand, side=side, pinch_gaps=known_gaps(tracker))
