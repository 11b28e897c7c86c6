"""A stand-in for RobotEra's `xhand_controller`, with simulated XHand 1 behind it.

Sources:

- `xhand_control_sdk_py` 0.10.3 of the maker (RobotEra), in github.com/yoimika/xhand_control_python,
  commit b61a82d4 (2025-11-11): `src/xhand_control.cpp` (the binding), `include/{data_type,
  xhand_control,error_manager}.hpp` (fields, widths, calls, error codes), and
  `xhand_control_example.py`.
- Version 1.1.7 is in github.com/jefferzn2001/XhandControl, commit f244afdd (2025-10-07), as wheels
  for CPython 3.10 and 3.12; its README says that identifiers are lost at power off.

Facts: `from xhand_controller import xhand_control`. 12 joints; a command has id, kp, ki, kd (16-bit
integers, a float is a TypeError), position [rad], tor_max, mode. `finger_command` is a new list at
each access, of the same elements: `command.finger_command[3].kp = 100` works, and
`command.finger_command[3] = other` changes nothing. Calls return an ErrorStruct, or a pair of it
and a value; error_code 0 is good. 3 Mbaud on RS-485. The low byte of `temperature` is °C.

Not found: the joints' names (here by the order of users: thumb bend, thumb rotation 1 and 2, index
side, 1, 2, then two of each finger), the unit of `torque` and tor_max (users say mA), what mode 0
does (a user found that it does not free the hand: here it holds), what `force_update` does beyond
taking time, the strings of `get_hand_type`, and which calls changed up to 1.1.7.
"""

from __future__ import annotations

import types

import numpy as np

from .common import Faults, Motors
from .sdk import module

INVALID_DEVICE_ID, DEVICE_NOT_INIT, OPEN_DEVICE_FAILED = 1501037, 1501038, 1501039
SERIAL_COMMUNICATION_ERROR = 1501050


class _Number:
    """A field of a C structure: an integer of a width, or a float."""

    def __init__(self, low: float | None = None, high: float | None = None) -> None:
        self.low, self.high = low, high

    def __set_name__(self, _: type, name: str) -> None:
        self.name = "_" + name

    def __get__(self, owner: object, _: type | None = None) -> float:
        return getattr(owner, self.name, 0 if self.high is not None else 0.0)

    def __set__(self, owner: object, value: float) -> None:
        if self.high is None:
            value = float(np.float32(value))
        elif not isinstance(value, int | np.integer) or not self.low <= value <= self.high:
            raise TypeError(f"incompatible function arguments: {self.name[1:]} = {value!r}")
        setattr(owner, self.name, value)


def _unsigned(bits: int) -> _Number:
    return _Number(0, 2**bits - 1)


class FingerCommand_t:
    id, tor_max, mode = _unsigned(16), _unsigned(16), _unsigned(16)
    kp, ki, kd = _Number(-32768, 32767), _Number(-32768, 32767), _Number(-32768, 32767)
    position = _Number()


class HandCommand_t:
    def __init__(self) -> None:
        self._commands = [FingerCommand_t() for _ in range(12)]

    @property
    def finger_command(self) -> list[FingerCommand_t]:
        return list(self._commands)


class FingerState_t:
    def __init__(self) -> None:
        self.id = self.torque = self.temperature = 0
        self.commboard_err = self.jonitboard_err = self.tipboard_err = 0
        self.position = 0.0


class PXSR_ForceData:
    def __init__(self, fx: int = 0, fy: int = 0, fz: int = 0) -> None:
        self.fx, self.fy, self.fz = fx, fy, fz


class SenserData_t:
    def __init__(self) -> None:
        self.calc_force = PXSR_ForceData()


class HandState_t:
    def __init__(self) -> None:
        self.finger_state = [FingerState_t() for _ in range(12)]
        self.sensor_data = [SenserData_t() for _ in range(5)]


class ErrorStruct:
    def __init__(self, error_code: int = 0, error_message: str = "") -> None:
        self.error_code, self.error_message = error_code, error_message


