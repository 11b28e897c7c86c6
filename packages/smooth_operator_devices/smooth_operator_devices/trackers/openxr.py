"""Hands or trackers of the active OpenXR runtime of this computer: SteamVR, Monado and others.

The runtime gives 26 joints of each hand with ``XR_EXT_hand_tracking``, whatever tracks them: a
headset, a camera, or gloves whose maker has an OpenXR layer. The session shows nothing
(``XR_MND_headless``), so it needs no window, and another program may draw in the headset if the
runtime allows two. The times of the joints are asked for by ``XR_KHR_convert_timespec_time``, on
Windows by ``XR_KHR_win32_convert_performance_counter_time``.

Source: the OpenXR specification, https://registry.khronos.org/OpenXR/specs/1.1/html/xrspec.html
(session life cycle, XrSpaceLocationFlags, the extensions above), and the bindings of
https://github.com/cmbruns/pyopenxr, 1.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from smooth_operator.headsets.openxr_joints import openxr_frame
from smooth_operator.poses import to_ours
from smooth_operator.teleop.sources.inboxes import Inbox, Message
from smooth_operator.teleop.sources.payload import pose_frame
from smooth_operator.types import HandFrame, Side
from smooth_operator_devices.trackers.openxr_session import HandInbox
from smooth_operator_devices.trackers.openxr_trackers import TrackerInbox
from smooth_operator_devices.trackers.polled import PolledSource

WORLD: Final = "openxr"
"""Name of the world frame: the runtime's stage on the floor, or else the place of its start."""


@dataclass(frozen=True)
class OpenXrSource(PolledSource):
    """Both hands from the active OpenXR runtime of this computer, or Vive trackers on them.

    Attributes:
        track: ``hands`` with their fingers; or ``trackers``, poses only, for ``--wrist-source``.
        right: role of the tracker on the right hand, as the runtime's settings give it.
        left: role of the tracker on the left hand.
    """

    label = "OpenXR"
    track: Literal["hands", "trackers"] = "hands"
    right: str = "right_wrist"
    left: str = "left_wrist"

    def connect(self) -> Inbox:
        """Starts a session of the runtime."""
        if self.track == "hands":
            return HandInbox(tuple(self.sides), self.rate)
        roles: dict[Side, str] = {"right": self.right, "left": self.left}
        return TrackerInbox({side: roles[side] for side in self.sides}, self.rate)

    def frame(self, message: Message) -> HandFrame:
        """Hand with 26 joints, or the pose of a tracker; see ``PolledSource``."""
        side, data = message
        if self.track == "trackers":
            x, y, z, *xyz, w = data
            return pose_frame(to_ours([x, y, z, w, *xyz]), None, side, WORLD)
        poses = np.concatenate([data["place"], data["turn"]], axis=1)
        where = f"the {side} hand"
        return openxr_frame(poses, data["flags"], side, None, world=WORLD, where=where)
