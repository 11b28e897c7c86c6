"""Driver of the Allegro Hand V4 and V5 on a CAN bus, with the position control on this computer.

Facts of the protocol, from the maker's manuals and its ROS drivers: 1 Mbit/s, the 11-bit identifier
is the message number times four, values are little-endian. To the hand: 0x40 motors on, 0x41 motors
off, 0x60 to 0x63 torques of a finger (four int16), 0x81 periods of its reports [ms] (three int16),
remote frames 0x80 (information) and 0x88 (serial number). From the hand: 0x20 to 0x23 angles of a
finger (four int16, 333.3/65536 degrees in V4, 0.088 in V5), 0x38 to 0x3B temperatures, 0xEE an
error (motor, flags; V5). V4 takes duty of the PWM, up to 1200; V5 motor current [mA], up to 240.
Neither takes positions: the maker's drivers close the loop on the host, at 333 to 500 Hz.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    WrongAnswerError,
)
from smooth_operator_devices.hands.drivers.can_bus import CanBus, CanSink

MOTORS: Final = 16
_ON, _OFF, _TORQUE, _PERIOD = 0x40, 0x41, 0x60, 0x81
_ANGLES, _HEAT, _INFORMATION, _SERIAL, _ERROR = 0x20, 0x38, 0x80, 0x88, 0xEE

_OPENING_S: Final = 1.0
"""Time that the first angles may take [s]."""

_ASK_S: Final = 1.0
"""Interval of the requests for temperatures and status [s]."""

_STANDS: Final = 0.3
"""Speed below which a joint is at rest [rad/s]."""

_STALE_S: Final = 0.1
"""Time without angles after which the motors are switched off: the controller is blind [s]."""

_LATE_S: Final = 0.03
"""Largest age of valid angles: the hand may have moved since [s]."""

_STATUS: Final = {1: "too hot", 2: "a finger does not answer its controller board"}
"""Bits of the status of V4, in its information."""

_FLAGS: Final = {0: "input voltage", 2: "too hot", 4: "electrical shock", 5: "overload"}
"""Bits of an error of V5."""


@dataclass(frozen=True)
class Version:
    """Figures of one version of the hand.

    Attributes:
        angle: angle of one count [rad].
        most: greatest value of a torque frame.
        stiffness: (4,) of a finger and (4,) of the thumb, units of torque per rad.
        damping: the same per rad/s.
    """

    angle: float
    most: int
    stiffness: tuple[tuple[float, ...], tuple[float, ...]]
    damping: tuple[tuple[float, ...], tuple[float, ...]]


VERSIONS: Final = {
    "v4": Version(
        math.radians(333.3 / 65536),
        1200,
        ((500.0, 800.0, 900.0, 500.0), (1000.0, 700.0, 600.0, 600.0)),
        ((15.0, 20.0, 15.0, 15.0), (30.0, 20.0, 20.0, 15.0)),
    ),
    "v5": Version(
        math.radians(0.088),
        240,
        ((1400.0, 700.0, 1400.0, 1400.0), (1150.0,) * 4),
        ((45.0, 70.0, 45.0, 45.0), (45.0,) * 4),
    ),
}
"""Name of a version -> its figures. Gains of V4: the maker's PD node, with the damping of the older
ROS driver. Gains of V5: the maker's library, as ``allegro_hand_v5_plus_python`` measured them."""


@dataclass(frozen=True)
class AllegroSink(CanSink):
    """Moves an Allegro Hand V4 or V5; see ``CanSink``."""

    driver: ClassVar[str] = "allegro"

    def device(self, actuators: ActuatorMap) -> AllegroDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(AllegroDevice.name, "allegro", "can")
        return AllegroDevice(actuators, self.port)


