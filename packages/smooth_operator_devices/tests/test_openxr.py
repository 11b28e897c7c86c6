"""The source ``openxr`` with the real loader and a runtime in C, written from the specification."""

import ctypes
from collections.abc import Iterator
from typing import Any

import headset_apps as app
import numpy as np
import pytest
from live_time import until
from openxr_runtime import HANDS, NEEDS_COMPILER, POSES, check_frame, joints, loaded
from tracker_session import started

from smooth_operator.errors import SourceError
from smooth_operator.poses import separation
from smooth_operator_devices.trackers.openxr import OpenXrSource

xr = pytest.importorskip("xr", reason="the extra 'openxr' is not installed")
pytestmark = NEEDS_COMPILER

ALL, HEADLESS, TRACKING, TRACKERS = 7, 2, 1, 128
STOPPING, LOSS_PENDING, READY = 6, 7, 2


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The runtime as the loader uses it, with all extensions and no hand."""
    yield loaded(monkeypatch, ALL)
    xr.destroy_instance(xr.create_instance())  # or the loader remembers the extensions


def test_a_session_gives_both_hands_in_the_conventions_of_the_project(runtime):
    with started("openxr:rate=200") as (source, mailbox):
        assert source.health().state == "waiting"
        until(lambda: "put the headset on" in source.health().detail)
        assert mailbox.received == 0
        runtime.change_state(READY)
        until(runtime.is_running)
        until(lambda: "of the tests tracks no hand now" in source.health().detail)
        for side, hand in HANDS.items():
            runtime.show_hand(hand, 1, joints(side))
        until(lambda: mailbox.received_of["left"] and mailbox.received_of["right"])
        for arrival in mailbox.all:
            check_frame(arrival.frame, "openxr")
            assert arrival.stamp == arrival.received
        assert runtime.last_time() > 0
        assert "of the tests" in source.endpoint
    assert runtime.open_instances() == 0


def test_a_lost_hand_gives_no_frames_and_comes_back(runtime):
    with started("openxr:rate=500,side=right") as (source, mailbox):
        runtime.change_state(READY)
        runtime.show_hand(2, 1, joints("right"))
        until(lambda: mailbox.received == 1)
        time_then = runtime.last_time()
        until(lambda: runtime.last_time() > time_then + 50_000_000)
        assert mailbox.received == 1  # the runtime repeats the last joints
        runtime.show_hand(2, 0, joints("right", 0.01))
        until(lambda: "tracks no hand now" in source.health().detail)
        assert mailbox.received == 1
        runtime.show_hand(2, 1, joints("right", 0.02))
        until(lambda: mailbox.received == 2)
        assert source.health().state == "running"
        assert mailbox.received_of["left"] == 0


def test_flags_say_which_joints_are_valid(runtime):
    flags = [15] * 26
    flags[10] = 0  # the index tip
    flags[1] = 2  # a wrist without orientation
    with started("openxr:side=left") as (_, mailbox):
        runtime.change_state(READY)
        runtime.show_hand(1, 1, joints("left", flags=flags))
        until(lambda: mailbox.received == 1)
        frame = mailbox.all[0].frame
        assert frame.valid.tolist() == [k != 8 for k in range(21)]
        assert np.isnan(frame.T_world_wrist).all()


def test_a_joint_that_is_not_finite_is_not_valid(runtime):
    array = joints("right")
    array[5].position[1] = float("nan")  # the thumb tip
    with started("openxr") as (_, mailbox):
        runtime.change_state(READY)
        runtime.show_hand(2, 1, array)
        until(lambda: mailbox.received == 1)
        assert mailbox.all[0].frame.valid.tolist() == [k != 4 for k in range(21)]


def test_the_session_pauses_while_the_headset_sleeps(runtime):
    with started("openxr:side=right") as (source, mailbox):
        runtime.change_state(READY)
        runtime.show_hand(2, 1, joints("right"))
        until(lambda: mailbox.received == 1)
        runtime.change_state(STOPPING)
        until(lambda: "has paused the session" in source.health().detail)
        assert not runtime.is_running()
        runtime.change_state(READY)
        runtime.show_hand(2, 1, joints("right", 0.01))
        until(lambda: mailbox.received == 2)


def test_trackers_give_the_poses_of_their_roles(runtime):
    runtime.offer(ALL - TRACKING + TRACKERS, 1, 1, 1)

    def show(role: str, flags: int, pose: Any) -> None:
        values = (*app.openxr_turn(pose[3:]), *app.openxr_point(pose[:3]))
        runtime.show_tracker(role.encode(), flags, (ctypes.c_float * 7)(*values))

    with started("openxr:rate=500,track=trackers,left=handheld_object") as (source, mailbox):
        runtime.change_state(READY)
        until(lambda: "does not track any tracker with the role" in source.health().detail)
        show("right_wrist", 15, POSES["right"])
        show("handheld_object", 3, POSES["left"])  # valid, but a guess
        until(lambda: mailbox.received == 1)
        frame = mailbox.all[0].frame
        assert (frame.side, frame.world, frame.valid.any()) == ("right", "openxr", False)
        assert (separation(frame.T_world_wrist, np.array(POSES["right"])) < 1e-5).all()
        show("handheld_object", 15, POSES["left"])
        until(lambda: mailbox.received_of["left"] == 1)
        show("right_wrist", 0, POSES["right"])
        show("handheld_object", 0, POSES["left"])
        until(lambda: "role right_wrist or handheld_object now" in source.health().detail)
    assert runtime.open_instances() == 0


def test_a_runtime_that_ends_the_session_is_a_failure(runtime):
    with started("openxr") as (source, _):
        runtime.change_state(LOSS_PENDING)
        until(lambda: source.health().state == "failed")
        assert (
            "ended the session; start it again, then start this program again"
            in source.health().detail
        )
    assert runtime.open_instances() == 0


@pytest.mark.parametrize(
    ("offers", "words"),
    [
        ((ALL - HEADLESS, 1, 1, 1), "lacks XR_MND_headless, which this source needs"),
        ((ALL - TRACKING + TRACKERS, 1, 1, 1), "lacks XR_EXT_hand_tracking"),
        ((ALL, 1, 0, 1), "of the tests has no headset now; connect it"),
        ((ALL, 1, 1, 0), "of the tests can't track hands with this headset"),
    ],
)
def test_a_runtime_that_can_t_track_hands_is_refused_at_the_start(runtime, offers, words):
    runtime.offer(*offers)
    with pytest.raises(SourceError, match=words):
        OpenXrSource().connect()
    assert runtime.open_instances() == 0


def test_a_runtime_without_trackers_is_refused(runtime):
    with pytest.raises(SourceError, match="lacks XR_HTCX_vive_tracker_interaction, which"):
        OpenXrSource(track="trackers").connect()


def test_without_a_stage_the_local_space_is_used(runtime):
    runtime.offer(ALL, 0, 1, 1)
    OpenXrSource().connect().close()
    assert runtime.open_instances() == 0


def test_without_a_runtime_the_error_says_what_to_start(monkeypatch, tmp_path):
    monkeypatch.setenv("XR_RUNTIME_JSON", str(tmp_path / "no.json"))
    monkeypatch.setenv("XR_LOADER_DEBUG", "none")
    with pytest.raises(SourceError, match=r"no OpenXR runtime is active.*start SteamVR, Monado"):
        OpenXrSource().connect()
