"""The source ``isaac``: a real session of Isaac Teleop, over the OpenXR runtime of the tests."""

from collections.abc import Iterator
from typing import Any

import pytest
from live_time import until
from openxr_runtime import HANDS, NEEDS_COMPILER, check_frame, joints, loaded
from tracker_session import started

from smooth_operator.errors import SourceError
from smooth_operator_devices.trackers.isaac_hands import IsaacHands

pytest.importorskip("isaacteleop", reason="isaacteleop is not installed: the extra isaac, on Linux")
pytestmark = NEEDS_COMPILER
ALL = 127


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A runtime with the extensions that Isaac Teleop asks for, ready at once, and no hand."""
    monkeypatch.setenv("ISAAC_TELEOP_DISABLE_CXR_ENV_CHECKS", "1")
    return loaded(monkeypatch, ALL, ready=True)


def test_a_session_gives_both_hands_in_the_conventions_of_the_project(runtime):
    with started("isaac:rate=200") as (source, mailbox):
        until(lambda: "tracks no hand now" in source.health().detail)
        for side, hand in HANDS.items():
            runtime.show_hand(hand, 1, joints(side))
        until(lambda: mailbox.received_of["left"] and mailbox.received_of["right"])
        for arrival in mailbox.all:
            check_frame(arrival.frame, "isaac")
        count = mailbox.received
        for side, hand in HANDS.items():
            runtime.show_hand(hand, 0, joints(side, 0.01))
        until(lambda: "tracks no hand now" in source.health().detail)
        assert mailbox.received == count
        runtime.show_hand(2, 1, joints("right", 0.02))
        until(lambda: mailbox.received == count + 1)
    assert runtime.open_instances() == 0


def test_a_joint_without_a_valid_pose_is_not_valid(runtime):
    flags = [15] * 26
    flags[10] = 0  # the index tip
    with started("isaac:side=left") as (_, mailbox):
        runtime.show_hand(1, 1, joints("left", flags=flags))
        runtime.show_hand(2, 1, joints("right"))
        until(lambda: mailbox.received)
        assert mailbox.all[0].frame.valid.tolist() == [k != 8 for k in range(21)]
        assert mailbox.received_of["right"] == 0


def test_without_its_runtime_the_error_says_what_to_start(monkeypatch):
    monkeypatch.delenv("NV_CXR_RUNTIME_DIR", raising=False)
    with pytest.raises(SourceError, match=r"can't start a session.*isaacteleop\.cloudxr\.service"):
        IsaacHands().connect()