class AllegroDevice(HandDevice):
    """An Allegro Hand on its bus; see ``HandDevice``.

    A separate thread answers each set of angles with torques, as often as the hand reports. The
    hand measures no currents. ``Reading.currents`` is the torque that the thread sends to motors at
    rest, and 0 for moving motors: a motor that moves at full torque touches nothing.

    Limits and gains are in every torque that is sent. The hand stores only the period of its
    reports and the state of its motors, and can't read them back. A hand that restarted reports
    nothing until it gets a period, and without angles for 0.1 s it is lost.

    Args:
        table: table of the hand. Its settings have ``version`` (``v4`` or ``v5``) and may have
            ``gain``, a factor on the stiffness (1.0), and ``period_ms`` of the hand's reports (3).
            ``limit`` is the largest duty or current.
    """

    driver, name, motors = "allegro", "an Allegro Hand", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        version = table.settings.get("version")
        if version not in VERSIONS:
            raise ConfigError(f"{table.file}: version must be v4 or v5, not {version!r}")
        gain = self._setting("gain", 1.0, 0.05, 3)
        self._port, self._period = port, self._setting("period_ms", 3, 2, 20)
        figures = VERSIONS[version]
        limits = np.nan_to_num(table.limits, nan=float(figures.most))
        if (limits > figures.most).any() or (limits <= 0).any():
            raise ConfigError(f"{table.file}: limit must be over 0 to {figures.most}")
        # Damping by the root of the stiffness keeps the damping ratio.
        stiffness = gain * _for_all(figures.stiffness)
        damping = math.sqrt(gain) * _for_all(figures.damping)
        self._law = stiffness, damping, limits
        self._version = version
        self._control: _Control | None = None

    def open(self) -> None:
        """Open the bus, and wait for angles of all fingers; the motors stay off. See
        ``HandDevice``."""
        bus = CanBus(self._port, "allegro")
        self._control = _Control(bus, VERSIONS[self._version].angle, self._law, self._period)
        with self._opening(
            "check its power switch, the wiring of CAN high and low, and the version in "
            f"{self._table.file} ({self._version})"
        ):
            self._control.begin()
            self._check_side(self._side(self._control), f"the hand {self._control.serial}")

    def _side(self, control: _Control) -> str | None:
        """Side of the hand, from the serial number (V5) or the information (V4)."""
        if self._version == "v5":
            return {"R": "right", "L": "left"}.get(control.serial[3:4])
        return {0: "right", 1: "left"}.get(int.from_bytes(control.information[4:5] or b"\xff"))

    def read(self) -> Reading:
        """The newest angles [rad] and torques; see ``HandDevice``."""
        control = self._running()
        positions, velocities, torques = control.look()
        names = self._table.names
        return Reading(
            positions=positions,
            velocities=velocities,
            currents=np.where(np.abs(velocities) < _STANDS, torques, 0.0),
            temperatures=control.temperatures.copy() if control.warm else None,
            errors=self._status(control)
            + tuple(
                f"{names[motor] if motor < MOTORS else f'motor {motor}'}: {_named(flags)}"
                for motor, flags in sorted(control.errors.items())
            ),
        )

    def _status(self, control: _Control) -> tuple[str, ...]:
        status = control.information[6:7] if self._version == "v4" else b""
        return tuple(
            f"hand: {text}" for b, text in _STATUS.items() if status and status[0] >> b & 1
        )

    def write(self, commands: Float[np.ndarray, " 16"]) -> None:
        """Aim the controller [rad]; the first call switches the motors on. See ``HandDevice``."""
        self._running().aim(np.array(commands, float))

    def relax(self) -> None:
        """Switch the motors off; see ``HandDevice``."""
        self._running().relax()

    def close(self) -> None:
        """Switch the motors off, which nothing controls any more, and give the bus back."""
        control, self._control = self._control, None
        if control is not None:
            control.end()

    def _running(self) -> _Control:
        control = self._opened(self._control)
        control.raise_error()
        return control


