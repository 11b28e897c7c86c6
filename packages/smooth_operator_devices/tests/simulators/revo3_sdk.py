"""A stand-in for BrainCo's `bc_revo3_sdk`, with a simulated Revo 3 behind it.

Sources, by the maker (BrainCo):

- `bc-revo3-sdk` 2.3.2 (package index, proprietary): `bc_revo3_sdk/main_mod.pyi` (calls, fields,
  comments), its METADATA, and the values of its enumerations.
- github.com/BrainCoTech/brainco-revo3-sdk, commit 7ba96ebd (2026-08-03), `python/revo3/
  revo3_joint_map.md`: order and ranges of the motors. Its examples use an older object
  (`revo3_servo_hand`), which 2.3.2 does not have.

Facts: `from bc_revo3_sdk import main_mod as sdk`; all calls that reach the hand are awaited. Order
of the 21 joints: **pinky** abduction, MCP, PIP, DIP, then ring, middle, index, then thumb CMC
rotation, MCP, IP, CMC abduction, CMC flexion. Fingers are numbered the other way: 1 index, 2
middle, 3 ring, 4 pinky; the thumb has calls of its own. Degrees, rpm, mA. `Motion.set_position`
sends once, without a watchdog; `Motion.open_servo(command_timeout_ms)` makes a session that
expires without commands (100 ms by default). Moving beside an open session is a ControlConflict.
Errors are SdkError with code, retryable, operation_effect and recovery_requirement. Only the
21-joint Ultra can be moved.

Not found: what the hand does when a session expires (here it holds its target), whether
targets out of range are refused (here they are, as InvalidArgument), fault codes of motors, the
identifier of the layout, and defaults of the gains. Only what the driver uses is here: no touch,
calibration, configuration, updates, nor the SDK's own trajectories (`move_to` and the like).
"""

from __future__ import annotations

import enum
import math
import time
import types
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .common import Faults, Motors
from .sdk import module

_FINGER = ("abd", "mcp", "pip", "dip")
JOINTS = (
    *(f"{finger}_{part}" for finger in ("pinky", "ring", "middle", "index") for part in _FINGER),
    *("thumb_cmc_rot", "thumb_mcp", "thumb_ip", "thumb_cmc_abd", "thumb_cmc_flex"),
)
_BENDING = [(-5, 90), (-12, 90), (-20, 90)]
_THUMB = [(-30, 90), (-10, 90), (-10, 103), (0, 110), (0, 75)]
RANGES = np.array(  # degrees
    [(-14, 15), *_BENDING, *([(-15, 15), *_BENDING] * 3), *_THUMB]
)
COUNT = 21


HandSide = enum.Enum("HandSide", {"Left": 0, "Right": 1})
Revo3Model = enum.Enum("Revo3Model", {"Ultra": 20, "UltraVisionTouch": 22, "Pro": 23})
SdkErrorCode = enum.Enum(
    "SdkErrorCode",
    {
        "ConnectionFailed": 1,
        "InvalidArgument": 2,
        "InvalidState": 3,
        "Timeout": 4,
        "UnsupportedCapability": 5,
        "DeviceFault": 6,
        "Internal": 7,
        "ControlConflict": 8,
    },
)
ServoSessionState = enum.Enum("ServoSessionState", {"Active": 0, "Expired": 1, "Closed": 2})


class SdkError(RuntimeError):
    def __init__(self, code: SdkErrorCode, message: str) -> None:
        super().__init__(message)
        self.code, self.message = code, message


@dataclass
class HandState:
    positions_deg: list[float]
    velocities_rpm: list[float]
    currents_ma: list[float]


@dataclass
class HealthSnapshot:
    motor_fault_codes: list[int]


@dataclass
class DeviceInfo:
    hand_side: HandSide
    model: Revo3Model


@dataclass
class JointLayout:
    joint_count: int = COUNT


@dataclass
class Revo3:
    """A simulated Revo 3, in degrees."""

    side: str = "right"
    port: str = "/dev/ttyUSB0"
    model: Revo3Model = Revo3Model.Ultra
    faults: Faults = field(default_factory=lambda: Faults("timeout", "fault"))

    def __post_init__(self) -> None:
        self.motors = Motors(np.zeros(COUNT), 360.0)
        self.sent: list[tuple[str, object]] = []
        self.reboot()

    def reboot(self) -> None:
        """Switch the hand off and on: no faults, no sessions."""
        self.motor_faults = [0] * COUNT
        self.sessions: list[ServoSession] = []
        self.motors.place(self.motors.positions)
        self.motors.set_power(True)

    def transact(self) -> None:
        """Raise what a failing exchange raises."""
        wrong = self.faults.next_wrong()
        if self.faults.silent or wrong == "timeout":
            raise SdkError(SdkErrorCode.Timeout, "device did not answer")
        if wrong == "fault":
            raise SdkError(SdkErrorCode.DeviceFault, "device fault")

    def move(self, kind: str, joints: Sequence[int], targets: Sequence[float]) -> None:
        """Check a command of positions and send it."""
        if len(targets) != len(joints):
            raise SdkError(
                SdkErrorCode.InvalidArgument, f"expected {len(joints)} values, got {len(targets)}"
            )
        for joint, target in zip(joints, targets, strict=True):
            low, high = RANGES[joint]
            if not (math.isfinite(target) and low <= target <= high):
                raise SdkError(
                    SdkErrorCode.InvalidArgument,
                    f"{JOINTS[joint]}: {target} is not in {low} to {high} degrees",
                )
        self.transact()
        self.sent.append((kind, list(targets)))
        for joint, target in zip(joints, targets, strict=True):
            self.motors.set_power(not self.motor_faults[joint], [joint])
            self.motors.move([target], [joint])


