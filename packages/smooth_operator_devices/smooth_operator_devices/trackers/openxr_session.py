"""A session of the active OpenXR runtime that asks for hands or trackers and shows nothing.

Source: the OpenXR specification, https://registry.khronos.org/OpenXR/specs/1.1/html/xrspec.html
(session life cycle, ``XR_EXT_hand_tracking``, ``XR_MND_headless``), and the bindings of
https://github.com/cmbruns/pyopenxr, 1.1.
"""

from __future__ import annotations

import ctypes
import sys
import time
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.errors import MissingExtraError, SourceError, listed, reason
from smooth_operator.headsets.openxr_joints import JOINTS
from smooth_operator.teleop.sources.inboxes import Message
from smooth_operator.types import Side
from smooth_operator_devices.trackers.polled import PolledInbox

_EXTENSIONS: Final = (
    "XR_MND_headless",
    "XR_KHR_win32_convert_performance_counter_time"
    if sys.platform == "win32"
    else "XR_KHR_convert_timespec_time",
)
_JOINT: Final = np.dtype(
    [("flags", "<u8"), ("turn", "<f4", 4), ("place", "<f4", 3), ("radius", "<f4")]
)
"""XrHandJointLocationEXT; the quaternion is x y z w."""


class OpenXrInbox(PolledInbox):
    """Base of the sessions; a subclass asks for hands or trackers.

    Args:
        rate: number of times per second that the runtime is asked [Hz].

    Attributes:
        extension: extension of OpenXR that the subclass needs.
        missing: what the runtime lacks while nothing is tracked.

    Raises:
        MissingExtraError: pyopenxr is missing.
        SourceError: there is no runtime, or it can't track what is asked for.
    """

    extension: str
    missing: str

    def __init__(self, rate: float) -> None:
        super().__init__(rate)
        try:
            import xr
        except ModuleNotFoundError as error:
            raise MissingExtraError("the source 'openxr'", "openxr") from error
        self._xr: Any = xr
        self._instance: Any = None
        self._runs = False
        self.address = "the OpenXR runtime"
        self.problem = "the session has not begun; put the headset on, or wake it"
        try:
            self._open()
            self.begin()
        except xr.XrException as error:
            self.close()
            raise SourceError(self._refusal(error)) from error

    def _refusal(self, error: Exception) -> str:
        """Reason why there is no session, and what to do."""
        xr = self._xr
        if isinstance(error, xr.RuntimeUnavailableError):
            return (
                "no OpenXR runtime is active on this computer; start SteamVR, Monado or Virtual "
                "Desktop and make it the active runtime in its settings, or set XR_RUNTIME_JSON to "
                "its manifest"
            )
        if isinstance(error, xr.FormFactorUnavailableError):
            return f"{self.address} has no headset now; connect it"
        if isinstance(error, xr.FeatureUnsupportedError):
            return (
                f"{self.address} can't track hands with this headset; switch on hand tracking, or "
                "install the OpenXR layer of the gloves"
            )
        return f"{self.address} refused a session: {reason(error)}"

    def _open(self) -> None:
        xr = self._xr
        offered = {str(each) for each in xr.enumerate_instance_extension_properties()}
        extensions = (self.extension, *_EXTENSIONS)
        if missing := [name for name in extensions if name not in offered]:
            raise SourceError(
                f"the active OpenXR runtime lacks {listed(missing)}, which this source needs; "
                "Monado, SteamVR and Virtual Desktop have them"
            )
        info = xr.ApplicationInfo(application_name="smooth-operator")
        self._instance = xr.create_instance(
            xr.InstanceCreateInfo(application_info=info, enabled_extension_names=extensions)
        )
        name = xr.get_instance_properties(self._instance).runtime_name
        self.address = f"the OpenXR runtime {name.decode('utf-8', 'replace')}"
        system = xr.get_system(self._instance)
        self._session = xr.create_session(self._instance, xr.SessionCreateInfo(system_id=system))
        kinds, stage = xr.ReferenceSpaceType, xr.ReferenceSpaceType.STAGE
        kind = stage if stage in xr.enumerate_reference_spaces(self._session) else kinds.LOCAL
        self._space = xr.create_reference_space(
            self._session, xr.ReferenceSpaceCreateInfo(reference_space_type=kind)
        )

    @abstractmethod
    def begin(self) -> None:
        """Prepares the session, before it runs; errors are those of pyopenxr."""

    @abstractmethod
    def located(self, time: Any) -> list[Message]:
        """Messages of what is tracked at a time of the runtime."""

    def ask(self) -> list[Message]:
        """What is tracked now; see ``PolledInbox``."""
        try:
            self._follow_events()
            if not self._runs:
                return []
            messages = self.located(self._time())
        except self._xr.XrException as error:
            raise SourceError(f"{self.address} failed: {reason(error)}") from error
        self.problem = "" if messages else f"{self.address} {self.missing}"
        return messages

    def _follow_events(self) -> None:
        """Begins and ends the session as the runtime's events say."""
        xr, states = self._xr, self._xr.SessionState
        while True:
            try:
                event = xr.poll_event(self._instance)
            except xr.EventUnavailable:
                return
            if event.type != xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED:
                continue
            kind = ctypes.POINTER(xr.EventDataSessionStateChanged)
            state = ctypes.cast(ctypes.byref(event), kind).contents.state
            if state == states.READY:
                views = xr.ViewConfigurationType.PRIMARY_STEREO
                xr.begin_session(self._session, xr.SessionBeginInfo(views))
                self._runs = True
            elif state == states.STOPPING:
                xr.end_session(self._session)
                self._runs, self.problem = False, f"{self.address} has paused the session"
            elif state in (states.EXITING, states.LOSS_PENDING):
                raise SourceError(
                    f"{self.address} ended the session; start it again, then start this program "
                    "again"
                )

    def _time(self) -> Any:
        """The present, as the runtime counts time."""
        xr = self._xr
        if sys.platform == "win32":
            counter = ctypes.c_longlong()
            ctypes.windll.kernel32.QueryPerformanceCounter(ctypes.byref(counter))
            return xr.convert_win32_performance_counter_to_time_khr(self._instance, counter)
        now = xr.timespec(*divmod(time.clock_gettime_ns(time.CLOCK_MONOTONIC), 10**9))
        return xr.convert_timespec_time_to_time_khr(self._instance, now)

    def close(self) -> None:
        """Ends the session with all that belongs to it."""
        if self._instance is not None:
            self._xr.destroy_instance(self._instance)
            self._instance = None


