"""How people turn a cube: grip, turn, let go, grip again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.cube import EDGE, CubeScene
from smooth_operator.simulation.tasks.cube_scorer import GOAL
from smooth_operator.simulation.tasks.scorer import rotation
from smooth_operator_research.virtual_operator.grip_reach import GripReach
from smooth_operator_research.virtual_operator.strategy_steps import (
    PAD_M,
    STROKE_S,
    THUMB,
    Aims,
    Closing,
    Seen,
    Step,
    Strategy,
    again,
    moved,
    still,
    turned,
)

_PRESS_M: Final = 0.003  # in the first stroke [m]; ours
_OPEN_M: Final = 0.015  # fingers are wider open, since a cube's corners stand out [m]
_HIGH_M: Final = 0.010  # of the grip above the cube's centre: fingers come from above [m]
_ABOVE: Final = np.array([0.0, 0.0, 0.045])  # where fingers go over the cube [m]
_NEARLY: Final = np.radians(10.0)  # a cube that is so near its goal is let be [rad]
_STOPS: Final = np.radians(3.0)  # a stroke ends so long before the goal [rad]


def cube_strategy(scene: CubeScene, reach: GripReach, seen: Seen) -> Strategy:
    """Grip the cube, turn it as far as the fingers reach, let go, and again until it is turned.

    Args:
        scene: where.
        reach: of the hand.
        seen: at the start.
    """
    sign, press, above = 0.0, _PRESS_M, True
    near = EDGE / 2 + PAD_M
    out = near + _OPEN_M
    while True:
        missing = GOAL - sign * seen.scorer.turned
        if sign and abs(missing) < _NEARLY:  # let it be, and look
            seen = yield Step(lambda share, s: {}, lambda s: False, longest_s=0.5)
            above = True
            continue
        centre = seen.state.position + np.array([0.0, 0.0, _HIGH_M])
        way = sign * float(np.sign(missing))
        stroke = reach.turn(centre, _normals(seen), way, abs(missing), near, out)
        if stroke is None:  # it stands where the fingers can't turn it
            starts = seen.state.starts
            seen = yield from again(seen, reset=True)
            if seen.state.starts == starts:
                return
            sign, above = 0.0, True
            continue
        finger, start, end = stroke
        sign = sign or float(np.sign(end - start))
        n = np.array([np.cos(start), np.sin(start), 0.0])
        wide = {THUMB: centre - out * n, finger: centre + out * n}
        if above:
            seen = yield Step(still(moved(wide, _ABOVE)), via=True)
        seen = yield Step(still(wide))
        touch = Closing(wide, {THUMB: n, finger: -n}, press, _OPEN_M)
        seen = yield touch.step()
        before = seen.scorer.turned
        if touch.complete:
            closed = touch.pressed(press)
            seen = yield Step(still(closed), presses=(THUMB, finger), longest_s=0.3)
            seen = yield Step(
                _around(closed, centre, end - start), _has_turned(seen, abs(missing) - _STOPS),
                presses=(THUMB, finger), longest_s=0.4, path=True, seconds=STROKE_S,
            )  # fmt: skip
        at = _angle(seen, centre, finger)
        m = np.array([np.cos(at), np.sin(at), 0.0])
        back = {THUMB: centre - out * m, finger: centre + out * m}
        seen = yield Step(still(back), via=True)
        if seen.scorer.standing.stuck:
            seen = yield from again(seen)
            sign, above = 0.0, True
            continue
        if abs(seen.scorer.turned - before) < np.radians(5.0):
            press = min(press * 1.5, 3 * _PRESS_M)
        above = False


def _around(
    aims: Aims, centre: Float[np.ndarray, "3"], angle: float
) -> Callable[[float, Seen], Aims]:
    return lambda share, seen: turned(aims, centre, share * angle)


def _has_turned(before: Seen, angle: float) -> Callable[[Seen], bool]:
    return lambda seen: abs(seen.scorer.turned - before.scorer.turned) >= angle


def _angle(seen: Seen, centre: Float[np.ndarray, "3"], finger: int) -> float:
    """Direction from the thumb to a finger about the vertical [rad]."""
    x, y, _ = seen.tips[finger] - seen.tips[THUMB]
    return float(np.arctan2(y, x))


def _normals(seen: Seen) -> Float[np.ndarray, "4"]:
    """(4,) directions of the cube's vertical faces about the vertical [rad]."""
    turn = rotation(seen.state.quaternion)
    axes = [turn[:, k] for k in range(3) if abs(turn[2, k]) < 0.7]
    heading = float(np.arctan2(axes[0][1], axes[0][0]))
    return heading + np.pi / 2 * np.arange(4)
