"""How people let a screwdriver pivot: take it, loosen the grip, hold it where it hangs."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.screwdriver import HANDLE, ScrewdriverScene
from smooth_operator.simulation.tasks.scorer import rotation
from smooth_operator.simulation.tasks.screwdriver_scorer import (
    CLOSE,
    DOWN,
    ScrewdriverScorer,
)
from smooth_operator_research.virtual_operator.grip_reach import GripReach
from smooth_operator_research.virtual_operator.strategy_steps import (
    OPEN_M,
    PAD_M,
    PRESS_M,
    THUMB,
    Aims,
    Closing,
    Seen,
    Step,
    Strategy,
    still,
)

_LIGHT: Final = 0.3  # share of the first grip's press that is the least for a handle that hangs
_LOOSENS_M: Final = 0.0002  # by so much the grip is loosened between two looks [m]


def screwdriver_strategy(scene: ScrewdriverScene, reach: GripReach, seen: Seen) -> Strategy:
    """Take the handle between thumb and fingers, loosen until the blade hangs, and hold.

    Args:
        scene: where.
        reach: of the hand.
        seen: at the start.
    """
    press = PRESS_M
    across = reach.across(seen.state.position, rotation(scene.start[1])[:, 2])
    along = -rotation(scene.start[1])[:, 2]  # towards the handle's end
    out = HANDLE[0] + PAD_M
    pivot, second, apart = reach.handle_fingers(seen.state.position, across, along, out)

    def grip(width: float, centre: Float[np.ndarray, "3"], other: float | None) -> Aims:
        aims = {THUMB: centre + width * across, pivot: centre - width * across}
        if other is not None:
            aims[second] = centre + apart * along - other * across
        return aims

    while True:
        centre = seen.state.position.copy()
        wide = grip(out + OPEN_M, centre, out + OPEN_M)
        seen = yield Step(still(wide))
        inward = {f: (-1.0 if f == THUMB else 1.0) * across for f in wide}
        touch = Closing(wide, inward, press)
        seen = yield touch.step()
        seen = yield Step(
            still(touch.pressed(press)), lambda s: not s.state.fixed, presses=tuple(wide),
            longest_s=1.5,
        )  # fmt: skip
        if seen.state.fixed:
            press = min(press * 1.5, 3 * PRESS_M)
            continue

        def held(press: float, t: Closing = touch, w: Aims = wide) -> Step:
            aims = t.pressed(press) | {second: w[second]}
            return Step(still(aims), presses=(THUMB, pivot), longest_s=0.1)

        seen = yield held(press)
        squeeze, high = press, float(seen.state.position[2])
        while True:
            scorer: ScrewdriverScorer = seen.scorer
            if scorer.angle <= DOWN or high - seen.state.position[2] > 0.004:
                squeeze = press
            elif np.linalg.norm(seen.state.spin) < 0.5:
                if scorer.angle <= CLOSE and squeeze <= _LIGHT * press:  # looser would drop it
                    return
                squeeze = max(squeeze - _LOOSENS_M, -PRESS_M)
            seen = yield held(squeeze)
            if seen.state.fixed:  # it was put back
                break
