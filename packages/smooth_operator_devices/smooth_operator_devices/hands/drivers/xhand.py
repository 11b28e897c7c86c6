"""Driver of RobotEra's XHand 1 through the maker's package ``xhand_controller``.

Facts, by the maker: ``xhand_control_sdk_py`` 0.10.3, in yoimika/xhand_control_python, commit
b61a82d4 (``src/xhand_control.cpp``, ``include``, ``xhand_control_example.py``). RS-485 over USB at
3 Mbaud. A command has twelve joints, each with id, integer gains, position [rad], largest torque
and mode; 3 is position. Calls return an error, or an error and a value; code 0 is good. The low
byte of a temperature is in degrees Celsius. A user found that mode 0 does not free the hand, and
that the hand keeps its last target; users say that torques are in mA.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 12
BAUD: Final = 3_000_000
_PACKAGE: Final = "xhand_controller"
_POSITION_MODE: Final = 3
_LOST: Final = (1501037, 1501038, 1501039)
"""Error codes: no such hand, device not initialised, device can't be opened."""
_BOARDS: Final = {
    "commboard_err": "communication board",
    "jonitboard_err": "joint board",  # as the maker spells it
    "tipboard_err": "fingertip board",
}


@dataclass(frozen=True)
class XHandSink(HardwareSink):
    """Moves an XHand 1; see ``HardwareSink``.

    Attributes:
        port: its serial port.
    """

    driver: ClassVar[str] = "xhand"

    port: str = "/dev/ttyUSB0"

    def device(self, actuators: ActuatorMap) -> XHandDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        if sys.modules.get(_PACKAGE) is None and importlib.util.find_spec(_PACKAGE) is None:
            raise ConfigError(
                f"xhand needs the maker's package {_PACKAGE}, which is not installed: install the "
                "wheel that RobotEra supplies with the hand. The package xhand on PyPI is not "
                "from the maker"
            )
        return XHandDevice(actuators, self.port)


class XHandDevice(HandDevice):
    """An XHand 1 on its port; see ``HandDevice``.

    Nothing is known to free the hand, so ``relax`` does nothing. Each command has its gains and
    limit, so that a restart deletes only the hand's identifier, which is then found again.
    ``Reading.touch`` are the summed forces of the five fingertips, x, y, z each.

    Args:
        table: table of the hand. ``limit`` is the largest torque of each joint, in mA by what users
            say (300). Its settings may have ``device_id`` (that of the only hand on the port),
            ``kp`` (100), ``ki`` and ``kd`` (0).
    """

    driver, name, motors = "xhand", "an XHand", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(("device_id", "kp", "ki", "kd"))
        self._port = port
        self._gains = {
            "kp": self._setting("kp", 100, 1, 500),
            "ki": self._setting("ki", 0, 0, 500),
            "kd": self._setting("kd", 0, 0, 500),
        }
        self._wanted = self._setting("device_id", -1, -1, 255)
        self._limits = np.clip(np.nan_to_num(table.limits, nan=300.0), 1, 1000).astype(int).tolist()
        self._control: Any = None
        self._device: Any = None
        self._number = 0

    def open(self) -> None:
        """Open the port, find the hand, check its side; see ``HandDevice``."""
        # By name: the package is on no index, so that no extra can declare it.
        self._control = importlib.import_module(f"{_PACKAGE}.xhand_control")
        self._device = self._control.XHandControl()
        with self._opening(
            f"check the hand's power, the port {self._port}, and that no other program uses it"
        ):
            self._checked(self._device.open_serial(self._port, BAUD))
            found = [int(number) for number in self._device.list_hands_id()]
            wanted = [n for n in found if self._wanted in (-1, n)]
            if len(wanted) != 1:
                raise SinkError(
                    f"xhand: the hands {found} answer at {self._port}, expected "
                    + ("one" if self._wanted < 0 else f"number {self._wanted}")
                    + "; name one by settings.device_id in the table"
                )
            self._number = wanted[0]
            kind = str(self._asked("get_hand_type")).lower()
            self._check_side(next((s for s in ("left", "right") if kind.startswith(s[0])), None))
            self.read()

    def read(self) -> Reading:
        """Positions, torques, temperatures, errors and forces; see ``HandDevice``."""
        state = self._asked("read_state", True)
        fingers = {int(finger.id): finger for finger in state.finger_state}
        if sorted(fingers) != list(range(MOTORS)):
            raise WrongAnswerError(f"xhand: the hand reports the joints {sorted(fingers)}")
        joints = [fingers[k] for k in range(MOTORS)]
        positions = np.array([joint.position for joint in joints], float)
        if not np.isfinite(positions).all():
            raise WrongAnswerError("xhand: the hand reports positions that are not finite")
        forces = [sensor.calc_force for sensor in state.sensor_data]
        return Reading(
            positions=positions,
            currents=np.array([joint.torque for joint in joints], float),
            temperatures=np.array([int(joint.temperature) & 0xFF for joint in joints], float),
            errors=tuple(
                f"{name}: error {getattr(joint, word):#x} of the {board}"
                for name, joint in zip(self._table.names, joints, strict=True)
                for word, board in _BOARDS.items()
                if getattr(joint, word)
            ),
            touch=np.array([[f.fx, f.fy, f.fz] for f in forces], float).ravel(),
        )

    def write(self, commands: Float[np.ndarray, " 12"]) -> None:
        """Send the positions [rad] with gains and limits; see ``HandDevice``."""
        device = self._opened(self._device)
        command = self._control.HandCommand_t()
        for k, (finger, limit) in enumerate(zip(command.finger_command, self._limits, strict=True)):
            finger.id, finger.mode, finger.tor_max = k, _POSITION_MODE, limit
            finger.position = float(commands[k])
            for gain, value in self._gains.items():
                setattr(finger, gain, value)
        self._checked(device.send_command(self._number, command))

    def close(self) -> None:
        """Give the port back; the hand keeps its last target. See ``HandDevice``."""
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(Exception):  # of a hand that is gone
                device.close_device()

    def _asked(self, call: str, *values: Any) -> Any:
        error, value = getattr(self._opened(self._device), call)(self._number, *values)
        self._checked(error)
        return value

    def _checked(self, error: Any) -> None:
        code = int(error.error_code)
        if code:
            kind = DeviceLostError if code in _LOST else WrongAnswerError
            raise kind(f"xhand: {error.error_message} (error {code}) at {self._port}")
