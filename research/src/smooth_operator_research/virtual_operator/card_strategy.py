"""How people pick up a card: press, draw it over the edge, pinch, pull it off."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.card import CARD, CardScene
from smooth_operator.simulation.tasks.card_scorer import CardScorer
from smooth_operator_research.virtual_operator.grip_reach import GripReach
from smooth_operator_research.virtual_operator.strategy_steps import (
    OPEN_M,
    PAD_M,
    PRESS_M,
    STROKE_S,
    THUMB,
    Aims,
    Closing,
    Seen,
    Step,
    Strategy,
    again,
    along,
    moved,
    still,
)

_Place: TypeAlias = Float[np.ndarray, "3"]

_PULL: Final = np.array([-0.027, 0.0, 0.006])  # way of the pinched card off the table [m],
_LIFT: Final = np.array([0.0, 0.0, 0.024])  # and up
_PINCH_M: Final = 0.010
_SQUEEZE_M: Final = 0.003  # a pinch that is to hold is closed so much further [m]
_BESIDE_M: Final = 0.015  # the card is pressed on so far to the side of the pinch [m]
_STICKS_OUT: Final = 0.025  # of the card over the edge, before it is pinched [m]


def card_strategy(scene: CardScene, reach: GripReach, seen: Seen) -> Strategy:
    """Press on the card, draw it over the edge, pinch it, pull it off.

    Args:
        scene: where.
        reach: of the hand.
        seen: at the start.
    """
    edge, top = scene.edge, scene.top
    above = top + CARD[2] + PAD_M
    finger, y = reach.edge_pinch(
        edge - _PINCH_M, float(seen.state.position[1]), top, CARD[2] + 2 * PAD_M
    )
    press = PRESS_M
    both = (THUMB, finger)
    lift, down = np.array([0.0, 0.0, OPEN_M]), np.array([0.0, 0.0, -1.0])
    x = edge - _PINCH_M
    below = np.array([edge - 0.016, y, top - 0.022])
    while True:
        far = min(scene.reach - 0.012, float(seen.state.position[0]) + CARD[0] / 2 - 0.012)
        aside = float(np.clip(seen.state.position[1] - y, -_BESIDE_M, _BESIDE_M))
        over = np.array([far, y + aside, above]) + lift
        seen = yield Step(still({THUMB: below, finger: over}))
        for _ in range(4):
            if _protrudes(seen) >= _STICKS_OUT:
                break
            touch = Closing({finger: over}, {finger: down}, press)
            seen = yield _with_thumb(touch.step(), below)
            start = touch.pressed(press).get(finger, over - lift)
            end = np.array([edge + 0.001, y, start[2]])

            def drawn(
                share: float, s: Seen, a: _Place = start, b: _Place = end, p: float = press
            ) -> Aims:
                place = a + share * (b - a)
                if s.touches(finger):  # the pad rolls: press as far beyond where it is seen
                    place = np.array([place[0], place[1], s.tips[finger][2] - p])
                return {THUMB: below, finger: place}

            seen = yield Step(
                drawn,
                lambda s: _protrudes(s) >= _STICKS_OUT, presses=(finger,),
                longest_s=0.4, path=True,
            )  # fmt: skip
            seen = yield Step(still({THUMB: below, finger: seen.tips[finger] + lift}), via=True)
            if _protrudes(seen) < _STICKS_OUT:  # another stroke
                seen = yield Step(still({THUMB: below, finger: over}))
        # The finger goes over the part that sticks out, the thumb below it, and both close.
        wide = {
            THUMB: np.array([x, y, top - PAD_M]) - lift, finger: np.array([x, y, above]) + lift
        }  # fmt: skip
        seen = yield Step(still(wide))
        pinch = Closing(wide, {THUMB: -down, finger: down}, press)
        seen = yield pinch.step()
        if pinch.complete:
            firm = pinch.pressed(press + _SQUEEZE_M)
            closed, off = pinch.pressed(press), moved(firm, _PULL)
            seen = yield Step(
                along(closed, off), presses=both, longest_s=0.2, seconds=STROKE_S,
                path=True,
            )  # fmt: skip
            seen = yield Step(
                along(off, moved(off, _LIFT)),
                lambda s: _clear(s, 0.2) or not s.touches(*both), presses=both,
                longest_s=1.0, seconds=STROKE_S, path=True,
            )  # fmt: skip
            held = {f: seen.sent[f] for f in both}
            while seen.touches(*both) and _clear(seen, 0.0):
                seen = yield Step(still(held), presses=both, longest_s=0.5)
            if seen.touches(*both):  # it does not come off: put it back
                seen = yield Step(
                    along(held, closed), presses=both, longest_s=0.2,
                    seconds=STROKE_S, path=True,
                )  # fmt: skip
        seen = yield from again(seen)
        press = min(press * 1.5, 3 * PRESS_M)


def _with_thumb(step: Step, place: Float[np.ndarray, "3"]) -> Step:
    """The step, with the thumb at a place meanwhile."""
    aims = step.aims
    return replace(step, aims=lambda share, seen: {THUMB: place, **aims(share, seen)})


def _clear(seen: Seen, seconds: float) -> bool:
    """Whether the card has been in the pinch alone for so long."""
    since = seen.scorer.pinched
    return since is not None and seen.state.time - since >= seconds


def _protrudes(seen: Seen) -> float:
    scorer: CardScorer = seen.scorer
    return scorer.protrusion
