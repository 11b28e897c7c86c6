"""The arms of a run: each hand on its arm, on its place in the room, with its controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.teleop.arm.controller import ArmControlConfig, ArmController
from smooth_operator.teleop.arm.places import place_arms
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.types import Side


@dataclass(frozen=True, eq=False)
class ArmOfHand:
    """An arm with its hand.

    Attributes:
        carried: what a simulation and a page build.
        controller: what the loop asks.
    """

    carried: CarriedHand
    controller: ArmController


def build_arms(settings: ArmSettings, hands: Mapping[Side, Hand]) -> dict[Side, ArmOfHand]:
    """An arm for each hand; between two there is a wall.

    Args:
        settings: of all arms.
        hands: side -> robot hand.

    Raises:
        ConfigError: an arm can't reach its home pose with the hand.
    """
    built = {}
    for side, carried in place_arms(settings, hands).items():
        controller = ArmController(
            carried.arm,
            carried.mount,
            ArmControlConfig(collisions=settings.collisions),
            table=None if settings.no_table else settings.table,
            wall=-float(carried.base[1, 3]) if len(hands) > 1 else None,
        )
        built[side] = ArmOfHand(replace(carried, home=controller.home), controller)
    return built
