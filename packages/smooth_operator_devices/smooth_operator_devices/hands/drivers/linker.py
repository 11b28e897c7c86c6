"""Driver of the LinkerHands on a CAN bus: O6, L6, L7, L10, L20 lite, L20, L21, L25 and G20.

Facts of the protocol, by the maker: the package ``linkerbot`` 0.5.4 (O6, L6, L20 lite, L25), the
repository linker-bot/linkerhand-python-sdk, commit b371361 (all of them), and the enumeration of
sides of linker-bot/linkerhand-cpp-sdk. Frames have an 11-bit identifier, 0x27 for a right hand and
0x28 for a left one, at 1 Mbit/s. The first byte is the kind, the others are one value from 0 to 255
per motor; most motors are straight at 255. A frame with values sets them, a frame without values
asks, and the hand answers both with what it measures.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, cast

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import HandDevice, Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.drivers.can_bus import CanBus, CanSink
from smooth_operator_devices.hands.drivers.linker_models import MODELS, Frames
from smooth_operator_devices.hands.drivers.linker_touch import FINGERS, TouchMatrices

_IDENTIFIERS: Final = {"right": 0x27, "left": 0x28}
"""Identifier of the frames by the hand's side, as the maker's code chooses it: its C++ header
(enumeration of sides), its Python SDK (constructor) and its package ``linkerbot``. One name of a
variable in the maker's file of the L20 says the opposite."""
_SPEED: Final = 250
"""Default speed: not 255, the likely value after a restart, so that a restart is noticed."""

_TIMEOUT: Final = 0.05
"""Time that an answer may take [s]."""


@dataclass(frozen=True)
class LinkerSink(CanSink):
    """Moves a LinkerHand (O6, L6, L7, L10, L20, L21, L25, G20); see ``CanSink``.

    Attributes:
        model: model of the hand, which also chooses the table, unless one is named. By default that
            of the run's hand.
    """

    driver: ClassVar[str] = "linker"

    model: (
        Literal["o6", "l6", "l7", "l10", "l20lite", "l20", "l21", "l25", "l25_16", "g20"] | None
    ) = None

    def table_of(self, hand: str) -> str:
        """The table of the model; see ``HardwareSink``."""
        return self.table or f"linker_{self._model_of(hand)}"

    def _model_of(self, hand: str) -> str:
        name = hand.removeprefix("linker_")
        return self.model or (name if name in MODELS else "l20")

    def device(self, actuators: ActuatorMap) -> LinkerDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(LinkerDevice.name, "linker", "can")
        return LinkerDevice(actuators, self.port, self._model_of(actuators.hand))


