"""A stand-in for Wuji's `wuji_sdk`, with simulated Wuji Hands 2 behind it.

Source, by the maker (Wuji Technology): `wuji-sdk` 2026.10.26 (package index):
`wuji_sdk/__init__.pyi` (calls, fields, comments), its METADATA (examples), and what its functions
answer without a hand: `nid_to_joint_index`, `describe_error`, `SdkManager.connect`.

Facts: `SdkManager.instance().scan()` and `connect(sn= | address= | handedness=, device_name=)`; the
fourth character of a serial number is J on the left and K on the right. 20 joints, fingers from
thumb to pinky, four each; commands are 20 x JointCommand(position [rad], velocity, effort) at up to
1 kHz. **A frame of states has only the joints that are online, each with its `nid`** (bus * 5 +
node: 1 to 4, 6 to 9, ...): `WujiHand2.nid_to_joint_index`. `Subscription.recv` returns None while
there is nothing. Fault codes: 0 is none; 0x0... are warnings, 0x1... deferred stops, 0x2...
immediate stops, 0x3... fatal; a second digit of 1 means that a fault stays until it is cleared, 2
that it needs a restart. The package has no `control_mode` of a Wuji Hand 2: `ControlMode` and
`ControlModeVec` exist, and no call takes them.

Importing the real package prints a privacy notice: it reports its use, unless
WUJI_TELEMETRY_DISABLE=1 is set. Only what the driver uses is here.

Not found: defaults (here: not enabled, effort limit 1.5 A), ranges of the joints, the native rate
of the states (here 500 Hz) and how many frames wait unread (here one), the texts of exceptions in
an outage, whether a joint's fault stops the others (here it does not), and after which time without
commands CommTimeout (0x1002) comes (here never).
"""

from __future__ import annotations

import time
import types
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .common import Faults, Motors
from .sdk import module

STALL, OVERCURRENT = 0x0007, 0x2102
_FAULTS = {  # what the package says of these codes
    STALL: {"name": "Stall", "severity": "Warning", "clear_policy": "AutoClear"},
    OVERCURRENT: {
        "name": "Overcurrent",
        "severity": "ImmediateStop",
        "clear_policy": "ManualClear",
    },
}


class WujiException(Exception):
    pass


class _Member:
    def __init__(self, name: str) -> None:
        self._name = name

    def __repr__(self) -> str:
        return self._name


class Handedness:
    Left, Right = _Member("Handedness.Left"), _Member("Handedness.Right")


class JointCommand:
    def __init__(self, position: float, velocity: float, effort: float) -> None:
        self.position, self.velocity, self.effort = float(position), float(velocity), float(effort)


@dataclass
class JointStateEntry:
    nid: int
    position: float
    velocity: float
    effort: float


@dataclass
class JointDiagnosticsEntry:
    nid: int
    mcu_temp_c_fb: float
    error_code_current: int


@dataclass
class JointStateFrame:
    joints: list[JointStateEntry]


@dataclass
class JointDiagnosticsFrame:
    joints: list[JointDiagnosticsEntry]


@dataclass
class Hand:
    """A simulated Wuji Hand 2 on the network, in rad and A."""

    side: str = "right"
    sn: str = ""
    faults: Faults = field(default_factory=lambda: Faults("missing"))
    offline: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.sn = self.sn or "WH2" + ("J" if self.side == "left" else "K") + "0000001"
        self.motors = Motors(np.zeros(20), 6.0)
        self.connected = False
        self.commands: list[list[tuple[float, float, float]]] = []
        self.reboot()

    def reboot(self) -> None:
        """Switch the hand off and on: not enabled, limits at their defaults, no faults."""
        self.connected = False
        self.enabled = [False] * 20
        self.effort_limits = [1.5] * 20
        self.codes = [0] * 20
        self.motors.place(self.motors.positions)
        self._apply()

    def set_fault(self, joint: int, code: int) -> None:
        """Give a joint a fault code; 0 ends it. All but warnings stop the joint."""
        self.codes[joint] = code
        self._apply()

    def clear(self, joints: list[int]) -> None:
        """Clear faults that can be cleared, as `clear_fault` does."""
        for joint in joints:
            if self.codes[joint] < 0x3000:
                self.codes[joint] = 0
        self._apply()

    def _apply(self) -> None:
        for joint in range(20):
            on = self.enabled[joint] and self.codes[joint] < 0x1000
            self.motors.set_power(on, [joint])

    def check(self) -> None:
        """Raise what the package raises when the hand is away."""
        if not self.connected:
            raise WujiException("Disconnected: Device disconnected")
        if self.faults.silent:
            raise WujiException("OperationTimeout: Operation timed out")

    def obey(self, joints: list[JointCommand]) -> None:
        """Take a command."""
        if len(joints) != 20:
            raise WujiException(f"SchemaMismatch: expected 20 joints, got {len(joints)}")
        if not self.connected:
            raise WujiException("Disconnected: Device disconnected")
        if self.faults.silent:
            return  # a datagram that no one hears
        self.commands.append([(j.position, j.velocity, j.effort) for j in joints])
        self.motors.move([joint.position for joint in joints])

    def _online(self) -> list[int]:
        joints = [joint for joint in range(20) if joint not in self.offline]
        return joints[1:] if self.faults.next_wrong() == "missing" else joints

    def states(self) -> JointStateFrame:
        """A frame of states of this moment."""
        motors = self.motors
        rows = zip(motors.positions, motors.velocities, motors.currents / 1000, strict=True)
        values = [[float(value) for value in row] for row in rows]
        return JointStateFrame([JointStateEntry(_nid(j), *values[j]) for j in self._online()])

    def diagnostics(self) -> JointDiagnosticsFrame:
        """A frame of diagnostics of this moment."""
        heat = self.motors.temperatures
        return JointDiagnosticsFrame(
            [JointDiagnosticsEntry(_nid(j), float(heat[j]), self.codes[j]) for j in self._online()]
        )


