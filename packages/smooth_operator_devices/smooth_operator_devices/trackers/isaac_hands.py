"""Hands and vibration of the devices of NVIDIA's Isaac Teleop: headsets (CloudXR), glove plug-ins.

``HandsSource`` gives the 26 OpenXR joints of each hand, with positions [m], quaternions x y z w and
one flag of validity for each joint, in OpenXR's world (y up); a hand that is not tracked is absent.
The session is Isaac Teleop's ``TeleopSession``, which needs the CloudXR runtime.

In each step the session gives new levels to the devices of its ``sinks``. A controller takes an
amplitude of 0 to 1, a frequency [Hz] (0 for the default) and a duration [s]; an amplitude of 0 ends
a pulse. The plug-in of a glove takes a power of 0 to 1 for each finger, from thumb to pinky.

Source: ``teleop_session_manager``, ``hands_source.py``, ``haptic_devices`` and ``tactile_types.py``
of https://github.com/NVIDIA/IsaacTeleop (Apache-2.0), its wheel 1.5.175, and
https://nvidia.github.io/IsaacTeleop/main/device/haptic_feedback.html.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from smooth_operator.errors import MissingExtraError, SourceError, reason
from smooth_operator.headsets.openxr_joints import ORIENTATION_VALID, POSITION_VALID, openxr_frame
from smooth_operator.landmarks import FINGERS
from smooth_operator.teleop.sinks.feedback import PULSE_S
from smooth_operator.teleop.sources.inboxes import Inbox, Message
from smooth_operator.types import HandFrame, Side
from smooth_operator_devices.trackers.polled import PolledInbox, PolledSource

WORLD: Final = "isaac"
"""Name of the world frame: that of the session's OpenXR runtime, z up."""

_SIDES: Final[tuple[Side, ...]] = ("left", "right")


class Haptics:
    """Levels for the controllers, or for the gloves of a plug-in, in the steps of a session.

    Args:
        collection: collection of tensors that the plug-in reads; empty for the controllers.
    """

    def __init__(self, collection: str) -> None:
        self._collection = collection
        self._name = collection or "controllers"
        self._newest: dict[Side, list[float]] = {}
        self._kind: Any = None

    def put(self, message: dict[str, Any]) -> None:
        """Store the levels of a hand for the next step; safe from any thread."""
        levels = dict(zip(message["fingers"], message["levels"], strict=True))
        self._newest[message["side"]] = [levels.get(finger, 0.0) for finger in FINGERS]

    def sink(self) -> Any:
        """Create the graph of a new session, from the inputs of both hands to the device."""
        from isaacteleop.deviceio_trackers import ControllerTracker
        from isaacteleop.haptic_devices.controller import ControllerHapticDevice
        from isaacteleop.haptic_devices.glove import haptic_glove_device
        from isaacteleop.retargeting_engine.deviceio_source_nodes import HapticSink
        from isaacteleop.retargeting_engine.interface import OptionalType, ValueInput

        if self._collection:
            device = haptic_glove_device(self._collection)
        else:
            device = ControllerHapticDevice(ControllerTracker())
        self._kind = OptionalType(device.accepted_type())
        inputs = {side: ValueInput(f"{self._name}_{side}", self._kind) for side in _SIDES}
        return HapticSink(self._name, device).connect(
            {side: node.output(ValueInput.VALUE) for side, node in inputs.items()}
        )

    def inputs(self, *, silent: bool = False) -> dict[str, Any]:
        """Inputs of the next step: new levels of a hand or no value, or 0 for both hands."""
        from isaacteleop.retargeting_engine.interface import OptionalTensorGroup, ValueInput

        inputs = {}
        for side in _SIDES:
            group, levels = OptionalTensorGroup(self._kind), self._newest.pop(side, None)
            levels = [0.0] * len(FINGERS) if silent else levels
            if levels is not None:
                values = levels if self._collection else [max(levels), 0.0, PULSE_S]
                group[0] = np.array(values, np.float32)
            inputs[f"{self._name}_{side}"] = {ValueInput.VALUE: group}
        return inputs


