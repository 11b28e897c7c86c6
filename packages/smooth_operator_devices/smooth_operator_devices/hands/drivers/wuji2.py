"""Driver of the Wuji Hand 2 through the maker's package ``wuji_sdk``.

Facts of its interface, by the maker: ``wuji-sdk`` 2026.10.26 (``wuji_sdk/__init__.pyi``). Hands are
found on the network by serial number or side. Twenty joints, thumb first, from the palm to the tip;
a command has a position [rad], velocity and effort for each. A frame of states holds only the
joints that are online, each with its ``nid`` (bus times 5, plus 1 to 4), which
``WujiHand2.nid_to_joint_index`` turns into a joint. Efforts and their limits are in A. Fault codes:
0 none, 0x0... warnings, from 0x1000 on the joint stops.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, require
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
_NAME: Final = "smooth-operator"
_TIMEOUT: Final = 0.1
"""Time that a new state may take [s]."""
_POLL_S: Final = 0.001


@dataclass(frozen=True)
class Wuji2Sink(HardwareSink):
    """Moves a Wuji Hand 2; see ``HardwareSink``.

    Attributes:
        port: serial number of the hand; empty for the only one of its side on the network.
    """

    driver: ClassVar[str] = "wuji2"

    @property
    def bus(self) -> str:
        """The hand with that serial number; without one any hand."""
        return f"wuji2:{self.port}" if self.port else "wuji2"

    def device(self, actuators: ActuatorMap) -> Wuji2Device:
        """The hand, not yet open; see ``HardwareSink``."""
        require(Wuji2Device.name, "wuji2", "wuji_sdk")
        return Wuji2Device(actuators, self.port)


class Wuji2Device(HandDevice):
    """A Wuji Hand 2 on the network; see ``HandDevice``.

    ``Reading.currents`` are the efforts, in mA.

    Args:
        table: table of the hand; ``limit`` is the largest effort [mA] of each joint.
    """

    driver, name, motors = "wuji2", "a Wuji Hand 2", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(())
        self._port, self._limits = port, table.limits / 1000.0
        self._sdk: Any = None
        self._hand: Any = None
        self._streams: list[Any] = []
        self._publisher: Any = None
        self._heat: Float[np.ndarray, " 20"] = np.full(MOTORS, np.nan)
        self._codes = [0] * MOTORS

    def open(self) -> None:
        """Find the hand, check its side and its limits; the motors stay off. See ``HandDevice``."""
        os.environ.setdefault("WUJI_TELEMETRY_DISABLE", "1")  # the package reports its use
        import wuji_sdk

        self._sdk, self._limited = wuji_sdk, False
        self._heat, self._codes = np.full(MOTORS, np.nan), [0] * MOTORS
        side = wuji_sdk.Handedness.Left if self._table.side == "left" else wuji_sdk.Handedness.Right
        which = {"sn": self._port} if self._port else {"handedness": side}
        name = f"{_NAME} {self._port or self._table.side}"
        with (
            self._opening(
                "check the hand's power, cable and network, and that no other program uses it"
            ),
            _speaking(),
        ):
            self._hand = wuji_sdk.SdkManager.instance().connect(**which, device_name=name)
            found = str(self._hand.handedness().get()).lower()
            self._check_side(next((s for s in ("left", "right") if s in found), None))
            if not np.isfinite(self._limits).all():  # the hand's own
                own = np.array(self._hand.effort_limit().get(), float)
                self._limits = np.where(np.isfinite(self._limits), self._limits, own)
            self._streams = [
                self._hand.joint_states().subscribe(),
                self._hand.joint_diagnostics().subscribe(),
            ]
            self._publisher = self._hand.joint_command().publish()
            self.read()

    def read(self) -> Reading:
        """The next state; heat and faults as they come. See ``HandDevice``."""
        with _speaking():
            self._opened(self._hand)
            states, diagnostics = self._streams
            states.recv()  # one from before
            frame = self._newest(states)
            if (news := diagnostics.recv()) is not None:
                for entry in news.joints:
                    joint = self._joint(entry.nid)
                    self._heat[joint] = entry.mcu_temp_c_fb
                    self._codes[joint] = int(entry.error_code_current)
        rows = np.full((3, MOTORS), np.nan)
        for entry in frame.joints:
            rows[:, self._joint(entry.nid)] = entry.position, entry.velocity, entry.effort
        if not np.isfinite(rows[0]).any():
            raise WrongAnswerError("wuji2: no joint is online")
        offline = self._reports(np.isnan(rows[0]), lambda lost: "offline" if lost else "")
        faults = self._reports(self._codes, lambda code: self._fault(code) if code else "")
        return Reading(
            positions=rows[0],
            velocities=rows[1],
            currents=1000.0 * rows[2],
            temperatures=self._heat.copy(),
            errors=offline + faults,
        )

    def settings(self) -> Sequence[Setting]:
        """Limits of the efforts [A]; see ``HandDevice``."""
        with _speaking():
            found = np.array(
                self._opened(self._hand).effort_limit().get(), float
            )  # NaN of a joint offline
        known = np.isfinite(found)
        if not known.all():
            raise WrongAnswerError("wuji2: a joint is offline")
        return (Setting("effort limit", self._limits, found),)

    def write(self, commands: Float[np.ndarray, " 20"]) -> None:
        """Send the positions [rad]; the first call sets limits, clears faults and switches the
        motors on. See ``HandDevice``."""
        with _speaking():
            hand = self._opened(self._hand)
            if self._limited:
                self._send(commands)
                return
            hand.effort_limit().set([float(limit) for limit in self._limits])
            hand.clear_fault()
            self._send(commands)
            hand.enable()
            self._send(commands)
            self._limited = True

    def relax(self) -> None:
        """Switch the motors off; see ``HandDevice``."""
        super().relax()
        with _speaking():
            self._opened(self._hand).disable()

    def close(self) -> None:
        """Switch the motors off and let the hand go; see ``HandDevice``."""
        hand, self._hand = self._hand, None
        streams, self._streams = [*self._streams, self._publisher], []
        self._publisher = None
        for action in ("disable", "disconnect"):
            with contextlib.suppress(Exception):  # of a hand that is gone
                getattr(hand, action)()
        for stream in streams:
            with contextlib.suppress(Exception):
                stream.close()

    def _send(self, commands: Float[np.ndarray, " 20"]) -> None:
        command = self._sdk.JointCommand
        self._publisher.send([command(float(position), 0.0, 0.0) for position in commands])

    def _newest(self, stream: Any) -> Any:
        deadline = time.perf_counter() + _TIMEOUT
        while (frame := stream.recv()) is None:
            if time.perf_counter() > deadline:
                raise WrongAnswerError(
                    f"wuji2: no state arrived from the hand within {_TIMEOUT:g} s"
                )
            time.sleep(_POLL_S)
        return frame

    def _joint(self, nid: int) -> int:
        joint = int(self._sdk.WujiHand2.nid_to_joint_index(nid))
        if not 0 <= joint < MOTORS:
            raise WrongAnswerError(f"wuji2: received a state of the unknown joint {nid}")
        return joint

    def _fault(self, code: int) -> str:
        known = self._sdk.WujiHand2.describe_error(code)
        return f"fault 0x{code:04X}" if known is None else f"{known['name']} (0x{code:04X})"


@contextlib.contextmanager
def _speaking() -> Iterator[None]:
    """Turns errors of ``wuji_sdk`` into those of a driver."""
    try:
        yield
    except SinkError:
        raise
    except Exception as error:  # the package's own classes, and those of its library
        late = any(word in str(error).lower() for word in ("timeout", "timed out"))
        raise (WrongAnswerError if late else DeviceLostError)(f"wuji2: {error}") from error
