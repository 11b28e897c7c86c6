"""What all simulated hands share: motors with a limited speed, faults, and transports."""

from __future__ import annotations

import contextlib
import os
import select
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np


class Motors:
    """Motors that run to their targets at a limited speed.

    Attributes:
        targets: Where each motor goes, in the unit of the device.
        speed: Largest speed of each motor in units per second.
        powered: False for a motor without torque; it stays where it is.
        stuck: Motors that something holds; they stay, and their current is `stall_current`.
        temperatures: °C.
        stall_current: Current of a motor that is stuck; of one that moves it is 150.
    """

    def __init__(
        self, start: Sequence[float], speed: float, *, stall_current: float = 800.0
    ) -> None:
        self._clock = time.monotonic
        self._lock = threading.RLock()
        self._positions = np.array(start, dtype=float)
        self._time = self._clock()
        self.targets = self._positions.copy()
        self.speed = np.full(len(self._positions), float(speed))
        self.powered = np.ones(len(self._positions), dtype=bool)
        self.stuck: set[int] = set()
        self.temperatures = np.full(len(self._positions), 30.0)
        self.stall_current = stall_current

    def __len__(self) -> int:
        return len(self._positions)

    @property
    def _free(self) -> np.ndarray:
        free = self.powered.copy()
        free[list(self.stuck)] = False
        return free

    @property
    def positions(self) -> np.ndarray:
        """The positions now."""
        with self._lock:
            now = self._clock()
            reach = self.speed * (now - self._time) * self._free
            self._time = now
            self._positions += np.clip(self.targets - self._positions, -reach, reach)
            return self._positions.copy()

    @property
    def velocities(self) -> np.ndarray:
        """Signed speeds now: 0, or the largest speed of a motor that is on its way."""
        return np.sign(self.targets - self.positions) * self.speed * self._free

    @property
    def currents(self) -> np.ndarray:
        """Unsigned currents now."""
        away = self.powered & ~np.isclose(self.targets, self.positions)
        currents = np.where(away, 150.0, 0.0)
        for motor in self.stuck:
            currents[motor] = self.stall_current if away[motor] else 0.0
        return currents

    def move(self, targets: Iterable[float], motors: Iterable[int] | None = None) -> None:
        """Send motors (all of them by default) to their targets."""
        with self._lock:
            _ = self.positions  # what was reached on the way to the old targets
            numbers = range(len(self)) if motors is None else motors
            for motor, target in zip(numbers, targets, strict=True):
                self.targets[motor] = target

    def set_speed(self, motor: int, speed: float) -> None:
        """Limit the speed of one motor from now on."""
        with self._lock:
            _ = self.positions
            self.speed[motor] = speed

    def set_power(self, on: bool, motors: Iterable[int] | None = None) -> None:
        """Switch the torque of motors (all of them by default)."""
        with self._lock:
            _ = self.positions
            for motor in range(len(self)) if motors is None else motors:
                self.powered[motor] = on

    def place(self, positions: Sequence[float]) -> None:
        """Put the motors somewhere at once, as a hand that is moved by hand or just switched on."""
        with self._lock:
            _ = self.positions
            self._positions[:] = positions
            self.targets[:] = positions


class Faults:
    """Faults of a connection, which a test switches on while a driver runs.

    Args:
        kinds: kinds of wrong answers that the device can give.

    Attributes:
        silent: True while the device is without power or unplugged: it hears and says nothing.
        delay_s: time that each answer takes [s].
        garbled: kind of fault of all answers; empty while they are right.
    """

    def __init__(self, *kinds: str) -> None:
        self.silent, self.delay_s, self.garbled = False, 0.0, ""
        self.kinds = kinds
        self._wrong: list[str] = []

    def answer_wrongly(self, kind: str, times: int = 1) -> None:
        """Make the next answers wrong, for example with "checksum", "identifier" or "short"."""
        if kind not in self.kinds:
            raise ValueError(f"kind of wrong answer: expected one of {self.kinds}, got {kind!r}")
        self._wrong += [kind] * times

    def next_wrong(self) -> str:
        """The fault of the answer that is being sent; empty if it is right."""
        time.sleep(self.delay_s)
        return self._wrong.pop(0) if self._wrong else self.garbled


class SerialLine:
    """A serial line to a simulated device: a pseudo terminal, where the platform has one.

    The device has `receive(data)`, which returns the bytes of its answers, and `poll()` if it sends
    by itself. `port` is the path that a driver opens. It stays the same after `unplug` and `plug`.
    """

    def __init__(self, device: Any, *, echo: bool = False) -> None:
        if not hasattr(os, "openpty"):
            raise OSError("this platform has no pseudo terminals: give bytes to `device.receive`")
        self.device = device
        self.echo = echo
        self._folder = tempfile.TemporaryDirectory()
        self.port = str(Path(self._folder.name) / "serial")
        self._lock = threading.Lock()
        self._ends: tuple[int, int] | None = None
        self._closed = threading.Event()
        self.plug()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> SerialLine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def plug(self) -> None:
        """Put the adapter into the computer."""
        import tty

        with self._lock:
            if self._ends is None:
                self._ends = os.openpty()
                tty.setraw(self._ends[1])
                os.symlink(os.ttyname(self._ends[1]), self.port)

    def unplug(self) -> None:
        """Pull the adapter out of the computer: the open port fails, and its path is gone."""
        with self._lock:
            if self._ends is not None:
                os.unlink(self.port)
                for end in self._ends:
                    os.close(end)
                self._ends = None

    def send(self, data: bytes) -> None:
        """Put bytes on the line that no one asked for, for example noise."""
        with self._lock:
            if self._ends is not None:
                os.write(self._ends[0], data)

    def second_program(self, request: bytes) -> None:
        """Let another program on the same line ask the device: the driver hears the answer."""
        answer = self.device.receive(request)
        if answer:
            self.send(answer)

    def close(self) -> None:
        """End the line."""
        self._closed.set()
        self._thread.join()
        self.unplug()
        self._folder.cleanup()

    def _run(self) -> None:
        while not self._closed.is_set():
            with self._lock:
                master = None if self._ends is None else self._ends[0]
            if master is None:
                time.sleep(0.005)
                continue
            if hasattr(self.device, "poll") and (unasked := self.device.poll()):
                self.send(unasked)
            try:
                select.select([master], [], [], 0.01)
            except (OSError, ValueError):
                continue  # the adapter was pulled out just now
            with self._lock:  # another thread must not close the port between the check and reading
                if self._ends is None or self._ends[0] != master:
                    continue
                if not select.select([master], [], [], 0.0)[0]:
                    continue
                data = os.read(master, 4096)
            if self.echo:
                self.send(data)
            answer = self.device.receive(data)
            if answer:
                self.send(answer)


@contextlib.contextmanager
def serve_can(device, bus) -> Iterator[None]:  # type: ignore[no-untyped-def]
    """Let a device answer on a CAN bus in a thread until the block ends; then shut the bus down.

    The device has `answer(message)`, and `poll()` if it sends by itself; both return messages.
    """
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            frame = bus.recv(0.005)
            messages = [] if frame is None else device.answer(frame)
            if hasattr(device, "poll"):
                messages = [*messages, *device.poll()]
            for message in messages:
                bus.send(message)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        bus.shutdown()