@dataclass(frozen=True)
class IsaacHands(PolledSource):
    """Both hands from a session of Isaac Teleop, on Linux; ``rate`` is that of its steps.

    Attributes:
        haptics: outputs of feedback that use the session; complete before the start.
    """

    haptics: list[Haptics] = field(default_factory=list, init=False, repr=False, compare=False)
    label = "Isaac Teleop"

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        return "; connect the headset to CloudXR, or start the plug-in of the gloves"

    def connect(self) -> Inbox:
        """Starts the session."""
        return SessionInbox(tuple(self.sides), self.rate, self.haptics)

    def frame(self, message: Message) -> HandFrame:
        """Hand with 26 joints; see ``PolledSource``."""
        side, positions, orientations, valid = message
        poses = np.concatenate([positions, orientations], axis=1)
        flags = np.where(valid, ORIENTATION_VALID | POSITION_VALID, 0)
        return openxr_frame(poses, flags, side, None, world=WORLD, where=f"the {side} hand")


class SessionInbox(PolledInbox):
    """A session with both hands; a message is the side and the arrays of a tracked hand.

    Args:
        sides: hands to use.
        rate: steps of the session per second [Hz].
        haptics: outputs of feedback, which get their levels in the steps.

    Raises:
        MissingExtraError: isaacteleop is missing.
        SourceError: the session can't start.
    """

    address = "Isaac Teleop"

    def __init__(self, sides: Sequence[Side], rate: float, haptics: Sequence[Haptics] = ()) -> None:
        super().__init__(rate)
        try:
            from isaacteleop.retargeting_engine.deviceio_source_nodes import HandsSource
            from isaacteleop.retargeting_engine.interface import OutputCombiner
            from isaacteleop.retargeting_engine.tensor_types import HandInputIndex
            from isaacteleop.teleop_session_manager import TeleopSession, TeleopSessionConfig
        except ModuleNotFoundError as error:
            raise MissingExtraError("the source 'isaac'", "isaac") from error
        self._index = HandInputIndex
        self._sides, self._haptics = sides, haptics
        hands = HandsSource("hands")
        names = [f"hand_{side}" for side in sides]
        pipeline = OutputCombiner({name: hands.output(name) for name in names})
        self._stack = contextlib.ExitStack()
        try:
            config = TeleopSessionConfig(
                app_name="smooth-operator",
                pipeline=pipeline,
                sinks=[haptics.sink() for haptics in self._haptics],
            )
            self._session: Any = self._stack.enter_context(TeleopSession(config))
        except Exception as error:
            raise SourceError(
                f"Isaac Teleop can't start a session: {reason(error)}; start the CloudXR runtime "
                "(python -m isaacteleop.cloudxr.service start) and set its environment"
            ) from error

    def ask(self) -> list[Message]:
        """Steps the session, and returns the hands that are tracked; see ``PolledInbox``."""
        try:
            result = self._step()
        except Exception as error:
            raise SourceError(f"the session of Isaac Teleop failed: {reason(error)}") from error
        messages: list[Message] = []
        for side in self._sides:
            hand = result[f"hand_{side}"]
            if not hand.is_none:
                fields = ("JOINT_POSITIONS", "JOINT_ORIENTATIONS", "JOINT_VALID")
                arrays = (np.array(hand[getattr(self._index, name)]) for name in fields)
                messages.append((side, *arrays))
        self.problem = "" if messages else "Isaac Teleop tracks no hand now"
        return messages

    def close(self) -> None:
        """Ends the session, after levels of 0 for its outputs of feedback."""
        with self._stack, contextlib.suppress(Exception):  # the session may have failed
            if self._haptics:
                self._step(silent=True)

    def _step(self, *, silent: bool = False) -> Any:
        inputs: dict[str, Any] = {}
        for haptics in self._haptics:
            inputs |= haptics.inputs(silent=silent)
        return self._session.step(external_inputs=inputs)
