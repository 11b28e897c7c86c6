"""What a person learns of a retargeter in free movement: where to put a finger for the robot's.

In the two minutes of free movement before each block a person moves the own fingers and sees the
robot's. People learn such a map between own and seen movement, kinematic distortions included,
within some dozens of movements (Krakauer et al. 2000; Imamizu et al. 2000). Here it is a regression
from robot fingertips to own ones over movements through the person's range; what the person
misjudges on top of it is ``Person.map_error``.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.types import HandFrame
from smooth_operator_research.virtual_operator.hand_model import HandModel

POSTURES: Final = 48
"""Postures that a person moves through; movements of 0.7 s, with pauses, fill two minutes."""

_MOVE_S: Final = 0.5
_RATE_HZ: Final = 15.0  # of the frames that are remembered
_NEAR_M: Final = 0.02  # movements this far off count 61 % in the local fit [m]
_RIDGE: Final = 0.05  # pulls the local fit to the fit over all, where movements were few


class InternalModel:
    """Own fingertips for wanted robot fingertips, by locally weighted affine regression.

    Args:
        robot: (n, f, 3) fingertips that were seen, in the robot's palm frame [m].
        own: (n, f, 3) the person's at those moments [m].
        fingers: (f,) index of each in ``FINGERS``.
    """

    def __init__(
        self,
        robot: Float[np.ndarray, "n f 3"],
        own: Float[np.ndarray, "n f 3"],
        fingers: list[int],
    ) -> None:
        self._robot, self._own = np.swapaxes(robot, 0, 1), np.swapaxes(own, 0, 1)
        self._fingers = fingers
        ones = np.ones((*self._robot.shape[:2], 1))
        self._inputs = np.concatenate([self._robot, ones], axis=-1)
        self._global = np.stack(
            [
                np.linalg.lstsq(x, y, rcond=None)[0]
                for x, y in zip(self._inputs, self._own, strict=True)
            ]
        )
        self._rest = self._own - self._inputs @ self._global

    def own_tips(self, robot: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "5 3"]:
        """(5, 3) in the frame of the person's landmarks [m]; NaN for fingers the robot lacks."""
        away = ((self._robot - robot[:, None]) ** 2).sum(axis=-1)
        nearest = away.min(axis=1, keepdims=True)  # outside of what was tried, its border counts
        weight = np.exp(-0.5 * (away - nearest) / _NEAR_M**2)
        inputs = np.concatenate([self._robot - robot[:, None], self._inputs[..., 3:]], axis=-1)
        weighted = np.swapaxes(inputs * weight[..., None], 1, 2)
        # About the wanted point, in units of the kernel, so that one ridge serves all terms.
        unit = np.array([_NEAR_M, _NEAR_M, _NEAR_M, 1.0])
        gram = (weighted @ inputs) / np.outer(unit, unit)
        ridge = _RIDGE * weight.sum(axis=1)[:, None, None] * np.eye(4)
        solved = np.linalg.solve(gram + ridge, (weighted @ self._rest) / unit[:, None])
        here = np.concatenate([robot, np.ones((len(robot), 1))], axis=-1)
        out = np.full((len(FINGERS), 3), np.nan)
        out[self._fingers] = (here[:, None] @ self._global)[:, 0] + solved[:, 3]
        return out


def familiarise(model: HandModel, retargeter: Retargeter, seed: int = 0) -> InternalModel:
    """Move freely with a retargeter, and learn.

    Args:
        model: the person's hand.
        retargeter: with which.
        seed: of the movements.
    """
    hand, rng = retargeter.hand, np.random.default_rng([seed, 0xFA])
    reach = rng.uniform(0.02, 0.98, (POSTURES, len(model.relaxed)))
    postures = np.concatenate([[model.relaxed], model.lower + (model.upper - model.lower) * reach])
    share = np.arange(1, round(_MOVE_S * _RATE_HZ) + 1)[:, None] / round(_MOVE_S * _RATE_HZ)
    share = share * share * (3 - 2 * share)
    path = postures[:-1, None] + share * np.diff(postures, axis=0)[:, None]
    points = np.array([model.landmarks(q)[0] for q in path.reshape(-1, len(model.relaxed))])
    fingers = [FINGERS.index(name) for name in hand.fingers]
    state, robot = retargeter.init(seed), []
    for k, landmarks in enumerate(points):
        state, result = retargeter.step(state, HandFrame(landmarks, k / _RATE_HZ, hand.spec.side))
        robot.append(hand.tips(result.command.positions))
    return InternalModel(np.array(robot), points[:, [TIPS[row] for row in fingers]], fingers)