class HandInbox(OpenXrInbox):
    """A session with hands; a message is the side and the 26 joints of a tracked hand.

    Args:
        sides: hands to ask for.
        rate: number of times per second that the runtime is asked [Hz].
    """

    extension = "XR_EXT_hand_tracking"
    missing = "tracks no hand now"

    def __init__(self, sides: Sequence[Side], rate: float) -> None:
        self._sides = sides
        super().__init__(rate)

    def begin(self) -> None:
        """Makes a tracker of each hand; see ``OpenXrInbox``."""
        xr = self._xr
        hands = {"left": xr.HandEXT.LEFT, "right": xr.HandEXT.RIGHT}
        self._trackers = {
            side: xr.create_hand_tracker_ext(
                self._session, xr.HandTrackerCreateInfoEXT(hand=hands[side])
            )
            for side in self._sides
        }
        # pyopenxr's own function passes no array of joints, which the specification demands.
        self._locate = ctypes.cast(
            xr.get_instance_proc_addr(self._instance, "xrLocateHandJointsEXT"),
            xr.PFN_xrLocateHandJointsEXT,
        )

    def located(self, time: Any) -> list[Message]:
        """Hands that are tracked; see ``OpenXrInbox``."""
        info = self._xr.HandJointsLocateInfoEXT(base_space=self._space, time=time)
        found = ((side, self._joints(tracker, info)) for side, tracker in self._trackers.items())
        return [(side, joints) for side, joints in found if joints is not None]

    def _joints(self, tracker: Any, info: Any) -> np.ndarray | None:
        """Joints of a hand; None while it is not tracked."""
        xr = self._xr
        joints = (xr.HandJointLocationEXT * JOINTS)()
        locations = xr.HandJointLocationsEXT(joint_locations=joints)
        result = self._locate(tracker, ctypes.byref(info), ctypes.byref(locations))
        if result < 0:
            raise SourceError(f"{self.address} can't locate a hand: {xr.Result(result).name}")
        return np.frombuffer(bytes(joints), _JOINT) if locations.is_active else None
