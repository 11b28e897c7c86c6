"""Joint limits of a frame that keep a bent finger on its side of straight.

Many robot fingers are longest some degrees before their middle joint's limit. Between limit and
that joint position a finger can't get shorter than at the limit: an optimiser that ends there holds
it straight, though the human's is bent. Where the human's fingertip is nearer to the finger's base
than that, the joint is kept on the other side.
"""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand

_SHORTER: Final = 1e-3  # so much nearer than the finger at its limit [m]
_MOVES: Final = 1e-3  # least way of a fingertip by a joint of its finger [m]
_PARALLEL: Final = 0.9  # cosine between the axes of two joints
_POSES: Final = 101


class StraightFingers:
    """The fingers of a hand that one of two parallel joints bends past straight.

    Args:
        hand: the robot hand.

    Attributes:
        found: for each of them its row among the hand's fingers, the joint, the joint position in
            which the finger is longest [rad], and its length at the limit next to that [m].
        centres: (S, 3) where the other joint is, from the wrist [m]; lengths are from there.
    """

    def __init__(self, hand: Hand) -> None:
        self.found: list[tuple[int, int, float, float]] = []
        centres = []
        swept = []
        for joint, (low, high) in enumerate(hand.limits):
            q = np.tile(hand.neutral, (_POSES, 1))
            q[:, joint] = np.linspace(low, high, _POSES)
            swept.append((q[:, joint], hand.tips(hand.full_configuration(q)) - hand.wrist))
        for f, name in enumerate(hand.fingers):
            circles = []
            for joint, (positions, every) in enumerate(swept):
                tips = every[:, f]
                if np.ptp(tips, axis=0).max() > _MOVES:
                    circles.append((*_circle(tips), joint, positions, tips))
            circles.sort(key=lambda one: -one[0])
            parallel = [one for one in circles if abs(one[2] @ circles[-1][2]) > _PARALLEL]
            if len(parallel) != 2 or name == "thumb":  # the thumb's other joint moves about
                continue
            (_, centre, *_), (_, _, _, joint, positions, tips) = parallel
            length = np.linalg.norm(tips - centre, axis=-1)
            longest = int(np.argmax(length))
            if longest < _POSES // 2 and length[longest] - length[0] > _SHORTER:
                self.found.append((f, joint, float(positions[longest]), float(length[0])))
                centres.append(centre)
        self.centres = np.array(centres).reshape(-1, 3)

    def limits(
        self, limits: Float[np.ndarray, "m 2"], tips: Float[Array, "F 3"] | Float[np.ndarray, "F 3"]
    ) -> Float[Array, "m 2"] | Float[np.ndarray, "m 2"]:
        """(m, 2) joint limits of a frame [rad].

        Args:
            limits: the hand's.
            tips: (F, 3) where the human's fingertips are, from the robot's wrist [m].
        """
        if not self.found:
            return limits
        fingers, joints, longest, length = (
            np.array(part) for part in zip(*self.found, strict=True)
        )
        tips = jnp.asarray(tips)
        away = tips[fingers] - jnp.asarray(self.centres, tips.dtype)
        bent = (away * away).sum(-1) < jnp.asarray(length - _SHORTER, tips.dtype) ** 2
        of = np.full(len(limits), len(joints))
        of[joints] = np.arange(len(joints))
        bent = jnp.concatenate([bent, jnp.zeros(1, bool)])[of]
        raised = limits[:, 0].copy()
        raised[joints] = longest
        low = jnp.where(bent, raised.astype(tips.dtype), limits[:, 0].astype(tips.dtype))
        return jnp.stack([low, jnp.asarray(limits[:, 1], tips.dtype)], axis=1)


def _circle(points: Float[np.ndarray, "N 3"]) -> tuple[float, np.ndarray, np.ndarray]:
    """Radius, centre and axis of the circle on which points lie."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    flat = (points - middle) @ axes[:2].T
    rows = np.column_stack([2 * flat, np.ones(len(flat))])
    solution = np.linalg.lstsq(rows, (flat**2).sum(axis=-1), rcond=None)[0]
    radius = float(np.sqrt(solution[2] + solution[:2] @ solution[:2]))
    return radius, middle + solution[:2] @ axes[:2], axes[2]
