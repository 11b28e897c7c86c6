"""A hand in memory that moves as its motors would, and fails when it is asked to; no bus."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import DeviceLostError, Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.hardware_sink import HardwareSink


class FakeHand:
    """Motors that reach a command within a cycle, unless something blocks them.

    ``calls`` is the history: (what, commands). ``blocked`` maps an actuator to the position that it
    can't pass; its current is then ``stall``.
    """

    def __init__(self, actuators: ActuatorMap) -> None:
        self.table = actuators
        count = len(actuators.actuators)
        self.positions = np.array([sum(a.ends) / 2 for a in actuators.actuators])
        self.currents, self.temperatures = np.zeros(count), np.full(count, 30.0)
        self.errors: tuple[str, ...] = ()
        self.blocked: dict[int, float] = {}
        self.stall = 1000.0
        self.calls: list[tuple[str, np.ndarray]] = []
        self.gone = threading.Event()
        self.hang = threading.Event()
        self.hung = threading.Event()
        self.wrong = 0  # exchanges that fail from now on
        self.wrong_openings = 0
        self.limit = 0.0  # what the hand has in place of the 500 that are set with every opening
        self.slow_s = 0.0

    def _bus(self, what: str, commands: Sequence[float] | np.ndarray = ()) -> None:
        if self.gone.is_set():
            raise DeviceLostError("the cable was pulled")
        if self.hang.is_set():
            self.hung.set()
            while self.hang.is_set():
                time.sleep(0.001)
        if self.slow_s:
            time.sleep(self.slow_s)
        self.calls.append((what, np.array(commands)))
        if self.wrong and what in ("read", "write"):
            self.wrong -= 1
            raise WrongAnswerError("a wrong checksum")

    def open(self) -> None:
        self._bus("open")
        if self.wrong_openings:
            self.wrong_openings -= 1
            raise WrongAnswerError("a wrong checksum")
        self.limit = 500.0

    def settings(self) -> tuple[Setting, ...]:
        self._bus("settings")
        return (Setting("limit", np.full(1, 500.0), np.full(1, self.limit)),)

    def read(self) -> Reading:
        self._bus("read")
        return Reading(
            self.positions.copy(), None, self.currents.copy(), self.temperatures, self.errors
        )

    def write(self, commands: np.ndarray) -> None:
        self._bus("write", commands)
        self.positions = np.array(commands, float)
        for index, stop in list(self.blocked.items()):  # the test's thread changes it
            over = self.positions[index] > stop
            self.positions[index] = min(self.positions[index], stop)
            self.currents[index] = self.stall if over else 0.0

    def relax(self) -> None:
        self._bus("relax")

    def close(self) -> None:
        self.calls.append(("close", np.empty(0)))

    def commands(self) -> np.ndarray:
        """(k, a) all that was written."""
        return np.array([commands for what, commands in self.calls if what == "write"])

    def count(self, what: str) -> int:
        return sum(name == what for name, _ in self.calls)


@dataclass(frozen=True)
class FakeHandSink(HardwareSink):
    """The sink of a ``FakeHand``; ``made`` are the hands, one for each time that it was opened."""

    driver: ClassVar[str] = "fake"
    prepare: Callable[[FakeHand], None] = field(default=lambda hand: None)
    made: list[FakeHand] = field(default_factory=list)

    def device(self, actuators: ActuatorMap) -> FakeHand:
        hand = FakeHand(actuators)
        self.prepare(hand)
        self.made.append(hand)
        return hand


def write_fake_table(path: Path, joints: tuple[str, ...], extra: str = "") -> Path:
    """A table in degrees, 180 at zero, every second actuator reversed; -60 to 60 degrees."""
    lines = [
        'format = 1\ndriver = "fake"\nhand = "any"\nside = "right"\nunit = "deg"\nlimit = 500\n',
        extra,
    ]
    for k, joint in enumerate(joints):
        lines.append(
            f'[[actuators]]\nname = "m{k}"\nid = {k}\njoint = "{joint}"\nzero = 180\n'
            f"sign = {1 - 2 * (k % 2)}\nends = [120, 240]\n"
        )
    path.write_text("\n".join(lines))
    return path