class ServoSession:
    def __init__(self, hand: Revo3, command_timeout_ms: int) -> None:
        self._hand, self._timeout = hand, command_timeout_ms / 1000
        self._fed, self._closed, self._expired = time.monotonic(), False, False

    @property
    def state(self) -> ServoSessionState:
        if self._closed:
            return ServoSessionState.Closed
        if time.monotonic() - self._fed > self._timeout:
            self._expired = True
        return ServoSessionState.Expired if self._expired else ServoSessionState.Active

    def _feed(self) -> None:
        if self.state is not ServoSessionState.Active:
            raise SdkError(SdkErrorCode.InvalidState, f"servo session is {self.state.name}")
        self._fed = time.monotonic()

    async def send_position(self, position_deg: Sequence[float]) -> None:
        self._feed()
        self._hand.move("servo position", range(COUNT), position_deg)

    def close(self) -> None:
        self._closed = True


class Motion:
    def __init__(self, hand: Revo3) -> None:
        self._hand = hand

    def _alone(self) -> None:
        if any(one.state is ServoSessionState.Active for one in self._hand.sessions):
            raise SdkError(SdkErrorCode.ControlConflict, "a servo session is active")

    def open_servo(self, command_timeout_ms: int | None = None) -> ServoSession:
        self._alone()
        session = ServoSession(
            self._hand, 100 if command_timeout_ms is None else command_timeout_ms
        )
        self._hand.sessions.append(session)
        return session

    async def set_zero_force_enabled(self, enabled: bool) -> None:
        self._alone()
        self._hand.transact()
        self._hand.motors.set_power(not enabled)


class State:
    def __init__(self, hand: Revo3) -> None:
        self._hand = hand

    async def snapshot(self) -> HandState:
        self._hand.transact()
        motors = self._hand.motors
        return HandState(
            motors.positions.tolist(), (motors.velocities / 6).tolist(), motors.currents.tolist()
        )


class Health:
    def __init__(self, hand: Revo3) -> None:
        self._hand = hand

    async def snapshot(self) -> HealthSnapshot:
        self._hand.transact()
        return HealthSnapshot(list(self._hand.motor_faults))

    async def clear_motor_faults(self) -> None:
        self._hand.transact()
        self._hand.motor_faults = [0] * COUNT
        self._hand.motors.set_power(True)

    async def motor_module_temperatures_c(self) -> list[float]:
        self._hand.transact()
        return self._hand.motors.temperatures.tolist()


class Hand:
    def __init__(self, hand: Revo3) -> None:
        self._hand = hand
        self.state, self.health = State(hand), Health(hand)
        self.joint_layout: JointLayout | None = JointLayout()
        self.device_info = DeviceInfo(HandSide[hand.side.capitalize()], hand.model)

    @property
    def motion(self) -> Motion:
        if self._hand.model.value > 22:
            raise SdkError(
                SdkErrorCode.UnsupportedCapability, f"{self._hand.model.name} can't be moved yet"
            )
        return Motion(self._hand)

    async def close(self) -> None:
        for session in self._hand.sessions:
            session.close()


def revo3_modules(*hands: Revo3) -> dict[str, types.ModuleType]:
    """The modules of the stand-in, with the given hands on their ports."""

    class Manager:
        async def connect_auto(self, port: str | None = None) -> Hand:
            for hand in hands:
                if port in (None, hand.port) and not hand.faults.silent:
                    hand.transact()
                    return Hand(hand)
            raise SdkError(SdkErrorCode.ConnectionFailed, "no device")

        async def close(self) -> None:
            pass

    public = (HandSide, Revo3Model, SdkErrorCode, ServoSessionState, SdkError, HandState)
    public += (HealthSnapshot, DeviceInfo, JointLayout, ServoSession, Motion, State, Health, Hand)
    main = module("bc_revo3_sdk.main_mod", **{one.__name__: one for one in (*public, Manager)})
    return {"bc_revo3_sdk": module("bc_revo3_sdk", main_mod=main), "bc_revo3_sdk.main_mod": main}
