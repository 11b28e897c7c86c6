"""How far a trial got, as a number for a search: a score alone says nothing below success."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.simulation.scenes.card import CardScene
from smooth_operator.simulation.tasks.card_scorer import OVER, CardScorer, pinches
from smooth_operator.simulation.tasks.cube_scorer import GOAL, TOLERANCE, CubeScorer
from smooth_operator.simulation.tasks.scorer import HOLD_S
from smooth_operator.simulation.tasks.screwdriver_scorer import ScrewdriverScorer
from smooth_operator.simulation.tasks.trial_loop import Moment

MARGIN: Final = 0.1
"""What a success with the best margin counts more than one with none."""

_LIFT: Final = 0.005  # of the card above the table that counts in full [m]
_LOST: Final = 0.5  # what progress is worth after a drop


def progress(task: str, moments: Sequence[Moment]) -> float:
    """How far a trial got.

    Args:
        task: name of the task.
        moments: the trial, moment by moment.

    Returns:
        0 for nothing to below 1; from 1 to 1.1 for success with score 1, the more the better its
        margin.
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
    pointing = _share(np.array([scorer.pointing is not None for scorer in scorers]), moments)
    part = 0.1 * _capped(4.0 * float(gripped.mean())) + 0.1 * freed + 0.1 * float(held.mean())
    part += 0.15 * turned + 0.25 * ends + 0.3 * pointing
    return part, _capped(1.0 - angle[-1] / np.radians(10.0))


_PARTS: Final[dict[str, Callable[[Sequence[Moment]], tuple[float, float]]]] = {
    "card": _card,
    "cube": _cube,
    "screwdriver": _screwdriver,
}
"""Task -> (progress of a trial that did not succeed, margin of one that did), 0 to 1."""


def _scorer(moment: Moment, kind: type[Any]) -> Any:
    scorer = moment.run.scorer
    assert isinstance(scorer, kind)
    return scorer


def _share(holds: np.ndarray, moments: Sequence[Moment]) -> float:
    """The longest time without a break for which something holds, of that which a goal needs."""
    most = now = 0
    for one in holds:
        now = now + 1 if one else 0
        most = max(most, now)
    period = moments[0].state.time if len(moments) < 2 else (
        moments[-1].state.time - moments[0].state.time
    ) / (len(moments) - 1)  # fmt: skip
    return _capped(most * period / HOLD_S)


def _capped(value: float) -> float:
    return float(np.clip(value, 0.0, 1.0))