def _nid(joint: int) -> int:
    return joint // 4 * 5 + joint % 4 + 1


class Subscription:
    def __init__(self, hand: Hand, make: Callable[[], object], rate: float) -> None:
        self._hand, self._make, self._rate = hand, make, rate
        self._next, self._closed = time.monotonic(), False

    def recv(self) -> object:
        if self._closed or not self._hand.connected:
            raise WujiException("StreamClosed: Stream closed")
        now = time.monotonic()
        if self._hand.faults.silent or now < self._next:
            return None
        self._next = now + 1 / self._rate
        return self._make()

    def close(self) -> None:
        self._closed = True


class _States:
    def __init__(self, hand: Hand, make: Callable[[], object], rate: float) -> None:
        self._arguments = (hand, make, rate)

    def subscribe(self) -> Subscription:
        self._arguments[0].check()
        return Subscription(*self._arguments)


class JointCommandPublisher:
    def __init__(self, hand: Hand) -> None:
        self._hand, self._closed = hand, False

    def send(self, joints: list[JointCommand]) -> None:
        if self._closed:
            raise WujiException("StreamClosed: Stream closed")
        self._hand.obey(joints)

    def close(self) -> None:
        self._closed = True


class JointCommandResource:
    def __init__(self, hand: Hand) -> None:
        self._hand = hand

    def publish(self) -> JointCommandPublisher:
        self._hand.check()
        return JointCommandPublisher(self._hand)


class DeviceEffortLimitResource:
    def __init__(self, hand: Hand) -> None:
        self._hand = hand

    def set(self, value: float | list[float]) -> None:
        self._hand.check()
        values = list(value) if isinstance(value, list | tuple) else [value] * 20
        if len(values) != 20:
            raise WujiException(f"SchemaMismatch: expected 20 values, got {len(values)}")
        self._hand.effort_limits = [float(one) for one in values]

    def get(self) -> list[float | None]:
        self._hand.check()
        offline = self._hand.offline
        return [None if j in offline else v for j, v in enumerate(self._hand.effort_limits)]


@dataclass
class _Value:
    """A resource with a value that can be read."""

    read: Callable[[], object]

    def get(self) -> object:
        return self.read()


class WujiHand2:
    def __init__(self, hand: Hand) -> None:
        self._hand = hand

    def _masked(self, joints: list[int] | None) -> list[int]:
        self._hand.check()
        if joints is not None and len(joints) != 20:
            raise WujiException(f"SchemaMismatch: expected a mask of 20, got {len(joints)}")
        return [j for j in range(20) if joints is None or joints[j]]

    def enable(self, joints: list[int] | None = None) -> None:
        for joint in self._masked(joints):
            self._hand.enabled[joint] = True
            self._hand.motors.move([self._hand.motors.positions[joint]], [joint])
        self._hand._apply()

    def disable(self, joints: list[int] | None = None) -> None:
        for joint in self._masked(joints):
            self._hand.enabled[joint] = False
        self._hand._apply()

    def clear_fault(self, joints: list[int] | None = None) -> None:
        self._hand.clear(self._masked(joints))

    def joint_command(self) -> JointCommandResource:
        return JointCommandResource(self._hand)

    def joint_states(self) -> _States:
        return _States(self._hand, self._hand.states, 500.0)

    def joint_diagnostics(self) -> _States:
        return _States(self._hand, self._hand.diagnostics, 100.0)

    def effort_limit(self) -> DeviceEffortLimitResource:
        return DeviceEffortLimitResource(self._hand)

    def handedness(self) -> _Value:
        return _Value(lambda: self._hand.side)

    def disconnect(self) -> None:
        self._hand.connected = False

    @staticmethod
    def nid_to_joint_index(nid: int) -> int:
        if not 0 < nid < 25 or nid % 5 == 0:
            raise WujiException(f"nid {nid} is not a joint nid (1-4, 6-9, 11-14, 16-19, 21-24)")
        return nid // 5 * 4 + nid % 5 - 1

    @staticmethod
    def describe_error(code: int) -> dict[str, object] | None:
        return _FAULTS.get(code)


def wuji_modules(*hands: Hand) -> dict[str, types.ModuleType]:
    """The module of the stand-in, with the given hands on the network."""

    class SdkManager:
        @staticmethod
        def instance() -> SdkManager:
            return manager

        def connect(
            self, *, sn: str | None = None, handedness: _Member | None = None, device_name: str
        ) -> WujiHand2:
            if (sn is None) == (handedness is None):
                raise WujiException("Must specify exactly one of 'sn', 'address', or 'handedness'")
            letter = {Handedness.Left: "J", Handedness.Right: "K"}.get(handedness)
            found = [h for h in hands if not h.faults.silent and (h.sn == sn or h.sn[3] == letter)]
            if len(found) != 1:
                raise WujiException("Device not found" if not found else "Multiple devices found")
            found[0].connected = True
            return WujiHand2(found[0])

    manager = SdkManager()
    public = (WujiException, Handedness, JointCommand, JointStateEntry, JointDiagnosticsEntry)
    public += (JointStateFrame, JointDiagnosticsFrame, Subscription, JointCommandPublisher)
    public += (WujiHand2, SdkManager)
    members = {one.__name__: one for one in public}
    return {"wuji_sdk": module("wuji_sdk", **members)}
