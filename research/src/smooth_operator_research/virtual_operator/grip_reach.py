"""Where the fingertips of a robot hand can meet an object: what a person sees in free movement."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator_research.virtual_operator.hand_model import HandModel, ReachingHand
from smooth_operator_research.virtual_operator.points_on_hand import HandPoints

_NEAR_M: Final = 0.004
"""A fingertip that comes this near reaches a place [m]."""

_ROUNDS: Final = 40
_MOST: Final = np.radians(42.0)  # a grip is this far from a face's normal at most [rad]
_ASIDE: Final = np.radians(50.0)  # and from the line from the relaxed thumb to the finger [rad]
_AROUND: Final = np.radians(100.0)
"""A thumb that goes further around the object meets it with its other links [rad]."""
_SHORTEST: Final = np.radians(5.0)
_STEP: Final = np.radians(5.0)


class _RobotTips(HandModel):
    """The robot hand itself: its fingertips in the palm frame."""

    def __init__(self, hand: Hand) -> None:
        self.lower, self.upper = hand.limits.T
        self.relaxed = hand.neutral
        self._points = HandPoints(hand, hand.tip_names)
        self._rows = [FINGERS.index(name) for name in hand.fingers]

    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        points, jacobian = self._points.at(angles)
        everything, derivatives = np.zeros((21, 3)), np.zeros((5, 3, len(angles)))
        everything[[TIPS[row] for row in self._rows]] = points
        derivatives[self._rows] = jacobian
        return everything, derivatives


class GripReach:
    """What the fingertips of a hand in a scene reach.

    Args:
        hand: the robot hand.
        scene: where it stands.
    """

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self._hand, self._model = hand, _RobotTips(hand)
        self._at, self._turn = scene.mount.palm
        self._rows = [FINGERS.index(name) for name in hand.fingers]
        tips = hand.tips(hand.full_configuration(hand.neutral))
        self.relaxed = tips @ self._turn.T + self._at
        self._turns: dict[tuple[float, ...], dict[int, tuple[float, float]]] = {}

    def off(self, aims: dict[int, Float[np.ndarray, "3"]]) -> float:
        """How far the farthest fingertip stays from its aim [m].

        Args:
            aims: finger -> place in the world [m].
        """
        goals = np.full((5, 3), np.nan)
        for finger, place in aims.items():
            goals[self._rows[finger]] = (place - self._at) @ self._turn
        rows = [self._rows[finger] for finger in aims]
        points = ReachingHand(self._model).reach(goals, np.inf, rounds=_ROUNDS)
        return float(np.linalg.norm(points[list(TIPS)][rows] - goals[rows], axis=1).max())

    def edge_pinch(self, x: float, y: float, top: float, gap: float) -> tuple[int, float]:
        """Finger and place along the edge where it and the thumb can pinch a card best.

        Args:
            x: of the pinch [m].
            y: of the card's centre [m].
            top: height of the table [m].
            gap: between the fingertips [m].
        """
        found = []
        for finger in (1, 2):
            for side in (0.0, 0.01, -0.01, 0.02, -0.02):
                low = np.array([x, y + side, top - gap / 2 + 0.001])
                off = self.off({0: low, finger: low + np.array([0.0, 0.0, gap])})
                found.append((off + 0.05 * abs(side), finger, y + side))
        _, finger, place = min(found)
        return finger, place

    def turn(
        self, centre: Float[np.ndarray, "3"], normals: Float[np.ndarray, " n"], sign: float,
        missing: float, width: float, wide: float,
    ) -> tuple[int, float, float] | None:  # fmt: skip
        """Finger, first and last angle of the best stroke that turns a block about the vertical.

        Args:
            centre: of the block [m].
            normals: (n,) directions of its faces [rad].
            sign: in which direction it is to be turned; 0 for either.
            missing: by how much [rad].
            width: of fingertips from the centre [m].
            wide: the same of the open hand [m].

        Returns:
            None where thumb and fingers can't turn it.
        """
        best: tuple[float, int, float, float] | None = None
        for finger, (low, high) in self._ranges(centre, width, wide).items():
            for normal in normals:
                middle = (low + high) / 2
                normal = middle + (normal - middle + np.pi) % (2 * np.pi) - np.pi
                for way in (1.0, -1.0) if not sign else (sign,):
                    start = float(np.clip(normal, low, high))
                    if way * (normal - start) < 0:  # begin as far back as the faces allow
                        start = float(np.clip(normal - way * 0.0, low, high))
                    if abs(start - normal) > _MOST:
                        continue
                    room = way * ((high if way > 0 else low) - start)
                    gain = min(room, missing)
                    if gain < min(_SHORTEST, missing):
                        continue
                    value = gain - 0.3 * abs(start - normal)
                    if best is None or value > best[0]:
                        best = value, finger, start, start + way * gain
        return None if best is None else best[1:]

    def _ranges(
        self, centre: Float[np.ndarray, "3"], width: float, wide: float
    ) -> dict[int, tuple[float, float]]:
        """Finger -> least and greatest angle at which it and the thumb grip from both sides."""
        key = tuple(np.round(centre, 2))
        if key not in self._turns:
            angles = np.arange(-np.pi, np.pi, _STEP)
            found = {}
            for finger in (1, 2):
                away = self.relaxed[finger] - self.relaxed[0]
                nominal = np.arctan2(away[1], away[0])
                fits = []
                for angle in angles:
                    around = angle + np.pi - np.arctan2(*(self.relaxed[0] - centre)[1::-1])
                    if np.cos(angle - nominal) < np.cos(_ASIDE) or np.cos(around) < np.cos(_AROUND):
                        fits.append(False)
                        continue
                    n = np.array([np.cos(angle), np.sin(angle), 0.0])
                    fits.append(
                        all(
                            self.off({0: centre - w * n, finger: centre + w * n}) <= near
                            for w, near in ((width, _NEAR_M), (wide, 2 * _NEAR_M))
                        )
                    )
                span = _longest_run(np.array(fits))
                if span is not None:
                    found[finger] = (float(angles[span[0]]), float(angles[span[0]]
                                     + _STEP * (span[1] - span[0])))  # fmt: skip
            self._turns[key] = found
        return self._turns[key]

    def across(
        self, centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """(3,) horizontal direction across a handle, to the thumb's side."""
        direction = np.cross(axis, [0.0, 0.0, 1.0])
        direction /= np.linalg.norm(direction)
        side = (self.relaxed[0] - self.relaxed[1:3].mean(axis=0)) @ direction
        return np.asarray(direction * np.sign(side))

    def handle_fingers(
        self, centre: Float[np.ndarray, "3"], across: Float[np.ndarray, "3"],
        along: Float[np.ndarray, "3"], width: float,
    ) -> tuple[int, int, float]:  # fmt: skip
        """Finger opposite the thumb, the second finger, and how far along the handle that is [m].

        Args:
            centre: of the grip [m].
            across: direction to the thumb.
            along: direction to the handle's end.
            width: of fingertips from the handle's axis [m].
        """
        found = []
        for pivot, second in ((1, 2), (2, 3), (2, 1)):
            if second >= len(self._rows):
                continue
            for apart in (0.018, 0.024, -0.018):
                off = self.off(
                    {
                        0: centre + width * across,
                        pivot: centre - width * across,
                        second: centre + apart * along - width * across,
                    }
                )
                found.append((off, pivot, second, apart))
        return min(found)[1:]


def _longest_run(fits: np.ndarray) -> tuple[int, int] | None:
    """First and last place of the longest run of true values on a circle."""
    if not fits.any():
        return None
    if fits.all():
        return 0, len(fits) - 1
    begin = int(np.argmin(fits))
    rolled = np.roll(fits, -begin)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rolled.astype(int), [0]])))
    first, past = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0])
    return int(first + begin), int(past - 1 + begin)
