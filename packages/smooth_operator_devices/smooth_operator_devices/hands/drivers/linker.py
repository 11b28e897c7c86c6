"""Driver of the LinkerHand L10 and L20 on a CAN bus.

Facts of the protocol, from the maker's SDK as published: frames with an 11-bit identifier, 0x27 for
a right hand and 0x28 for a left one, at 1 Mbit/s. The first byte says what the frame is about, the
others are one value from 0 to 255 per motor; most motors are open at 255. A frame of positions sets
them, and the hand answers with where the motors are; without values it only answers. L10: six
motors in 0x01, four in 0x04; speed 0x05 and 0x06, torque 0x02 and 0x03, temperatures 0x33 and 0x34,
faults 0x35 and 0x36, five values each. L20: roots of the fingers 0x01, their sideways motors 0x02,
roll of the thumb 0x03 (first value), tips 0x04; speed 0x05, current 0x06, faults 0x07.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    HandDevice,
    Reading,
    Setting,
    WrongAnswerError,
)
from smooth_operator_devices.hands.drivers.can_bus import CanBus, can_port
from smooth_operator_devices.hands.hardware_sink import HardwareSink


@dataclass(frozen=True)
class Model:
    """Frames of one model.

    Attributes:
        positions: kind of frame -> how many motors, in the order of the table.
        width: values in each of those frames.
        speeds: kinds of the frames of speeds, five motors each.
        limits: kinds of the frames that limit torque or current, five motors each.
        temperatures: kinds of the frames of temperatures, five motors each.
        faults: kinds of the frames of faults; five motors each, or five fingers.
    """

    positions: dict[int, int]
    width: dict[int, int]
    speeds: tuple[int, ...]
    limits: tuple[int, ...]
    temperatures: tuple[int, ...]
    faults: tuple[int, ...]

    @property
    def motors(self) -> int:
        """Number of motors."""
        return sum(self.positions.values())


MODELS: Final = {
    "l10": Model(
        {1: 6, 4: 4}, {1: 6, 4: 4}, (0x05, 0x06), (0x02, 0x03), (0x33, 0x34), (0x35, 0x36)
    ),
    "l20": Model({1: 5, 2: 5, 3: 1, 4: 5}, {1: 5, 2: 5, 3: 5, 4: 5}, (0x05,), (0x06,), (), (0x07,)),
}
"""Name of a model -> its frames."""

_FINGERS: Final = ("thumb", "index", "middle", "ring", "little")
_IDENTIFIERS: Final = {"right": 0x27, "left": 0x28}
"""Identifier of the frames by the hand's side, as the maker's code chooses it: its C++ header
(enumeration of sides), its Python SDK (constructor) and its package ``linkerbot-py``. One name of a
variable in the maker's file of the L20 says the opposite."""
_SPEED: Final = 250
"""Default speed: not 255, the likely value after a restart, so that a restart is noticed."""

_TIMEOUT: Final = 0.05
"""Time that an answer may take [s]."""


@dataclass(frozen=True)
class LinkerSink(HardwareSink):
    """Moves a LinkerHand L10 or L20; see ``HardwareSink``.

    Attributes:
        port: a CAN channel, ``can0`` or ``INTERFACE:CHANNEL`` of python-can.
        model: model of the hand, which also chooses the table, unless one is named. By default that
            of the run's hand.
    """

    driver: ClassVar[str] = "linker"

    port: str = "can0"
    model: Literal["l10", "l20"] | None = None

    def table_of(self, hand: str) -> str:
        """The table of the model; see ``HardwareSink``."""
        return self.table or f"linker_{self._model_of(hand)}"

    def _model_of(self, hand: str) -> str:
        return self.model or ("l10" if hand == "linker_l10" else "l20")

    @property
    def bus(self) -> str:
        """The CAN channel, with its interface."""
        return "can:" + ":".join(can_port(self.port))

    def device(self, actuators: ActuatorMap) -> LinkerDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(LinkerDevice.name, "linker", "can")
        return LinkerDevice(actuators, self.port, self._model_of(actuators.hand))