class XHand:
    """A simulated XHand 1 on a port, in rad; ``occupied`` is True while another program has it."""

    def __init__(self, side: str, port: str, identifier: int) -> None:
        self.side, self.port, self.identifier = side, port, identifier
        self.occupied = False
        self.faults = Faults("error")
        self.motors = Motors(np.zeros(12), 4.0)
        self.joint_errors = [0] * 12
        self.forces = np.zeros((5, 3), dtype=int)  # of the fingertips: -128 to 127, z 0 to 255
        self.commands: list[list[tuple[float, ...]]] = []
        self.motors.set_power(False)

    def reboot(self) -> None:
        """Switch the hand off and on: no target, and its identifier is lost."""
        self.identifier = 0
        self.joint_errors = [0] * 12
        self.motors.place(self.motors.positions)
        self.motors.set_power(False)

    def obey(self, command: HandCommand_t) -> None:
        """Take a command."""
        fingers = command.finger_command
        self.commands.append(
            [(f.id, f.kp, f.ki, f.kd, f.position, f.tor_max, f.mode) for f in fingers]
        )
        for finger in fingers:
            if finger.id < 12 and finger.mode == 3 and not self.joint_errors[finger.id]:
                self.motors.set_power(finger.kp > 0 and finger.tor_max > 0, [finger.id])
                self.motors.move([finger.position], [finger.id])

    def state(self) -> HandState_t:
        """The state of this moment."""
        state = HandState_t()
        positions, currents = self.motors.positions, self.motors.currents
        for i, finger in enumerate(state.finger_state):
            finger.id = i
            finger.position = float(np.float32(positions[i]))
            finger.torque = round(currents[i])
            finger.temperature = round(self.motors.temperatures[i])
            finger.jonitboard_err = self.joint_errors[i]
        for sensor, force in zip(state.sensor_data, self.forces, strict=True):
            sensor.calc_force = PXSR_ForceData(*map(int, force))
        return state


def xhand_modules(*hands: XHand) -> dict[str, types.ModuleType]:
    """The modules of the stand-in, with the given hands on their ports."""

    class XHandControl:
        def __init__(self) -> None:
            self._open: list[XHand] | None = None

        def open_serial(self, port: str, baudrate: int) -> ErrorStruct:
            found = [hand for hand in hands if hand.port == port and not hand.occupied]
            if not found or baudrate != 3_000_000:
                return ErrorStruct(OPEN_DEVICE_FAILED, f"open {port} failed")
            self._open = found
            return ErrorStruct()

        def close_device(self) -> None:
            self._open = None

        def list_hands_id(self) -> list[int]:
            return [hand.identifier for hand in self._open or [] if not hand.faults.silent]

        def _hand(self, device_id: int) -> tuple[ErrorStruct, XHand | None]:
            if self._open is None:
                return ErrorStruct(DEVICE_NOT_INIT, "device is not opened"), None
            for hand in self._open:
                if hand.identifier == device_id:
                    if hand.faults.silent or hand.faults.next_wrong():
                        return ErrorStruct(SERIAL_COMMUNICATION_ERROR, "communication error"), None
                    return ErrorStruct(), hand
            return ErrorStruct(INVALID_DEVICE_ID, f"no hand {device_id}"), None

        def send_command(self, device_id: int, command: HandCommand_t) -> ErrorStruct:
            if not isinstance(command, HandCommand_t):
                raise TypeError("incompatible function arguments: HandCommand_t")
            error, hand = self._hand(device_id)
            if hand is not None:
                hand.obey(command)
            return error

        def read_state(
            self, device_id: int, force_update: bool = False
        ) -> tuple[ErrorStruct, HandState_t]:
            error, hand = self._hand(device_id)
            return error, HandState_t() if hand is None else hand.state()

        def get_hand_type(self, device_id: int) -> tuple[ErrorStruct, str]:
            error, hand = self._hand(device_id)
            return error, "" if hand is None else hand.side.capitalize()

    control = module(
        "xhand_controller.xhand_control", XHandControl=XHandControl, HandCommand_t=HandCommand_t
    )
    return {
        "xhand_controller": module("xhand_controller", xhand_control=control),
        "xhand_controller.xhand_control": control,
    }
