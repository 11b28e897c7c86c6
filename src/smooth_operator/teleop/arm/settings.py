"""Arm settings for the command line. This module is quick to import."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import radians
from pathlib import Path

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.simulation.arms.arm import ArmSpec, CarriedHand, HandMount, rigid
from smooth_operator.simulation.arms.catalogue import arm_named
from smooth_operator.teleop.components import settings_from_text
from smooth_operator.types import Side


@dataclass(frozen=True)
class ArmSettings:
    """Settings that choose the arm that carries a hand and how the hand is mounted.

    Attributes:
        name: ``panda``, ``ur5e``, ``xarm7``, ``iiwa14``, ``so101``, or a URDF or MJCF file.
        adapter: thickness of the plate between flange and hand [m].
        roll: roll of the hand about the flange's axis [degrees]; by default that of the arm.
        spacing: distance between the bases of two arms [m]; each arm stays on its side of the
            middle.
        table: height of the table above the bases [m].
        no_table: True for arms without a table.
        collisions: True to avoid collisions between parts.
        tip: link of the file to which the hand is attached; its z points out of the arm.
        posture: joint positions of an arm from a file at the start [degrees], such as
            ``0/-45/60``; by default the middle of each range.

    Raises:
        ConfigError, UnknownNameError: a setting is out of its range, or there is no such arm.
    """

    name: str
    adapter: float = 0.02
    roll: float | None = None
    spacing: float = 1.0
    table: float = 0.0
    no_table: bool = False
    collisions: bool = True
    tip: str = ""
    posture: str = ""

    def __post_init__(self) -> None:
        check_range("arm: adapter", self.adapter, 0.0, 0.3, "m")
        if self.roll is not None and not math.isfinite(self.roll):
            raise ConfigError(f"arm: roll must be an angle in degrees, not {self.roll}")
        check_range("arm: spacing", self.spacing, 0.4, 3.0, "m")
        check_range("arm: table", self.table, -1.0, 1.0, "m")
        if not self._from_file:
            arm_named(self.name)
            if self.tip or self.posture:
                raise ConfigError(
                    "arm: tip and posture can only be set for an arm from a file; remove them"
                )

    @property
    def _from_file(self) -> bool:
        return Path(self.name).suffix.lower() in (".urdf", ".xml", ".mjcf")

    @cached_property
    def spec(self) -> ArmSpec:
        """Description of the chosen arm.

        Raises:
            ConfigError, HandModelError: the file can't be read, or the settings do not fit it.
        """
        if not self._from_file:
            return arm_named(self.name)
        from smooth_operator.simulation.arms.arm_file import arm_from_file

        try:
            angles = [radians(float(part)) for part in self.posture.split("/") if self.posture]
        except ValueError as error:
            raise ConfigError(
                f"arm: posture must be degrees, such as 0/-45/60, not {self.posture!r}"
            ) from error
        return arm_from_file(Path(self.name), self.tip, angles or None)


def read_arm(text: str) -> ArmSettings:
    """Parses settings such as ``panda`` or ``panda:roll=90,adapter=0.03``.

    Raises:
        ConfigError, UnknownNameError: a setting is unknown or can't be read.
    """
    name, _, rest = text.partition(":")
    settings = settings_from_text(ArmSettings, f"{name}{',' * bool(rest)}{rest}", "arm", name)
    assert isinstance(settings, ArmSettings)
    return settings


def place_arms(settings: ArmSettings, hands: Mapping[Side, Hand]) -> dict[Side, CarriedHand]:
    """Mounts each hand on its arm, in the arm's nominal posture. Two arms stand side by side.

    Args:
        hands: side -> robot hand.
    """
    arm = settings.spec
    roll = arm.roll if settings.roll is None else radians(settings.roll)
    apart = settings.spacing / 2 if len(hands) > 1 else 0.0
    return {
        side: CarriedHand(
            arm,
            HandMount(hand, settings.adapter, roll, arm.mount_of(hand.name)),
            np.array(arm.nominal),
            rigid(np.eye(3), (0.0, -apart if side == "right" else apart, 0.0)),
        )
        for side, hand in hands.items()
    }