class LinkerDevice(HandDevice):
    """A LinkerHand on its bus; see ``HandDevice``.

    The hand has no command that switches its motors off, so ``relax`` does nothing. It reports no
    currents.

    Args:
        table: table of the hand. ``limit`` is the hand's torque (L10) or current (L20), 0 to 255.
            Its settings may have ``speed`` (0 to 255) and ``gap_ms``, the time between two frames.
    """

    driver, name, motors = "linker", "a LinkerHand", 0

    def __init__(self, table: ActuatorMap, port: str, model: str) -> None:
        super().__init__(table)
        self._model = MODELS[model]
        table.check_count(self._model.motors, f"a LinkerHand {model.upper()}")
        speed = self._setting("speed", _SPEED, 1, 255)
        if (table.limits > 255).any() or (table.limits < 1).any():
            raise ConfigError(f"{table.file}: limit must be 1 to 255, the hand's own unit")
        self._port, self._identifier = port, _IDENTIFIERS[table.side]
        self._gap = self._setting("gap_ms", 1.0, 0, 20) / 1000
        self._settings = {kind: [speed] * 5 for kind in self._model.speeds}
        if np.isfinite(table.limits).any():
            limits = np.nan_to_num(table.limits, nan=255.0).astype(int).tolist()
            for k, kind in enumerate(self._model.limits):
                self._settings[kind] = limits[5 * k : 5 * k + 5]
        self._bus: CanBus | None = None
        self._answers: dict[int, bytes] = {}
        self._turn = 0
        self._sent = 0.0

    def open(self) -> None:
        """Open the bus, check that every motor answers, set limits; see ``HandDevice``."""
        self._bus = CanBus(self._port, "linker")
        self._answers, self._turn = {}, 0
        self._limited = False
        other = "left" if self._table.side == "right" else "right"
        with self._opening(
            f"check power and cable, and that it is not a {other} hand, which has the "
            f"identifier 0x{_IDENTIFIERS[other]:X}"
        ):
            self.read()
        self._limit()

    def _limit(self) -> None:
        """Send speed, and torque or current, which a restart of the hand deletes."""
        for kind, values in self._settings.items():
            self._send(kind, values)

    def settings(self) -> Sequence[Setting]:
        """Speed, and torque or current, as the hand answers; see ``HandDevice``.

        Raises:
            WrongAnswerError: the hand reports none of them.
        """
        bus = self._open_bus()
        self._collect(bus, time.perf_counter())  # echoes of what was set before
        for kind in self._settings:
            self._answers.pop(kind, None)
            self._send(kind, [])
        self._collect(bus, time.perf_counter() + _TIMEOUT, list(self._settings))
        answers = {kind: list(self._answers.pop(kind, b"")) for kind in self._settings}
        if not any(answers.values()):
            raise WrongAnswerError("linker: the hand does not report its limit")
        return [
            Setting(f"frame 0x{kind:02X}", np.array(values), np.array(answer[: len(values)]))
            for kind, values in self._settings.items()
            if len(answer := answers[kind]) >= len(values)
        ]

    def read(self) -> Reading:
        """Positions, and in turns temperatures and faults; see ``HandDevice``."""
        bus = self._open_bus()
        self._collect(bus, time.perf_counter())  # answers to the last ``write``
        for kind in self._model.positions:
            if kind not in self._answers:
                self._send(kind, [])
        slow = self._model.temperatures + self._model.faults
        self._send(slow[self._turn % len(slow)], [])
        self._turn += 1
        deadline = time.perf_counter() + _TIMEOUT
        while missing := [k for k in self._model.positions if k not in self._answers]:
            self._collect(bus, deadline, missing)
            if time.perf_counter() >= deadline:
                break
        if missing:
            for kind in self._model.positions:  # a later reading must not use them
                self._answers.pop(kind, None)
            raise WrongAnswerError(
                f"linker: the hand did not answer frame 0x{missing[0]:02X} within {_TIMEOUT:g} s"
            )
        positions: list[int] = []
        for kind, motors in self._model.positions.items():
            values = self._answers.pop(kind)
            if len(values) < motors:
                raise WrongAnswerError(
                    f"linker: frame 0x{kind:02X} of the hand has {len(values)} values, not {motors}"
                )
            positions += values[:motors]
        heat = b"".join(self._answers.get(kind, b"") for kind in self._model.temperatures)
        whole = len(heat) >= self._model.motors
        return Reading(
            positions=np.array(positions, float),
            temperatures=np.array([*heat[: self._model.motors]], float) if whole else None,
            errors=self._errors(),
        )

    def _collect(self, bus: CanBus, deadline: float, fields: list[int] | None = None) -> None:
        """Take frames of the hand until all requested ones are there, or until a time."""
        for identifier, data in bus.until(deadline):
            if identifier == self._identifier and data:
                self._answers[data[0]] = data[1:]
            if fields is not None and all(kind in self._answers for kind in fields):
                return

    def _errors(self) -> tuple[str, ...]:
        codes = b"".join(self._answers.get(kind, b"") for kind in self._model.faults)
        names = self._table.names if len(self._model.faults) == 2 else _FINGERS
        pairs = zip(names, codes, strict=False)
        return tuple(f"{name}: fault 0x{code:02X}" for name, code in pairs if code)

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send the positions, 0 to 255, the first time after the limits; see ``HandDevice``."""
        if not self._limited:
            self._limit()
            self._limited = True
        values = np.clip(np.rint(commands), 0, 255).astype(int).tolist()
        bus = self._open_bus()
        self._collect(bus, time.perf_counter())
        for kind, motors in self._model.positions.items():
            self._answers.pop(kind, None)
            mine, values = values[:motors], values[motors:]
            self._send(kind, mine + [0] * (self._model.width[kind] - motors))

    def close(self) -> None:
        """Give the bus back; the hand keeps its last target. See ``HandDevice``."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _open_bus(self) -> CanBus:
        if self._bus is None:
            raise self._not_open()
        return self._bus

    def _send(self, kind: int, values: list[int]) -> None:
        """Send a frame, not too soon after the last one, or the hand loses it."""
        wait = self._sent + self._gap - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        self._open_bus().send(self._identifier, bytes([kind, *values]))
        self._sent = time.perf_counter()
