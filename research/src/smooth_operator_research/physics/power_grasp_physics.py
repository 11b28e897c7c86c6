"""A hand under physics that is handed an object into its open palm."""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import reference_landmarks
from smooth_operator.landmarks import BASES, FINGERS
from smooth_operator_research.physics.grasp_objects import GraspObject
from smooth_operator_research.physics.grasp_physics import GraspPhysics, frame_of

_CLEAR: Final = 0.001  # between the object and the hand where it appears [m]
_FROM: Final = 0.16  # in front of the palm, where the way to it begins [m]
_STEP: Final = 0.002  # of that way [m]
_ALONG: Final = (0.0, -0.01, 0.01, -0.02, 0.02, -0.03, 0.03)
"""Places along the fingers' direction, from the row of the finger bases [m]."""
_ASIDE: Final = (0.0, -0.01, -0.02, -0.03, -0.04)
"""Places towards the thumb [m]; a long object may have to lie next to it."""
_YAWS: Final = (0.0, np.radians(20.0), np.radians(-20.0))
"""How a long object is turned in front of the palm [rad]."""
_WORTH: Final = 0.2
"""How much nearer to the palm it must come for each metre that it lies off the middle."""


class PowerGraspPhysics(GraspPhysics):
    """A hand and an object that a person lays into its palm; all of the hand can touch it.

    Args:
        hand: the robot hand.
        thing: the object.
        timestep: of the physics [s].
        bandwidth: of the servos [Hz].
    """

    def __init__(
        self, hand: Hand, thing: GraspObject, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        super().__init__(hand, thing, timestep, bandwidth)
        bases = [BASES[FINGERS.index(name)] for name in hand.fingers if name != "thumb"]
        row = reference_landmarks(hand)[bases].mean(axis=0)
        at, turn = self.scene.mount.palm
        self._row = at + turn @ row

    def begin(self, pose: Float[np.ndarray, " n"]) -> None:
        """Stand at rest in a pose, with the object out of the way.

        Args:
            pose: (n,) positions of all joints [rad].
        """
        self._stand(pose, self._touching.own)

    def appear(self) -> float:
        """Lay the object into the palm; from now on it can be touched.

        It comes from the front, across the palm, to where it is nearest to the palm without
        touching the hand. Somebody holds it loosely: it has no weight, and yields against a drag.

        Returns:
            how far its centre is in front of the row of the finger bases [m].
        """
        distal, radial, palmar = self.scene.mount.directions.T
        best, where, turn = (np.inf, 0.0), self._row, np.zeros(4)
        for yaw, aside, along in itertools.product(_YAWS, _ASIDE, _ALONG):
            axis = np.cos(yaw) * radial + np.sin(yaw) * distal
            turned = frame_of(palmar, axis)
            place = self._row + along * distal + aside * radial
            depth = self._depth(place, palmar, turned)
            cost = depth + _WORTH * (abs(aside) + abs(along))
            if cost < best[0] - 1e-9:
                best, where, turn = (cost, depth), place, turned
        self._put(where + best[1] * palmar, turn)
        self._solid(True)
        return best[1]

    @property
    def grip(self) -> float:
        """See ``GraspPhysics``: the fingers on one side, palm and thumb on the other."""
        force, _, palm, _ = self._touching.read(self._data)
        return float(min(force[1:].sum(), palm + force[0]))

    def _depth(
        self,
        place: Float[np.ndarray, "3"],
        palmar: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "4"],
    ) -> float:
        """How near to a place the object comes from the front [m]."""
        depth = _FROM
        while depth > -_FROM:
            self._put(place + (depth - _STEP) * palmar, turn)
            room = self._room()
            if room < _CLEAR:
                break
            depth -= max(_STEP, _STEP * np.floor((room - _CLEAR) / _STEP))
        return depth
