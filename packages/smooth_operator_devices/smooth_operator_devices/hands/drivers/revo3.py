"""Driver of BrainCo's Revo 3 through the maker's package ``bc_revo3_sdk``.

Facts of its interface, by the maker: ``bc-revo3-sdk`` 2.3.2 (``bc_revo3_sdk/main_mod.pyi``), and
BrainCoTech/brainco-revo3-sdk, commit 7ba96ebd (``python/revo3/revo3_joint_map.md``: order and
ranges). All calls that reach the hand are awaited. 21 joints in degrees, the pinky first and the
thumb last; targets beyond the ranges are refused. A servo session takes positions and expires
without them; beside an open session nothing else may move the hand. Errors have a code and say
whether a repetition may help. Only the Ultra, with 21 joints, can be moved.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 21
_FINGER: Final = [(-15, 15), (-5, 90), (-12, 90), (-20, 90)]
_THUMB: Final = [(-30, 90), (-10, 90), (-10, 103), (0, 110), (0, 75)]
RANGES: Final = np.array([(-14, 15), *_FINGER[1:], *_FINGER, *_FINGER, *_FINGER, *_THUMB], float)
"""Ranges of the joints [deg]."""

_SESSION_MS: Final = 200
"""Time without a command after which a servo session expires."""
_TIMEOUT: Final = 0.2
"""Time that an answer may take [s]."""
_OPENING: Final = 5.0
_SLOW: Final = 25
"""Number of cycles between two readings of faults, or of temperatures."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Revo3Sink(HardwareSink):
    """Moves a BrainCo Revo 3 Ultra; see ``HardwareSink``.

    Attributes:
        port: its port, as the maker's package names it.
    """

    driver: ClassVar[str] = "revo3"

    port: str = "/dev/ttyUSB0"

    def device(self, actuators: ActuatorMap) -> Revo3Device:
        """The hand, not yet open; see ``HardwareSink``."""
        require(Revo3Device.name, "revo3", "bc_revo3_sdk")
        return Revo3Device(actuators, self.port)


class Revo3Device(HandDevice):
    """A Revo 3 on its port; see ``HandDevice``.

    Positions go through a servo session, which expires when this program ends without closing it.
    ``relax`` ends the session and switches the hand to zero force. The driver sets no limits;
    ``limit`` [mA] is that of the contact guard.

    Args:
        table: table of the hand, in degrees.
    """

    driver, name, motors = "revo3", "a Revo 3", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(())
        self._port = port
        self._sdk: Any = None
        self._manager: Any = None
        self._hand: Any = None
        self._session: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._cycle = 0
        self._faults: list[int] = []
        self._heat: Float[np.ndarray, " 21"] | None = None

    def open(self) -> None:
        """Find the hand, check its side and model; see ``HandDevice``."""
        from bc_revo3_sdk import main_mod

        self._sdk, self._limited, self._cycle = main_mod, False, 0
        self._faults, self._heat = [], None
        self._loop = asyncio.new_event_loop()
        with self._opening(
            f"check the hand's power, the port {self._port}, and that no other program uses it"
        ):
            self._manager = main_mod.Manager()
            self._hand = self._run(
                lambda: self._manager.connect_auto(port=self._port), "connecting", _OPENING
            )
            information = self._hand.device_info
            self._check_side("left" if information.hand_side == main_mod.HandSide.Left else "right")
            layout = self._hand.joint_layout
            if layout is None or layout.joint_count != MOTORS:
                raise SinkError(
                    "revo3: the hand does not have the layout of 21 joints, which only the Ultra "
                    "has"
                )
            self.read()

    def read(self) -> Reading:
        """Positions, speeds and currents; faults and temperatures now and then. See
        ``HandDevice``."""
        hand = self._opened(self._hand)
        state = self._run(hand.state.snapshot, "state")
        rows = [state.positions_deg, state.velocities_rpm, state.currents_ma]
        if any(len(row) != MOTORS for row in rows) or not np.isfinite(rows[0]).all():
            raise WrongAnswerError(f"revo3: received a state without {MOTORS} finite positions")
        if self._cycle % _SLOW == 0:
            self._faults = list(self._run(hand.health.snapshot, "health").motor_fault_codes)
        elif self._cycle % _SLOW == 1:
            heat = self._run(hand.health.motor_module_temperatures_c, "temperatures")
            self._heat = np.array(heat, float)
        self._cycle += 1
        return Reading(
            positions=np.array(rows[0], float),
            velocities=6.0 * np.array(rows[1], float),
            currents=np.array(rows[2], float),
            temperatures=self._heat,
            errors=self._reports(self._faults, lambda code: f"fault {code:#x}" if code else ""),
        )

    def write(self, commands: Float[np.ndarray, " 21"]) -> None:
        """Send the positions [deg]; the first call clears faults and ends zero force. A session
        that has expired is opened again. See ``HandDevice``."""
        hand, states = self._opened(self._hand), self._sdk.ServoSessionState
        if not self._limited:
            self._end_session()
            self._run(hand.health.clear_motor_faults, "clearing faults")
            self._run(lambda: hand.motion.set_zero_force_enabled(False), "zero force")
            self._limited = True
        if self._session is None or self._session.state != states.Active:
            self._end_session()
            self._session = self._checked(lambda: hand.motion.open_servo(_SESSION_MS))
        target = np.clip(commands, RANGES[:, 0], RANGES[:, 1]).tolist()
        self._run(lambda: self._session.send_position(target), "positions")

    def relax(self) -> None:
        """End the session and switch to zero force; see ``HandDevice``."""
        super().relax()
        hand = self._opened(self._hand)
        self._end_session()
        self._run(lambda: hand.motion.set_zero_force_enabled(True), "zero force")

    def close(self) -> None:
        """Close the session and give the port back; see ``HandDevice``."""
        self._end_session()
        hand, self._hand = self._hand, None
        manager, self._manager = self._manager, None
        loop, self._loop = self._loop, None
        if loop is None:
            return
        for part in (hand, manager):
            if part is not None:
                with contextlib.suppress(Exception):  # of a hand that is gone
                    loop.run_until_complete(asyncio.wait_for(_awaited(part.close), 1.0))
        loop.close()

    def _end_session(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            with contextlib.suppress(Exception):
                session.close()

    def _run(self, call: Callable[[], Awaitable[_T]], what: str, seconds: float = _TIMEOUT) -> _T:
        loop = self._opened(self._loop)
        return self._checked(
            lambda: loop.run_until_complete(asyncio.wait_for(_awaited(call), seconds)), what
        )

    def _checked(self, call: Callable[[], _T], what: str = "session") -> _T:
        """The result of a call; turns errors of the package into those of a driver."""
        try:
            return call()
        except TimeoutError as error:
            raise WrongAnswerError(f"revo3: no answer in time ({what})") from error
        except self._sdk.SdkError as error:
            lost = error.code in (
                self._sdk.SdkErrorCode.ConnectionFailed,
                self._sdk.SdkErrorCode.Internal,
            )
            kind = DeviceLostError if lost else WrongAnswerError
            raise kind(f"revo3: {what} failed ({error})") from error


async def _awaited(call: Callable[[], Awaitable[_T]]) -> _T:
    """The result of a call that needs a running loop to be made at all."""
    return await call()
