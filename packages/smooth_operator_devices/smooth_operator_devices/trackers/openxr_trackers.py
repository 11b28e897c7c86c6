"""Poses of Vive trackers from the active OpenXR runtime, by their roles.

Source: ``XR_HTCX_vive_tracker_interaction`` (revision 3, with the roles of the wrists), actions and
``xrLocateSpace`` of the OpenXR specification,
https://registry.khronos.org/OpenXR/specs/1.1/html/xrspec.html
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.teleop.sources.inboxes import Message
from smooth_operator.types import Side
from smooth_operator_devices.trackers.openxr_session import OpenXrInbox

_PROFILE: Final = "/interaction_profiles/htc/vive_tracker_htcx"
_ROLES: Final = "/user/vive_tracker_htcx/role/"
_TRACKED: Final = 15
"""All bits of XrSpaceLocationFlags: without the tracked ones a pose is the last one, or a guess."""


class TrackerInbox(OpenXrInbox):
    """A session with trackers; a message is the side and the pose of one, x y z [m] and quaternion
    x y z w.

    Args:
        roles: side -> role of its tracker.
        rate: number of times per second that the runtime is asked [Hz].
    """

    extension = "XR_HTCX_vive_tracker_interaction"

    def __init__(self, roles: Mapping[Side, str], rate: float) -> None:
        self._roles = roles
        self.missing = (
            f"does not track any tracker with the role {' or '.join(roles.values())} now; switch "
            "it on, and give it this role in the runtime's settings (SteamVR: Manage Trackers)"
        )
        super().__init__(rate)

    def begin(self) -> None:
        """Makes an action with the pose of each tracker; see ``OpenXrInbox``."""
        xr, instance = self._xr, self._instance
        paths = {
            side: xr.string_to_path(instance, f"{_ROLES}{role}")
            for side, role in self._roles.items()
        }
        actions = xr.create_action_set(
            instance, xr.ActionSetCreateInfo("trackers", "Poses of trackers")
        )
        action = xr.create_action(
            actions,
            xr.ActionCreateInfo(
                action_name="pose",
                action_type=xr.ActionType.POSE_INPUT,
                subaction_paths=list(paths.values()),
                localized_action_name="Pose of a tracker",
            ),
        )
        bindings = [
            xr.ActionSuggestedBinding(
                action, xr.string_to_path(instance, f"{_ROLES}{role}/input/grip/pose")
            )
            for role in self._roles.values()
        ]
        xr.suggest_interaction_profile_bindings(
            instance,
            xr.InteractionProfileSuggestedBinding(
                interaction_profile=xr.string_to_path(instance, _PROFILE),
                suggested_bindings=bindings,
            ),
        )
        xr.attach_session_action_sets(
            self._session, xr.SessionActionSetsAttachInfo(action_sets=[actions])
        )
        self._sync = xr.ActionsSyncInfo(active_action_sets=[xr.ActiveActionSet(actions)])
        self._spaces = {
            side: xr.create_action_space(
                self._session, xr.ActionSpaceCreateInfo(action=action, subaction_path=path)
            )
            for side, path in paths.items()
        }

    def located(self, time: Any) -> list[Message]:
        """Poses of the trackers that are tracked; see ``OpenXrInbox``."""
        xr = self._xr
        xr.sync_actions(self._session, self._sync)
        messages: list[Message] = []
        for side, space in self._spaces.items():
            location = xr.locate_space(space, self._space, time)
            if int(location.location_flags) & _TRACKED == _TRACKED:
                place, turn = location.pose.position, location.pose.orientation
                messages.append((side, (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)))
        return messages
