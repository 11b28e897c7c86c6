"""A hand on an arm that stands on an empty table, under physics."""

from __future__ import annotations

import mujoco

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.physics_model import FURNISHED
from smooth_operator.simulation.scenes.scene import empty_world


class ArmPhysics(HandPhysics):
    """A hand on an arm. Its world's floor is the table; gravity pulls at nothing but objects.

    Args:
        hand: the robot hand.
        carried: the arm on its place.
        timestep: of the physics [s].
        bandwidth: of the hand's servos [Hz].
    """

    def __init__(
        self, hand: Hand, carried: CarriedHand, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        def furnish(spec: mujoco.MjSpec) -> mujoco.MjSpec:
            spec.option.gravity = (0.0, 0.0, -9.81)
            world = empty_world(spec)
            carried.attach(world, spec, FURNISHED)
            return world

        super().__init__(hand, timestep, bandwidth, furnish=furnish, carried=carried)
