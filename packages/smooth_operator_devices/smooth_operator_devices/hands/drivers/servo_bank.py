"""Base classes of hands that are built of bus servos on one serial port, of any maker."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import UNITS, ActuatorMap
from smooth_operator_devices.hands.bus_lock import only_port
from smooth_operator_devices.hands.device import DeviceLostError, HandDevice, WrongAnswerError
from smooth_operator_devices.hands.hardware_sink import HardwareSink

TRIES: Final = 4
"""Number of questions to a servo while the hand is opened. The first packet after power-on may be
lost, and on a busy machine an answer may be read too late."""

_ANSWER_MS: Final = 12.0
"""Time that an answer may take beyond its time on the wire [ms]."""

_SLOW_ANSWER_MS: Final = 36.0
"""The same, if the adapter holds bytes back for 16 ms."""


def open_port(port: str, baud: int) -> tuple[Any, float]:
    """An open serial port, exclusive, that sleeps while it waits.

    Returns:
        the port; and the time that an answer may take beyond its time on the wire [ms].

    Raises:
        SinkError: it can't be opened.
    """
    import serial

    try:
        line = serial.Serial(port, baud, timeout=0.001, write_timeout=0.2, exclusive=True)
    except (OSError, ValueError) as error:
        raise SinkError(_cant_open(port, error)) from error
    answer_ms = _ANSWER_MS
    try:
        line.set_low_latency_mode(True)
    except (AttributeError, NotImplementedError, OSError, ValueError):
        answer_ms = _SLOW_ANSWER_MS
    line.reset_input_buffer()
    return line, answer_ms


def _cant_open(port: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    text = str(error)
    if number == 2 or "No such file" in text:
        return f"there is no serial port {port}; check cable and power, or name another port"
    if number == 13 or "Permission" in text or "denied" in text:
        return (
            f"no permission to open {port}: add yourself to its group (on Linux: sudo usermod -aG "
            "dialout $USER, then log in again)"
        )
    if number in (11, 16) or "exclusively lock" in text:
        return f"{port} is in use by another program; end that program first"
    return f"can't open {port}: {text}"


class ServoBus(ABC):
    """The servos of one port.

    Args:
        port: the serial port; it is open while a subclass has it as ``_line``.
        baud: bits per second.
        ids: ids of the servos, in the order in which values are given and come back.
        names: names of the servos, for messages.
    """

    def __init__(self, port: str, baud: int, ids: Sequence[int], names: Sequence[str]) -> None:
        self.port, self.baud, self.ids, self.names = port, baud, tuple(ids), tuple(names)
        self._line: Any = None

    @abstractmethod
    def close(self) -> None:
        """Give the port back; a second call does nothing."""

    @abstractmethod
    def _model(self, number: int) -> int | None:
        """Model number of a servo; None if it does not answer."""

    def _open(self) -> Any:
        """The open port."""
        if self._line is None:
            raise DeviceLostError(f"{self.port} is not open")
        return self._line

    @contextlib.contextmanager
    def _lost(self) -> Iterator[None]:
        """Turns errors of the port into those of a driver."""
        try:
            yield
        except SinkError:
            raise
        except (IndexError, KeyError) as error:  # a maker's library reads beyond a short packet
            raise WrongAnswerError(f"{self.port}: received a truncated answer") from error
        except Exception as error:  # of pyserial or termios, in several classes
            raise DeviceLostError(
                f"{self.port} is gone ({error}); check cable and power"
            ) from error

    def _find(self, models: Container[int], expected: str) -> list[int]:
        """Check that every servo answers, and is of one of these models.

        Returns:
            the model number of each.

        Raises:
            SinkError: servos do not answer, or are of another model.
        """
        named = [f"{n} ({name})" for n, name in zip(self.ids, self.names, strict=True)]
        answers = [self._model(number) for number in self.ids]
        silent = [servo for servo, model in zip(named, answers, strict=True) if model is None]
        if silent:
            who = (
                f"no answer from the servos {', '.join(silent)}"
                if len(silent) < len(self.ids)
                else "no servo answers"
            )
            raise SinkError(
                f"{self.port}: {who} at {self.baud} baud; check power, cable, baud rate and ids"
            )
        found = [model for model in answers if model is not None]
        for servo, model in zip(named, found, strict=True):
            if model not in models:  # an address may have another meaning there
                raise SinkError(
                    f"{self.port}: the servo {servo} is of model number {model}, which has a "
                    f"different control table; expected {expected}"
                )
        return found


@dataclass(frozen=True)
class ServoSink(HardwareSink):
    """Moves a hand of bus servos; see ``HardwareSink``.

    Attributes:
        baud: bits per second; None for those of the table.
    """

    extra: ClassVar[str] = ""
    """Name of the extra."""

    baud: int | None = None

    @property
    def bus(self) -> str:
        """The serial port; by default the only one of this machine."""
        return self.port or only_port(self.driver, self.extra)


class ServoBank(HandDevice):
    """The servos of a hand, as ``HandDevice``. A subclass has the registers.

    The first goals are the servos' positions; they switch the torque on.

    Args:
        actuators: the table.
        per_radian: steps of the servos in a radian.
        settings: names of the table's settings.
    """

    motors = 0

    def __init__(self, actuators: ActuatorMap, per_radian: float, settings: Sequence[str]) -> None:
        super().__init__(actuators)
        self._check_settings(settings)
        if actuators.unit not in UNITS:
            raise ConfigError(
                f"{actuators.file}: the unit of servos must be {' or '.join(UNITS)}, not "
                f"{actuators.unit!r}"
            )
        self._ids = [a.id for a in actuators.actuators if a.id is not None]
        whole = len(self._ids) == len(actuators.actuators)
        if not whole or not all(0 <= number <= 252 for number in self._ids):
            raise ConfigError(f"{actuators.file}: every servo needs an id of 0 to 252")
        self._scale = per_radian / UNITS[actuators.unit]
        self._powered = False

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send goal positions; the first ones switch the torque on."""
        goals = [round(value * self._scale) for value in commands.tolist()]
        if self._powered:
            self._go(goals)
        else:
            self._switch_on(goals)
            self._powered = True

    @abstractmethod
    def _go(self, goals: list[int]) -> None:
        """Send goals [steps]."""

    @abstractmethod
    def _switch_on(self, goals: list[int]) -> None:
        """Write limits, torque and goals [steps], and check the torque. A servo that has restarted
        has no limit."""

    def _errors(
        self, values: Sequence[int], bits: Mapping[int, str], advice: str = ""
    ) -> tuple[str, ...]:
        """Words for the bits of each servo's error."""

        def words(value: int) -> str:
            named = ", ".join(text for bit, text in bits.items() if value & bit)
            return f"{named or f'error 0x{value:02x}'}{advice}" if value else ""

        return self._reports(values, words)
