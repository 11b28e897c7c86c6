"""The base class of sinks: where the joint commands of a running loop go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

if TYPE_CHECKING:  # the command line names sinks in its help, and that must not import JAX
    from smooth_operator.hands.hand import Hand
    from smooth_operator.simulation.arms.carried import CarriedHand
    from smooth_operator.simulation.live import LiveSimulation


class Sink(ABC):
    """Where commands go: a robot, a simulation, a file, a bus.

    Subclasses are dataclasses of settings. The loop calls ``send`` from one thread and never waits
    for the far side: a sink that may have to wait keeps the newest command for its own thread.
    A sink that raises is closed, opened again after a while, and does not stop the others.
    """

    observes: ClassVar[bool] = False
    """Whether the sink only looks on and moves nothing, as a log or a table. It then gets its ticks
    after the others, with the time that those took among the stages."""

    @property
    @abstractmethod
    def label(self) -> str:
        """What it is, in a few words."""

    @property
    def note(self) -> str:
        """What a person should know of it now, such as a warning; empty for nothing."""
        return ""

    @property
    def simulation(self) -> LiveSimulation | None:
        """The simulated hands that the commands move; None if the sink simulates nothing."""
        return None

    @property
    def figures(self) -> Mapping[str, Any]:
        """Counts and times for the summary of a run, as plain values; empty for none."""
        return {}

    @property
    def measures(self) -> bool:
        """Whether ``state`` has something once the sink is open; as a simulation does."""
        return self.simulation is not None

    def state(self, side: Side) -> HandState | None:
        """Where the hand that it moves was when that was last measured; safe from any thread.

        None, as by default, if it measures nothing, is not open, or has no such hand.
        """
        del side
        return None

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Where the arm that it moves has the wrist of a hand, when that was last measured.

        In the frame of the robot's base: x y z [m], unit quaternion w x y z. Called on the loop's
        thread, so it must be quick. None, as by default, if it moves no arm or is not open.
        """
        del side
        return None

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """Where the joints of the arm of a hand were, when they were last measured [rad].

        In the order of ``ArmCommand.joint_names``; safe from any thread. None, as by default, if it
        moves no arm or is not open.
        """
        del side
        return None

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """Take note of the arms that carry the hands, before ``check`` and ``open``.

        By default nothing happens: ticks have the arms' commands.
        """
        del arms

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Find out what would keep the sink from opening, before anything slow is done.

        Nothing stays open. Without its own check, a sink fails when it is opened.

        Raises:
            SmoothOperatorError: as ``open``.
        """
        del hands

    @abstractmethod
    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Get ready for the commands of these hands; may be called again after ``close``.

        Args:
            hands: side -> robot hand.
            config: the resolved configuration of the run, JSON-serialisable, for sinks that keep
                it.

        Raises:
            SinkError: it can't be opened.
            OutputError: its file can't be written.
            MissingExtraError: a library that it needs is not installed.
        """

    @abstractmethod
    def send(self, tick: Tick) -> None:
        """Hand over a command, in well under a millisecond.

        Raises:
            SinkError: the far side is gone.
            OutputError: the disk is full.
        """

    def stalled(self, seconds: float) -> None:
        """No command has come for so long [s]; called from the watchdog's thread.

        Called again and again while the silence lasts. By default nothing happens.
        """
        del seconds

    @abstractmethod
    def close(self) -> None:
        """Write what is pending and give everything back; a second call does nothing."""


def simulated_hands(sinks: Iterable[Sink]) -> LiveSimulation | None:
    """The first simulation among sinks; None without any."""
    return next((sink.simulation for sink in sinks if sink.simulation is not None), None)
