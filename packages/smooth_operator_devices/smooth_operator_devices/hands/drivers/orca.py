"""Driver of the ORCA Hand, through its makers' library orca-core."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
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
from smooth_operator_devices.hands.hardware_sink import HardwareSink

_SETTINGS: Final = ("model_version", "model_name", "config_path")
_CURRENTS_EVERY: Final = 5
"""Number of cycles between two readings of the currents, which take another exchange."""
_TEMPERATURES_EVERY: Final = 100


@dataclass(frozen=True)
class OrcaSink(HardwareSink):
    """The ORCA Hand v2. orca-core finds port and motors, and must have calibrated the hand.

    ``limit`` is the largest current of every motor [mA]; None for that of orca-core.

    Attributes:
        config: path of the hand's ``config.yaml``; empty for the model that the table names.
        mock: True to move orca-core's simulated hand.
    """

    driver: ClassVar[str] = "orca"

    config: str = ""
    mock: bool = False

    @property
    def bus(self) -> str:
        """The serial port; without one any port, since orca-core tries them all."""
        return "orca:mock" if self.mock else self.port or "serial"

    def device(self, actuators: ActuatorMap) -> OrcaDevice:
        """The hand, not yet connected."""
        return OrcaDevice(actuators, self.port, self.config, self.mock)


class OrcaDevice(HandDevice):
    """A hand of orca-core, as ``HandDevice``. Commands are degrees, by joint name.

    Args:
        actuators: the table; its actuators are named as orca-core names joints.
    """

    driver, name, motors = "orca", "the ORCA hand", 0

    def __init__(self, actuators: ActuatorMap, port: str, config: str, mock: bool) -> None:
        super().__init__(actuators)
        require("the ORCA hand", "orca", "orca_core")
        self._port = port
        self._check_settings(_SETTINGS)
        options = dict(actuators.settings)
        self._options = {"config_path": config} if config else options
        self._mock = mock
        self._hand: Any = None
        self._powered = False
        self._cycle = 0
        self._motors: list[int] = []  # index of each actuator's motor in the hand's answers
        self._currents: Float[np.ndarray, " a"] | None = None
        self._temperatures: Float[np.ndarray, " a"] | None = None

    def open(self) -> None:
        """Connect; refuse a hand that is not calibrated, since calibrating moves it."""
        # orca-core prints; standard output belongs to the command's results.
        with contextlib.redirect_stdout(sys.stderr):
            self._open()

    def _open(self) -> None:
        import orca_core

        with self._bus("connecting"):
            hand = orca_core.load_hand(mock=self._mock, **self._options)
        names = hand.config.joint_ids
        for name in self._table.names:
            if name not in names:
                raise ConfigError(
                    f"{self._table.file}: this ORCA hand has no joint {name!r}; it has "
                    f"{', '.join(names)}"
                )
        if self._port:
            hand.config = replace(hand.config, port=self._port)
        with self._bus("connecting"):
            connected, message = hand.connect(interactive=False)
        if not connected:
            raise SinkError(f"orca: {message}; check power and cable")
        self._hand = hand
        if not hand.calibrated:
            self.close()
            raise SinkError(
                "orca: the hand is not calibrated. Calibration moves the hand: run "
                "orca-core's calibration first, with the hand free on all sides"
            )
        with self._bus("starting"):
            hand.init_joints(move_to_neutral=False)  # sets modes and currents, and powers
            hand.disable_torque()
        ids = list(hand.config.motor_ids)
        wired = hand.config.joint_to_motor_map
        self._motors = [ids.index(abs(wired[name])) for name in self._table.names]
        self._powered = False
        self._cycle = 0

    def read(self) -> Reading:
        """Joint positions; currents and temperatures in turns."""
        hand = self._opened(self._hand)
        with self._bus("reading"):
            by_name = hand.get_joint_position().as_dict()
            fresh = hand.last_read_ok
            if self._cycle % _CURRENTS_EVERY == 0:
                self._currents = np.array(hand.get_motor_current(), float)[self._motors]
            if self._cycle % _TEMPERATURES_EVERY == 0:
                self._temperatures = np.array(hand.get_motor_temp(), float)[self._motors]
        self._cycle += 1
        if not fresh:
            raise WrongAnswerError("orca: the motors do not answer")
        positions = [by_name.get(name) for name in self._table.names]
        return Reading(
            np.array([np.nan if value is None else value for value in positions], float),
            None,
            self._currents,
            self._temperatures,
            tuple(f"{name}: its motor does not answer" for name in hand.absent_joints),
        )

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Joint positions; the first ones switch the torque on."""
        hand = self._opened(self._hand)
        pose = dict(zip(self._table.names, commands.tolist(), strict=True))
        with self._bus("writing"):
            if not self._powered:  # a motor that has restarted has no limit
                limits = self._table.limits[np.isfinite(self._table.limits)]
                most = float(limits.min()) if len(limits) else hand.config.max_current
                hand.set_max_current(most)
                if silent := hand.enable_torque():
                    raise WrongAnswerError(f"orca: the motors {silent} can't be switched on")
            hand.set_joint_positions(pose)
        self._powered = True

    def relax(self) -> None:
        """Switch the torque off."""
        if self._powered:
            with self._bus("relaxing"):
                self._opened(self._hand).disable_torque()
        self._powered = False

    def close(self) -> None:
        """Disconnect; orca-core switches the torque off."""
        hand, self._hand = self._hand, None
        if hand is not None:
            with contextlib.suppress(Exception):  # the port may be gone
                hand.disconnect()

    @contextlib.contextmanager
    def _bus(self, doing: str) -> Iterator[None]:
        try:
            yield
        except SinkError:
            raise
        except Exception as error:  # orca-core raises errors of several libraries
            cause = f"{type(error).__name__}: {error}"
            raise DeviceLostError(
                f"orca: {doing} failed ({cause}); check power and cable"
            ) from error
