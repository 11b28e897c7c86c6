"""Driver of the Wuji Hand through the maker's package ``wujihandpy``.

Facts of its interface: positions of (5, 4) joints [rad], thumb first, from the palm to the tip; a
realtime controller that takes targets at any rate and sends them through a low-pass filter at 1
kHz; efforts and their limits [A], temperatures and error codes as arrays of that shape. Zero and
sense of a joint are those of the maker's URDF.
"""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Iterator, Sequence
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
    Setting,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 20
_SHAPE: Final = (5, 4)
_SETTLING: Final = 5.0
"""Time constants of the filter between the first target and the motors' power."""
_SLOW: Final = 50
"""Number of cycles between two readings of the temperatures, or of the error codes."""


@dataclass(frozen=True)
class WujiSink(HardwareSink):
    """Moves a Wuji Hand; see ``HardwareSink``.

    Attributes:
        port: serial number of the hand; empty for the only one that is plugged in.
        cutoff: cutoff of the low-pass filter between two commands [Hz].

    Raises:
        ConfigError: a setting is out of its range.
    """

    driver: ClassVar[str] = "wuji"

    cutoff: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("wuji: cutoff", self.cutoff, 0.5, 100.0, "Hz")

    @property
    def bus(self) -> str:
        """The hand with that serial number; without one any hand."""
        return f"wuji:{self.port}" if self.port else "wuji"

    def device(self, actuators: ActuatorMap) -> WujiDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(WujiDevice.name, "wuji", "wujihandpy")
        return WujiDevice(actuators, self.port, self.cutoff)


class WujiDevice(HandDevice):
    """A Wuji Hand on USB; see ``HandDevice``.

    Args:
        table: table of the hand; ``limit`` is the current [mA] of each joint.
    """

    driver, name, motors = "wuji", "a Wuji Hand", MOTORS

    def __init__(self, table: ActuatorMap, port: str, cutoff: float) -> None:
        super().__init__(table)
        self._port, self._cutoff = port, cutoff
        self._hand: Any = None
        self._controller: Any = None
        self._cycle = 0
        self._limits = table.limits
        self._temperatures: Float[np.ndarray, " 20"] | None = None
        self._codes = np.zeros(MOTORS, int)

    def open(self) -> None:
        """Find the hand, check its side and its limits; the motors stay off. See ``HandDevice``."""
        import wujihandpy

        wujihandpy.logging.set_log_to_console(False)
        self._cycle, self._temperatures = 0, None
        try:
            self._hand = wujihandpy.Hand(serial_number=self._port or None)
            side = {0: "right", 1: "left"}.get(int(self._hand.read_handedness()))
            self._check_side(side, "the hand that is plugged in")
            self._limits, missing = self._table.limits, ~np.isfinite(self._table.limits)
            if missing.any():  # the hand's own
                own = 1000.0 * _flat(self._hand.read_joint_effort_limit())
                self._limits = np.where(missing, own, self._limits)
            self._limit()
            self.read()
        except SinkError:
            self.close()
            raise
        except Exception as error:
            self.close()
            which = f"with the serial number {self._port}" if self._port else "on USB"
            raise SinkError(
                f"wuji: no Wuji Hand {which} answers ({error}); check its power and cable"
                + (", and the vendor's udev rule" if sys.platform == "linux" else "")
            ) from error

    def _limit(self) -> None:
        """The joints' currents, which the hand forgets when it restarts."""
        self._hand.write_joint_effort_limit(self._limits.reshape(_SHAPE) / 1000.0)

    def settings(self) -> Sequence[Setting]:
        """The joints' limits of current; see ``HandDevice``."""
        with _speaking(self._hand):
            measured = 1000.0 * _flat(self._hand.read_joint_effort_limit())
        return (Setting("limit of current", self._limits, measured),)

    def read(self) -> Reading:
        """Positions [rad] and efforts; temperatures and errors in turns. See ``HandDevice``."""
        with _speaking(self._hand):
            source = self._controller
            if source is None:
                positions, efforts = self._hand.read_joint_actual_position(), None
            else:
                positions = source.get_joint_actual_position()
                efforts = source.get_joint_actual_effort()
            if self._cycle % _SLOW == 0:
                self._temperatures = _flat(self._hand.read_joint_temperature())
            elif self._cycle % _SLOW == _SLOW // 2 or self._cycle == 1:
                self._codes = _flat(self._hand.read_joint_error_code()).astype(int)
        self._cycle += 1
        flat = _flat(positions)
        if not np.isfinite(flat).all():
            raise WrongAnswerError("wuji: the hand reports positions that are not finite")
        return Reading(
            positions=flat,
            currents=None if efforts is None else 1000.0 * _flat(efforts),
            temperatures=self._temperatures,
            errors=self._reports(self._codes, lambda code: f"error {code:#x}" if code else ""),
        )

    def write(self, commands: Float[np.ndarray, " 20"]) -> None:
        """Send the positions [rad]; the first call switches the motors on. See ``HandDevice``."""
        target = np.asarray(commands, float).reshape(_SHAPE)
        with _speaking(self._hand):
            if self._controller is None:
                import wujihandpy

                self._limit()
                # The first target is the hand's position. It is set before the motors are switched
                # on, and the filter gets the time to reach it, so that nothing moves.
                self._hand.write_joint_target_position(target)
                self._controller = self._hand.realtime_controller(
                    enable_upstream=True, filter=wujihandpy.filter.LowPass(cutoff_freq=self._cutoff)
                )
                self._controller.set_joint_target_position(target)
                time.sleep(_SETTLING / (2 * math.pi * self._cutoff))
                self._hand.write_joint_enabled(True)
            self._controller.set_joint_target_position(target)

    def relax(self) -> None:
        """Switch the motors off; see ``HandDevice``."""
        self._stop()

    def close(self) -> None:
        """Switch the motors off and let the hand go; see ``HandDevice``."""
        try:
            self._stop()
        except SinkError:
            pass  # it is gone
        finally:
            self._controller = self._hand = None

    def _stop(self) -> None:
        controller, self._controller = self._controller, None
        if controller is not None:
            with _speaking(self._hand):
                controller.close()
                self._hand.write_joint_enabled(False)


@contextlib.contextmanager
def _speaking(hand: Any) -> Iterator[None]:
    """Turns errors of ``wujihandpy`` into those of a driver."""
    if hand is None:
        raise DeviceLostError("wuji: the hand is not open")
    try:
        yield
    except Exception as error:
        if isinstance(error, TimeoutError) or "timeout" in str(error).lower():
            raise WrongAnswerError(f"wuji: no answer from the hand in time ({error})") from error
        if isinstance(error, RuntimeError | OSError):
            raise DeviceLostError(f"wuji: the hand is gone ({error})") from error
        raise


def _flat(values: Any) -> Float[np.ndarray, " 20"]:
    flat = np.asarray(values, float).ravel()
    if flat.shape != (MOTORS,):
        raise WrongAnswerError(f"wuji: {flat.size} values received instead of {MOTORS}")
    return flat
