"""Hands of any device of NVIDIA's Isaac Teleop: its headsets (CloudXR) and glove plug-ins.

``HandsSource`` gives the 26 OpenXR joints of each hand, with positions [m], quaternions x y z w and
one flag of validity for each joint, in OpenXR's world (y up); a hand that is not tracked is absent.
The session is Isaac Teleop's ``TeleopSession``, which needs the CloudXR runtime.

Source: ``teleop_session_manager`` and ``hands_source.py`` of
https://github.com/NVIDIA/IsaacTeleop (Apache-2.0), and its wheel 1.5.175.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.errors import MissingExtraError, SourceError, reason
from smooth_operator.headsets.openxr_joints import ORIENTATION_VALID, POSITION_VALID, openxr_frame
from smooth_operator.teleop.sources.inboxes import Inbox, Message
from smooth_operator.types import HandFrame, Side
from smooth_operator_devices.trackers.polled import PolledInbox, PolledSource

WORLD: Final = "isaac"
"""Name of the world frame: that of the session's OpenXR runtime, z up."""


@dataclass(frozen=True)
class IsaacHands(PolledSource):
    """Both hands from a session of Isaac Teleop, on Linux; ``rate`` is that of its steps."""

    label = "Isaac Teleop"

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        return "; connect the headset to CloudXR, or start the plug-in of the gloves"

    def connect(self) -> Inbox:
        """Starts the session."""
        return SessionInbox(tuple(self.sides), self.rate)

    def frame(self, message: Message, received: float) -> HandFrame:
        """Hand with 26 joints; see ``PolledSource``."""
        side, positions, orientations, valid = message
        poses = np.concatenate([positions, orientations], axis=1)
        flags = np.where(valid, ORIENTATION_VALID | POSITION_VALID, 0)
        return openxr_frame(poses, flags, side, received, world=WORLD, where=f"the {side} hand")


class SessionInbox(PolledInbox):
    """A session with both hands; a message is the side and the arrays of a tracked hand.

    Args:
        sides: hands to use.
        rate: steps of the session per second [Hz].

    Raises:
        MissingExtraError: isaacteleop is missing.
        SourceError: the session can't start.
    """

    address = "Isaac Teleop"

    def __init__(self, sides: Sequence[Side], rate: float) -> None:
        super().__init__(rate)
        try:
            from isaacteleop.retargeting_engine.deviceio_source_nodes import HandsSource
            from isaacteleop.retargeting_engine.interface import OutputCombiner
            from isaacteleop.retargeting_engine.tensor_types import HandInputIndex
            from isaacteleop.teleop_session_manager import TeleopSession, TeleopSessionConfig
        except ModuleNotFoundError as error:
            raise MissingExtraError("the source 'isaac'", "isaac") from error
        self._index = HandInputIndex
        self._sides = sides
        hands = HandsSource("hands")
        names = [f"hand_{side}" for side in sides]
        pipeline = OutputCombiner({name: hands.output(name) for name in names})
        config = TeleopSessionConfig(app_name="smooth-operator", pipeline=pipeline)
        self._stack = contextlib.ExitStack()
        try:
            self._session: Any = self._stack.enter_context(TeleopSession(config))
        except Exception as error:
            raise SourceError(
                f"Isaac Teleop can't start a session: {reason(error)}; start the CloudXR runtime "
                "(python -m isaacteleop.cloudxr.service start) and set its environment"
            ) from error

    def ask(self) -> list[Message]:
        """Steps the session, and returns the hands that are tracked; see ``PolledInbox``."""
        try:
            result = self._session.step()
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
        """Ends the session."""
        self._stack.close()