class _Control:
    """The thread of the position controller: angles in, torques out."""

    def __init__(self, bus: CanBus, angle: float, law: tuple[Any, Any, Any], period: int) -> None:
        self._bus, self._angle, self._period = bus, angle, period
        self._stiffness, self._damping, self._limits = law
        self.temperatures = np.zeros(MOTORS)
        self.warm = False
        self.errors: dict[int, int] = {}
        self.serial, self.information = "", b""
        self._lock = threading.Lock()
        self._position, self._velocity = np.zeros(MOTORS), np.zeros(MOTORS)
        self._torque, self._before = np.zeros(MOTORS), np.zeros(MOTORS)
        self._target: np.ndarray | None = None
        self._fingers: set[int] = set()
        self._stamp: float | None = None
        self._last_request = 0.0
        self._error: SinkError | None = None
        self._ready, self._ending = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name="allegro control", daemon=True)

    def begin(self) -> None:
        """Ask for reports, and wait for those of all fingers."""
        for number in (_INFORMATION, _SERIAL):
            self._bus.send(number << 2, remote=True)
        self._bus.send(_OFF << 2)
        self._bus.send(_PERIOD << 2, struct.pack("<3h", self._period, 0, 0))
        self._thread.start()
        if not self._ready.wait(_OPENING_S):
            self.raise_error()
            raise DeviceLostError("allegro: the hand reports no angles")

    def raise_error(self) -> None:
        """Raise the error that ended the thread, if any."""
        if self._error is not None:
            raise self._error

    def look(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(16,) angles [rad], velocities [rad/s] and torques in the hand's unit."""
        with self._lock:
            age = time.perf_counter() - (self._stamp or 0.0)
            if age > _LATE_S:
                raise WrongAnswerError(f"allegro: the newest angles are {1e3 * age:.0f} ms old")
            return self._position.copy(), self._velocity.copy(), self._torque.copy()

    def aim(self, target: np.ndarray) -> None:
        with self._lock:
            first, self._target = self._target is None, target
        if first:
            self._bus.send(_ON << 2)

    def relax(self) -> None:
        with self._lock:
            was, self._target = self._target, None
            self._torque = np.zeros(MOTORS)
        if was is not None:
            self._stop()

    def end(self) -> None:
        """Switch motors and reports off, and end thread and bus."""
        self._ending = True
        if self._thread.is_alive():
            self._thread.join(1.0)
        try:
            self._stop()
            self._bus.send(_PERIOD << 2, bytes(6))
        except SinkError:
            pass  # the hand is gone and receives nothing
        self._bus.close()

    def _stop(self) -> None:
        for finger in range(4):
            self._bus.send(_TORQUE + finger << 2, bytes(8))
        self._bus.send(_OFF << 2)

    def _run(self) -> None:
        try:
            while not self._ending:
                frame = self._bus.receive(0.02)
                if frame is not None:
                    self._take(frame[0] >> 2, frame[1])
                    continue
                stamp = self._stamp  # valid even if this thread slept: no frame is waiting
                if stamp is not None and time.perf_counter() - stamp > _STALE_S:
                    self._stop()
                    raise DeviceLostError(
                        f"allegro: no angles for {_STALE_S:g} s; the motors were switched off"
                    )
        except SinkError as error:
            self._error = error
        except Exception as error:
            self._error = DeviceLostError(f"allegro: {type(error).__name__}: {error}")

    def _take(self, number: int, data: bytes) -> None:
        finger = number - _ANGLES
        if 0 <= finger < 4 and len(data) == 8:
            mine = slice(4 * finger, 4 * finger + 4)
            with self._lock:
                self._position[mine] = np.array(struct.unpack("<4h", data), float) * self._angle
            self._fingers.add(finger)
            if len(self._fingers) == 4:
                self._fingers.clear()
                self._answer()
        elif 0 <= number - _HEAT < 4 and len(data) >= 4:
            self.temperatures[4 * (number - _HEAT) :][:4] = list(data[:4])
            self.warm = True
        elif number == _ERROR and len(data) >= 2:
            self.errors[data[0]] = data[1]
        elif number == _INFORMATION and len(data) >= 7:
            self.information = data
        elif number == _SERIAL:
            self.serial = data.decode("ascii", "replace").strip("\0 ")

    def _answer(self) -> None:
        """Send torques, after all fingers have reported."""
        now = time.perf_counter()
        with self._lock:
            if self._stamp is not None:
                seconds = max(now - self._stamp, 1e-4)
                share = seconds / (seconds + 0.005)  # a filter of 5 ms
                rate = (self._position - self._before) / seconds
                self._velocity += share * (rate - self._velocity)
            self._before, self._stamp = self._position.copy(), now
            target = self._target
            if target is not None:
                wish = self._stiffness * (target - self._position) - self._damping * self._velocity
                self._torque = np.clip(wish, -self._limits, self._limits)
            torque = np.rint(self._torque).astype(int)
        self._ready.set()
        if target is not None:
            for finger in range(4):
                data = struct.pack("<4h", *torque[4 * finger : 4 * finger + 4])
                self._bus.send(_TORQUE + finger << 2, data)
        if now - self._last_request > _ASK_S:
            self._last_request = now
            for request in (_INFORMATION, *range(_HEAT, _HEAT + 4)):
                self._bus.send(request << 2, remote=True)


def _for_all(values: tuple[tuple[float, ...], tuple[float, ...]]) -> Float[np.ndarray, " 16"]:
    """Values of three equal fingers and the thumb."""
    return np.array([*values[0] * 3, *values[1]])


def _named(flags: int) -> str:
    return ", ".join(text for bit, text in _FLAGS.items() if flags >> bit & 1) or f"{flags:#04x}"