class LinkerDevice(HandDevice):
    """A LinkerHand on its bus; see ``HandDevice``.

    The hand has no command that switches its motors off, so ``relax`` does nothing.
    ``Reading.currents`` of O6 and L6 are 0 to 255, as the limit; the others report none.
    ``Reading.touch`` is the sum of each touch matrix, in the order of ``Reading.pads``.

    Args:
        table: table of the hand. ``limit`` is the hand's torque, or current (L20), 0 to 255.
            Its settings may have ``speed`` (0 to 255), ``gap_ms``, the time between two frames, and
            ``touch``, 1 for a hand with touch matrices.
    """

    driver, name, motors = "linker", "a LinkerHand", 0

    def __init__(self, table: ActuatorMap, port: str, model: str) -> None:
        super().__init__(table)
        self._model = MODELS[model]
        table.check_count(self._model.motors, f"a LinkerHand {model.upper()}")
        speed = self._setting("speed", _SPEED, 1, 255)
        limits = np.nan_to_num(table.limits, nan=255.0)
        if (limits > 255).any() or (limits < 1).any():
            raise ConfigError(f"{table.file}: limit must be 1 to 255, the hand's own unit")
        self._port, self._identifier = port, _IDENTIFIERS[table.side]
        self._gap = self._setting("gap_ms", 1.0, 0, 20) / 1000
        self._settings = _filled(self._model.speeds, [speed] * self._model.motors)
        if np.isfinite(table.limits).any():
            self._settings |= _filled(self._model.limits, limits.astype(int).tolist())
        self._touch = TouchMatrices(*self._model.touch)
        self._has_touch = self._setting("touch", 0, 0, 1) == 1
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
        bus = self._opened(self._bus)
        self._collect(bus, time.perf_counter())  # echoes of what was set before
        for kind in self._settings:
            self._answers.pop(kind, None)
            self._send(kind, [])
        self._collect(bus, time.perf_counter() + _TIMEOUT, list(self._settings))
        answers = {kind: list(self._answers.pop(kind, b"")) for kind in self._settings}
        if not any(answers.values()):
            raise WrongAnswerError("linker: the hand does not report its limit")
        rows = {**self._model.speeds, **self._model.limits}
        found = []
        for kind, values in self._settings.items():
            if len(answer := answers[kind]) >= len(values):
                k = [k for k, motor in enumerate(rows[kind]) if motor is not None]
                name = f"frame 0x{kind:02X}"
                found.append(Setting(name, np.array(values)[k], np.array(answer)[k]))
        return found

    def read(self) -> Reading:
        """Positions, and in turns temperatures, faults and currents; see ``HandDevice``."""
        bus, model = self._opened(self._bus), self._model
        self._collect(bus, time.perf_counter())  # answers to the last ``write``
        for kind in model.positions:
            if kind not in self._answers:
                self._send(kind, [])
        slow = [*model.temperatures, *model.faults, *model.currents]
        self._send(slow[self._turn % len(slow)], [])
        self._turn += 1
        if self._has_touch:
            self._send(*self._touch.question())
        deadline = time.perf_counter() + _TIMEOUT
        while missing := [k for k in model.positions if k not in self._answers]:
            self._collect(bus, deadline, missing)
            if time.perf_counter() >= deadline:
                break
        answers = {kind: self._answers.pop(kind, b"") for kind in model.positions}
        if missing:
            raise WrongAnswerError(
                f"linker: the hand did not answer frame 0x{missing[0]:02X} within {_TIMEOUT:g} s"
            )
        for kind, row in model.positions.items():
            if len(answers[kind]) < len(row):
                raise WrongAnswerError(
                    f"linker: frame 0x{kind:02X} of the hand has {len(answers[kind])} values, not "
                    f"{len(row)}"
                )
        pads = self._touch.pads
        return Reading(
            positions=cast(np.ndarray, _values(model.positions, answers)),
            currents=_values(model.currents, self._answers),
            temperatures=_values(model.temperatures, self._answers),
            errors=self._errors(),
            touch=np.array([cells.sum() for cells in pads.values()]) if pads else None,
            pads=pads,
        )

    def _collect(self, bus: CanBus, deadline: float, fields: list[int] | None = None) -> None:
        """Take frames of the hand until all requested ones are there, or until a time."""
        for identifier, data in bus.until(deadline):
            if identifier == self._identifier and len(data) > 1:  # no question
                self._answers[data[0]] = data[1:]
                self._touch.take(data)
            if fields is not None and all(kind in self._answers for kind in fields):
                return

    def _errors(self) -> tuple[str, ...]:
        model = self._model
        whole = sum(map(len, model.faults.values())) >= model.motors
        names = self._table.names if whole else FINGERS
        texts = []
        for kind, row in model.faults.items():
            for motor, code in zip(row, self._answers.get(kind, b""), strict=False):
                words = [word for bit, word in enumerate(model.bits) if code >> bit & 1 and word]
                if code and motor is not None:
                    texts.append(f"{names[motor]}: {', '.join(words) or f'fault 0x{code:02X}'}")
        return tuple(texts)

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send the positions, 0 to 255; the first time after the limits, and then clear faults,
        which stop a motor until then. See ``HandDevice``."""
        first = not self._limited
        if first:
            self._limit()
            self._limited = True
        values = np.clip(np.rint(commands), 0, 255).astype(int).tolist()
        self._collect(self._opened(self._bus), time.perf_counter())
        for kind, row in _filled(self._model.positions, values).items():
            self._answers.pop(kind, None)
            self._send(kind, row)
        if first and self._model.clear:
            self._send(self._model.clear[0], list(self._model.clear[1:]))

    def close(self) -> None:
        """Give the bus back; the hand keeps its last target. See ``HandDevice``."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _send(self, kind: int, values: list[int]) -> None:
        """Send a frame, not too soon after the last one, or the hand loses it."""
        wait = self._sent + self._gap - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        self._opened(self._bus).send(self._identifier, bytes([kind, *values]))
        self._sent = time.perf_counter()


def _filled(frames: Frames, values: Sequence[int]) -> dict[int, list[int]]:
    """The values of each frame; 0 in places without a motor."""
    return {k: [0 if m is None else values[m] for m in row] for k, row in frames.items()}


def _values(frames: Frames, answers: Mapping[int, bytes]) -> Float[np.ndarray, " a"] | None:
    """The motors' values in the answers; None if a frame is missing or too short."""
    found: dict[int, int] = {}
    for kind, row in frames.items():
        if len(answer := answers.get(kind, b"")) < len(row):
            return None
        found |= {m: value for m, value in zip(row, answer, strict=False) if m is not None}
    return np.array([found[motor] for motor in sorted(found)], float) if found else None
