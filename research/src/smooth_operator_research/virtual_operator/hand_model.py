"""A person's hand that follows fingertip goals: inverse kinematics within its joint ranges.

There are two. ``human``: published human anatomy with the person's bone lengths and human joint
ranges. ``matched``: the kinematics of the robot hand at human size, each bone 10 % longer or
shorter at most, and its joint ranges. The demonstrations of the tasks use fingertip positions that
a human thumb, aligned by the palm, does not reach (``docs/reference/study.md`` has the figures), so
trials are simulated with the matched hand.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS
from smooth_operator.synthetic.hand_anatomy import FREE, LOWER, UPPER, couple
from smooth_operator.synthetic.human_kinematics import mirror, pose_hand
from smooth_operator.synthetic.poses import RELAXED
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import Side
from smooth_operator_research.virtual_operator.person import Person
from smooth_operator_research.virtual_operator.points_on_hand import HandPoints

Body: TypeAlias = Literal["matched", "human"]
"""Whose kinematics a person's hand has."""

_NUDGE: Final = 1e-5  # of an angle, for derivatives [rad]
_TIP_M: Final = 0.002  # a fingertip's error counts in units of this [m]
_POSTURE: Final = 3.0  # an angle's distance from the relaxed hand counts in units of this [rad]
_MOTION: Final = 0.5  # and that from the last angle in units of this [rad]
_FASTEST: Final = 15.0
"""Fastest turn of a finger joint [rad/s]; ours, in the order of the fastest finger movements."""


class HandModel(ABC):
    """Kinematics of a hand.

    Attributes:
        lower: (m,) least angles [rad].
        upper: (m,) greatest angles [rad].
        relaxed: (m,) [rad].
    """

    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]
    relaxed: Float[np.ndarray, " m"]

    @abstractmethod
    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        """Landmarks [m] and the derivatives of the tips [m/rad].

        Args:
            angles: (m,) joint angles [rad].
        """


def hand_model(person: Person, hand: Hand, body: Body = "matched") -> HandModel:
    """The hand of a person who drives a robot hand.

    Args:
        person: who.
        hand: the robot hand.
        body: whose kinematics.
    """
    return HumanHand(person, hand.spec.side) if body == "human" else MatchedHand(person, hand)


