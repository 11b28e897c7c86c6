"""A real hand's sink that is driven as by a loop, and readings of its device."""

import contextlib
import functools
import threading
import time
from dataclasses import replace

import numpy as np
from hand_rigs import Rig
from ticks import make_tick

from smooth_operator import Hand, load_hand
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.actuator_map import ActuatorMap, BoundMap
from smooth_operator_devices.hands.device import HandDevice, Reading, WrongAnswerError
from smooth_operator_devices.hands.hardware_sink import HardwareSink


def quiet(device: HandDevice) -> Reading | None:
    """A reading; None for a wrong answer."""
    with contextlib.suppress(WrongAnswerError):
        return device.read()
    return None


def read(device: HandDevice, times: int) -> Reading:
    """The last of some readings; a driver reads slow values in turns."""
    for _ in range(times):
        reading = device.read()
    return reading


@functools.cache
def hand_of(name: str) -> Hand:
    return load_hand(name, side="right")


def within(table: ActuatorMap, share: float) -> np.ndarray:
    """Commands at a share of the way between the ends, for each actuator."""
    low, high = np.array([actuator.ends for actuator in table.actuators]).T
    return low + share * (high - low)


class Driven:
    """A sink that gets a command every few milliseconds, as from a loop."""

    def __init__(self, rig: Rig, **settings: object) -> None:
        self.sink: HardwareSink = rig.build(**settings)
        self.table = self.sink.actuators("right")
        self.hand = hand_of(self.table.hand)
        self.bound = BoundMap(self.table, self.hand)
        self.tick: Tick | None = None
        self.longest = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Driven":
        self.sink.open({"right": self.hand}, {})
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self.sink.close()

    def _run(self) -> None:
        while not self._done.wait(0.005):
            if self.tick is not None:
                begin = time.thread_time()
                self.sink.send(self.tick)
                self.longest = max(self.longest, time.thread_time() - begin)

    def ask(self, share: float) -> np.ndarray:
        """Ask for the joints at a share of each actuator's way; returns the commands."""
        commands = within(self.table, share)
        self.ask_joints(self.bound.joints(commands))
        return commands

    def ask_joints(self, joints: np.ndarray) -> None:
        joints = np.where(np.isfinite(joints), joints, 0.0)
        tick = make_tick(self.hand)
        self.tick = replace(tick, command=JointCommand(joints, self.hand.joint_names, 0.0))

    def statistics(self) -> dict[str, float]:
        return self.sink.figures
