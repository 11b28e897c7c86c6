"""Driver of Unitree's Dex3-1 over DDS.

Facts, by the maker: unitreerobotics/unitree_sdk2_python, commit 37116c52 (messages), and
unitreerobotics/xr_teleoperate, commit d1510db0 (``robot_hand_unitree.py``: topics, order, mode,
gains). Topics ``rt/dex3/SIDE/cmd`` and ``/state`` on domain 0. The order of the motors differs by
side: left thumb 0 to 2, middle 0 and 1, index 0 and 1; right thumb, index, middle. The byte
``mode`` has the motor's number in bits 0 to 3, and 1 in bits 4 to 6 while it is on. The hand
reports its state at about 500 Hz.
"""

from __future__ import annotations

import os
import time
from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, require
from smooth_operator.settings import check_range
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 7
_ON: Final = 1 << 4
_TIMED: Final = 1 << 7
"""Bit of the mode that the maker calls timeout, and sets in its example that stops the motors. Its
teleoperation does not set it, nor do commands of positions here."""
_TIMEOUT: Final = 0.1
"""Time that a new state may take [s]."""
_FINDING_S: Final = 5.0
"""Time that the hand may take to be found on the network [s]."""
_REMEMBERED: Final = 50
"""Number of our last commands that are kept, to recognise those of other programs."""


@dataclass(frozen=True)
class Dex3Sink(HardwareSink):
    """Moves a Unitree Dex3-1; see ``HardwareSink``.

    Attributes:
        domain: DDS domain of the robot.

    Raises:
        ConfigError: a setting is out of its range.
    """

    driver: ClassVar[str] = "dex3"

    domain: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("dex3: domain", self.domain, 0, 232)

    @property
    def bus(self) -> str:
        """The hand of that side in the domain; without ``side`` any hand."""
        return f"dex3:{self.domain}-{self.side}" if self.side else "dex3"

    def device(self, actuators: ActuatorMap) -> Dex3Device:
        """The hand, not yet open; see ``HardwareSink``."""
        require(Dex3Device.name, "dex3", "cyclonedds")
        return Dex3Device(actuators, self.domain)


class Dex3Device(HandDevice):
    """A Dex3-1 on the network; see ``HandDevice``.

    Each command has its gains, so that a restart has nothing to delete. ``relax`` sends gains of 0:
    the motors give way. ``Reading.currents`` are estimated torques [mN m], ``Reading.touch`` nine
    fields of twelve pressure sensors.

    Args:
        table: table of the hand. Its settings may have ``kp`` [N m/rad] and ``kd`` [N m s/rad].
            ``limit`` [mN m] is that of the contact guard.
    """

    driver, name, motors = "dex3", "a Dex3-1", MOTORS

    def __init__(self, table: ActuatorMap, domain: int) -> None:
        super().__init__(table)
        self._check_settings(("kp", "kd"))
        self._domain = domain
        self._kp = self._setting("kp", 1.5, 0.1, 5.0)
        self._kd = self._setting("kd", 0.2, 0.0, 1.0)
        self._transport: Any = None
        self._publish: Any = None
        self._sent: deque[tuple[float, ...]] = deque(maxlen=_REMEMBERED)
        self._others = 0

    def open(self) -> None:
        """Join the domain and wait for a state of the hand; see ``HandDevice``."""
        from smooth_operator_devices.hands.drivers.dex3_messages import HandCommand, HandState
        from smooth_operator_devices.ros2.transport import Endpoint, Network, Transport

        own = bool(os.environ.get("CYCLONEDDS_URI"))
        network: Network | None = None if own else "subnet"
        self._sent.clear()
        self._others = 0
        base = f"dex3/{self._table.side}"
        self._transport = Transport(Endpoint("dex3", SinkError, self._domain, network))
        with self._opening(
            f"check the hand's power, that it is the {self._table.side} one, and that this "
            f"computer is in the robot's network and domain {self._domain}"
        ):
            self._publish = self._transport.publisher(HandCommand, f"{base}/cmd")
            self._transport.subscribe(HandState, f"{base}/state", 1)
            self._transport.subscribe(HandCommand, f"{base}/cmd", _REMEMBERED)
            self._state(_FINDING_S)

    def read(self) -> Reading:
        """The next state of the hand; see ``HandDevice``."""
        self._received(0.0)  # what came before
        state = self._state(_TIMEOUT)
        motors = state.motor_state
        codes = [motor.motorstate for motor in motors]
        errors = [*self._reports(codes, lambda code: f"error 0x{code:X}" if code else "")]
        errors += [f"hand: error 0x{code:X}" for code in state.error if code]
        if self._others:
            errors.append("another program commands the hand: end it")
        return Reading(
            positions=np.array([motor.q for motor in motors], float),
            velocities=np.array([motor.dq for motor in motors], float),
            currents=1000.0 * np.array([motor.tau_est for motor in motors], float),
            temperatures=np.array([max(motor.temperature) for motor in motors], float),
            errors=tuple(errors),
            touch=np.array([row.pressure for row in state.press_sensor_state], float).ravel(),
        )

    def write(self, commands: Float[np.ndarray, " 7"]) -> None:
        """Send the positions [rad]; see ``HandDevice``."""
        self._command(np.asarray(commands, float), self._kp, self._kd)

    def relax(self) -> None:
        """Send gains and torques of 0; see ``HandDevice``."""
        self._command(np.zeros(MOTORS), 0.0, 0.0, _TIMED)

    def close(self) -> None:
        """Leave the domain; the hand keeps its last command. See ``HandDevice``."""
        transport, self._transport, self._publish = self._transport, None, None
        if transport is not None:
            transport.close()

    def _command(
        self, positions: Float[np.ndarray, " 7"], kp: float, kd: float, more: int = 0
    ) -> None:
        from cyclonedds.core import DDSException

        from smooth_operator_devices.hands.drivers.dex3_messages import HandCommand, MotorCommand

        publish = self._opened(self._publish)
        words = tuple(float(value) for value in positions.astype(np.float32))
        self._sent.append(words)
        motors = [MotorCommand(k | _ON | more, q, 0.0, 0.0, kp, kd) for k, q in enumerate(words)]
        try:
            publish(HandCommand(motors, [0] * 4))
        except DDSException as error:
            raise DeviceLostError(
                f"dex3: a command can't be sent over the network ({error})"
            ) from error

    def _state(self, seconds: float) -> Any:
        """The next state; seven motors without NaN."""
        deadline = time.perf_counter() + seconds
        while (left := deadline - time.perf_counter()) > 0:
            for state in self._received(left):
                angles = [motor.q for motor in state.motor_state]
                if len(angles) != MOTORS or not np.isfinite(angles).all():
                    raise WrongAnswerError(
                        f"dex3: a state with {len(angles)} motors received, instead of "
                        f"{MOTORS} finite positions"
                    )
                return state
        raise WrongAnswerError(f"dex3: no state arrived from the hand within {seconds:g} s")

    def _received(self, seconds: float) -> list[Any]:
        """States that came; counts commands of other programs."""
        from smooth_operator_devices.hands.drivers.dex3_messages import HandState

        transport = self._opened(self._transport)
        try:
            messages = [message for _, message in transport.receive(seconds)]
        except SinkError as error:
            raise DeviceLostError(f"dex3: {error}") from error
        for message in messages:
            if isinstance(message, Exception):
                raise WrongAnswerError(f"dex3: {message}") from message
            if not isinstance(message, HandState):
                self._others += tuple(motor.q for motor in message.motor_cmd) not in self._sent
        return [message for message in messages if isinstance(message, HandState)]