class HumanHand(HandModel):
    """Published anatomy with a person's bones.

    Args:
        person: whose.
        side: which hand.
    """

    def __init__(self, person: Person, side: Side) -> None:
        self.lower, self.upper, self.relaxed = LOWER[list(FREE)], UPPER[list(FREE)], RELAXED
        self._anatomy, self._side = person.anatomy, side
        self._nudges = np.concatenate([np.zeros((1, len(FREE))), _NUDGE * np.eye(len(FREE))])

    def landmarks(
        self, angles: Float[np.ndarray, "16"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 16"]]:
        """See ``HandModel``."""
        poses = pose_hand(self._anatomy, couple(angles + self._nudges))
        points = (poses if self._side == "right" else mirror(poses)).landmarks
        return points[0], np.moveaxis(
            points[1:, list(TIPS)] - points[0, list(TIPS)], 0, -1
        ) / _NUDGE


class MatchedHand(HandModel):
    """The robot hand's kinematics at the size of a person, with the person's bones.

    Args:
        person: whose.
        hand: the robot hand.
    """

    def __init__(self, person: Person, hand: Hand) -> None:
        self.lower, self.upper = hand.limits.T
        self.relaxed = hand.neutral
        self._points = HandPoints(hand, hand.tree.names)
        known = [LANDMARKS.index(name) for name in hand.tree.names]
        # All landmarks are the known ones, or lie between two of them, or stand still.
        still = human_landmarks(hand, hand.neutral[None])[0]
        share = np.zeros((len(LANDMARKS), len(known)))
        share[known, range(len(known))] = 1.0
        for name in hand.fingers:
            first = BASES[FINGERS.index(name)]
            own = [i for i in range(first, first + 4) if i in known]
            for i in set(range(first, first + 4)) - set(own):
                below, above = max(k for k in own if k < i), min(k for k in own if k > i)
                part = (i - below) / (above - below)
                share[i] = (1 - part) * share[below] + part * share[above]
        rest = still * ~share.any(axis=1, keepdims=True)
        bones = np.eye(len(LANDMARKS))
        for row in (FINGERS.index(name) for name in hand.fingers):
            for k in range(3):
                i = BASES[row] + k
                factor = person.bone_factors[row, k]
                bones[i + 1] = bones[i] + factor * (np.eye(21)[i + 1] - np.eye(21)[i])
        size = person.anatomy.hand_length / _length(hand, still)
        self._share, self._rest = size * bones @ share, size * bones @ rest

    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        """See ``HandModel``."""
        points, jacobian = self._points.at(angles)
        tips = np.einsum("tk,kim->tim", self._share[list(TIPS)], jacobian)
        return self._share @ points + self._rest, tips


def _length(hand: Hand, points: Float[np.ndarray, "21 3"]) -> float:
    """Wrist to middle fingertip along the bones, or to that of the second finger [m]."""
    row = FINGERS.index(hand.fingers[min(2, len(hand.fingers) - 1)])
    chain = points[[0, *range(BASES[row], BASES[row] + 4)]]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


class ReachingHand:
    """A hand whose fingertips go where they are wanted, as far as joints and their speed allow.

    Args:
        model: its kinematics.

    Attributes:
        angles: (m,) joint angles [rad].
    """

    def __init__(self, model: HandModel) -> None:
        self._model = model
        self.angles: Float[np.ndarray, " m"] = np.array(model.relaxed)

    @property
    def landmarks(self) -> Float[np.ndarray, "21 3"]:
        """(21, 3) of the hand as it is [m]."""
        return self._model.landmarks(self.angles)[0]

    def tracked(self, noise: Float[np.ndarray, " m"]) -> Float[np.ndarray, "21 3"]:
        """(21, 3) landmarks [m] as a glove gives them that measures joint angles.

        Args:
            noise: (m,) error of each angle [rad].
        """
        return self._model.landmarks(self.angles + noise)[0]

    def reach(
        self, tips: Float[np.ndarray, "5 3"], seconds: float, rounds: int = 1
    ) -> Float[np.ndarray, "21 3"]:
        """Move the fingertips towards goals.

        Args:
            tips: (5, 3) thumb first [m]; NaN for a finger that stays relaxed.
            seconds: since the last call [s]; infinite for no limit of the speed.
            rounds: of Gauss-Newton, from the last angles.

        Returns:
            (21, 3) landmarks [m].
        """
        model, start = self._model, self.angles
        wanted = np.isfinite(tips).all(axis=1)
        goals = tips[wanted]
        x = start
        for _ in range(rounds):
            points, derivatives = model.landmarks(x)
            jacobian = derivatives[wanted].reshape(-1, len(x)) / _TIP_M
            error = (goals - points[list(TIPS)][wanted]).ravel() / _TIP_M
            posture, motion = (model.relaxed - x) / _POSTURE**2, (start - x) / _MOTION**2
            pull = jacobian.T @ error + posture + motion
            # A joint at its limit that is wanted beyond it takes no part.
            stuck = ((x <= model.lower) & (pull < 0)) | ((x >= model.upper) & (pull > 0))
            jacobian = jacobian * ~stuck
            hessian = jacobian.T @ jacobian
            hessian += np.diag(1 / _POSTURE**2 + 1 / _MOTION**2 + 1e6 * stuck)
            x = np.clip(x + np.linalg.solve(hessian, pull * ~stuck), model.lower, model.upper)
        most = _FASTEST * seconds
        self.angles = start + np.clip(x - start, -most, most)
        return self.landmarks
