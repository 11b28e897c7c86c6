"""Driver of the BrainCo Revo2 through the maker's package ``bc_stark_sdk``.

Facts of its interface: asynchronous calls on a device context and a device number, 0x7E for a left
hand and 0x7F for a right one; RS-485 at 460800 baud; positions, speeds and currents of six fingers,
thumb, thumb's rotation, index, middle, ring, little; 0 is open and 1000 closed, in the unit mode
``Normalized``; speeds 0 to 1000; currents -1000 to 1000, of the most that a motor takes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    Setting,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 6
_NUMBERS: Final = {"left": 0x7E, "right": 0x7F}
_BAUDS: Final = (19200, 57600, 115200, 460800, 1_000_000, 2_000_000, 5_000_000)
_TIMEOUT: Final = 0.2
"""Time that an answer may take [s]."""
_OPENING: Final = 5.0
_CLOSING: Final = 0.05

_T = TypeVar("_T")


@dataclass(frozen=True)
class Revo2Sink(HardwareSink):
    """Moves a BrainCo Revo2; see ``HardwareSink``.

    Attributes:
        port: its serial port.
        baud: baud rate of the port.

    Raises:
        ConfigError: a setting is out of its range.
    """

    driver: ClassVar[str] = "revo2"

    port: str = "/dev/ttyUSB0"
    baud: int = 460800

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.baud not in _BAUDS:
            raise ConfigError(f"revo2: baud must be one of {_BAUDS}, not {self.baud}")

    def device(self, actuators: ActuatorMap) -> Revo2Device:
        """The hand, not yet open; see ``HardwareSink``."""
        require("a BrainCo Revo2", "revo2", "bc_stark_sdk")
        return Revo2Device(actuators, self.port, self.baud)


class Revo2Device(HandDevice):
    """A Revo2 on its line; see ``HandDevice``.

    The package is asynchronous; each method here runs its calls to their end on its own loop.
    ``Reading.currents`` is in thousandths of a motor's largest. The hand has no command that
    switches its motors off, so ``relax`` does nothing.

    Args:
        table: table of the hand. Its settings may have ``speed`` (1 to 1000) and ``device_id``.
    """

    driver, name, motors = "revo2", "a Revo2", MOTORS

    def __init__(self, table: ActuatorMap, port: str, baud: int) -> None:
        super().__init__(table)
        self._port, self._baud = port, baud
        self._number = self._setting("device_id", _NUMBERS[table.side], 1, 255)
        self._speeds = [self._setting("speed", 1000, 1, 1000)] * MOTORS
        self._sdk: Any = None
        self._context: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """Open the port, check the hand's side, set the unit; see ``HandDevice``."""
        from bc_stark_sdk import main_mod

        self._sdk, self._limited = main_mod, False
        self._loop = asyncio.new_event_loop()
        with self._opening(
            f"check the hand's power, the wires A and B, the port {self._port} and that the hand "
            f"is number {self._number:#x} at {self._baud} baud"
        ):
            baud = getattr(main_mod.Baudrate, _baud_name(self._baud))
            self._context = self._run(
                lambda: main_mod.modbus_open(self._port, baud), _OPENING, "opening"
            )
            information = self._call("get_device_info")
            if not information.uses_revo2_motor_api():
                raise SinkError(f"revo2: the hand is a {information.hardware_type}, not a Revo2")
            left = information.hand_type == main_mod.HandType.Left
            self._check_side("left" if left else "right")
            self._set_unit()
            self.read()

    def read(self) -> Reading:
        """Positions, currents and states of the motors; see ``HandDevice``."""
        status = self._call("get_motor_status")
        positions, currents = (np.array(x, float) for x in (status.positions, status.currents))
        if positions.shape != (MOTORS,) or currents.shape != (MOTORS,):
            raise WrongAnswerError(
                f"revo2: {len(positions)} positions received instead of {MOTORS}"
            )
        if (positions < -100).any() or (positions > 1100).any():
            raise WrongAnswerError(
                f"revo2: the hand reports finger positions {positions.astype(int).tolist()}; "
                "expected 0 to 1000"
            )
        stalled = self._sdk.MotorState.Stall
        return Reading(
            positions=positions,
            velocities=None,
            currents=currents,
            errors=self._reports(status.states, lambda s: "stalled" if s == stalled else ""),
        )

    def _set_unit(self) -> None:
        self._call("set_finger_unit_mode", self._sdk.FingerUnitMode.Normalized)

    def settings(self) -> Sequence[Setting]:
        """The unit of positions, 1 for thousandths, the only setting; see ``HandDevice``."""
        unit = self._call("get_finger_unit_mode")
        thousandths = float(unit == self._sdk.FingerUnitMode.Normalized)
        return (Setting("unit mode", np.ones(1), np.array([thousandths])),)

    def write(self, commands: Float[np.ndarray, " 6"]) -> None:
        """Send the positions, 0 (open) to 1000 (closed), the first time after their unit; see
        ``HandDevice``."""
        if not self._limited:
            self._set_unit()
            self._limited = True
        target = np.clip(np.rint(commands), 0, 1000).astype(int).tolist()
        self._call("set_finger_positions_and_speeds", target, self._speeds)

    def close(self) -> None:
        """Give the port back; the hand keeps its last target. See ``HandDevice``."""
        context, self._context = self._context, None
        loop, self._loop = self._loop, None
        if loop is None:
            return
        try:
            if context is not None:
                loop.run_until_complete(asyncio.wait_for(_awaited(context.close), 1.0))
                # The package's threads must have ended before the program does, or it aborts.
                loop.run_until_complete(asyncio.sleep(_CLOSING))
        except Exception:
            pass  # the port is gone, or hangs; the package gives it back with the process
        finally:
            loop.close()

    def _call(self, name: str, *values: Any) -> Any:
        context = self._opened(self._context)
        return self._run(lambda: getattr(context, name)(self._number, *values), _TIMEOUT, name)

    def _run(self, call: Callable[[], Awaitable[_T]], seconds: float, what: str) -> _T:
        loop = self._opened(self._loop)
        try:
            return loop.run_until_complete(asyncio.wait_for(_awaited(call), seconds))
        except TimeoutError as error:
            raise WrongAnswerError(f"revo2: no answer to {what} in {seconds:g} s") from error
        except (RuntimeError, ValueError) as error:  # the package's errors of the line
            reason = next(iter(str(error).splitlines()), "")  # without its stack trace
            raise WrongAnswerError(f"revo2: {what} failed ({reason})") from error
        except OSError as error:
            raise DeviceLostError(f"revo2: the port {self._port} is gone ({error})") from error


async def _awaited(call: Callable[[], Awaitable[_T]]) -> _T:
    """The result of a call that needs a running loop to be made at all."""
    return await call()


def _baud_name(baud: int) -> str:
    """The package's name of a baud rate: ``Baud460800``, ``Baud1Mbps``."""
    return f"Baud{baud}" if baud < 1_000_000 else f"Baud{baud // 1_000_000}Mbps"
