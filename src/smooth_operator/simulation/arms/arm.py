"""Description of a robot arm: kinematics, limits, and capsules around its links."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Capsule:
    """A link's shape: all that is within a radius of a line, in the link's frame [m]."""

    start: Point
    end: Point
    radius: float


@dataclass(frozen=True)
class Link:
    """A joint and the link that it turns.

    The frame is that of the modified Denavit-Hartenberg convention (Craig): from the link before,
    turn by ``alpha`` about x, move by ``a`` along x and by ``d`` along the new z, which is the
    joint's axis.

    Attributes:
        joint: name of the joint, as in the maker's own description and in MuJoCo Menagerie.
        alpha: [rad].
        a: [m].
        d: [m].
        limits: of the position [rad].
        velocity: most, by the maker's data sheet [rad/s].
        acceleration: most [rad/s^2].
        torque: most [N m].
        mass: of the link [kg].
        capsules: around it.
    """

    joint: str
    alpha: float
    a: float
    d: float
    limits: tuple[float, float]
    velocity: float
    acceleration: float
    torque: float
    mass: float
    capsules: tuple[Capsule, ...]


@dataclass(frozen=True)
class ArmSpec:
    """A robot arm.

    Attributes:
        name: in the catalogue.
        title: as its maker calls it.
        links: from the base.
        flange: of the last link, along its z [m].
        base: capsules of what stands on the table, in the base frame: z up, x forward.
        nominal: (n,) position of the joints that the arm prefers [rad].
        home: (3,) where the hand's wrist starts in the base frame [m].
        pitch: how far the fingers point down there [rad].
        roll: of a hand about the flange's z, so that its back points up there [rad].
        reach: of the flange, by the data sheet [m].
        sources: of the figures.
        back: how much farther from a task it stands than its home pose has it, for hands whose
            fingers are level there [m].
        notes: what is not the maker's figure.
    """

    name: str
    title: str
    links: tuple[Link, ...]
    flange: float
    base: tuple[Capsule, ...]
    nominal: tuple[float, ...]
    home: Point
    pitch: float
    roll: float
    reach: float
    sources: tuple[str, ...]
    back: float = 0.0
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if len(self.nominal) != len(self.links):
            raise ConfigError(
                f"arm {self.name!r}: expected {len(self.links)} nominal positions, "
                f"not {len(self.nominal)}"
            )
        for link, q in zip(self.links, self.nominal, strict=True):
            low, high = link.limits
            if not low < q < high:
                raise ConfigError(
                    f"arm {self.name!r}: the nominal position {q} of {link.joint} is not within "
                    f"its limits {low} to {high}"
                )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) names of the joints, from the base."""
        return tuple(link.joint for link in self.links)

    @cached_property
    def limits(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) limits of the positions [rad]."""
        return np.array([link.limits for link in self.links])

    @cached_property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """(n,) limits of the velocities [rad/s]."""
        return np.array([link.velocity for link in self.links])

    @cached_property
    def acceleration(self) -> Float[np.ndarray, " n"]:
        """(n,) limits of the accelerations [rad/s^2]."""
        return np.array([link.acceleration for link in self.links])
