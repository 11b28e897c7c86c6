"""One human demonstration on every hand: the human, its recording, and the replay in physics."""

import numpy as np
import pytest

from smooth_operator import Retargeter, poses
from smooth_operator.errors import UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import TIPS
from smooth_operator.simulation.scenes.table_scene import TOP
from smooth_operator_research.cross_hand.human import HAND_LENGTH, grip, record
from smooth_operator_research.cross_hand.plans import PLANS
from smooth_operator_research.cross_hand.replay import grip_of, replay, wrist_path
from smooth_operator_research.cross_hand.scenes import SCALED, scene_of


@pytest.mark.parametrize("tracker", ["glove", "headset", "camera"])
def test_a_human_is_recorded_as_its_tracker_sees_it(tracker):
    demonstration = record("relocate", 3, tracker)
    count = len(demonstration.times)
    rate = (count - 1) / np.ptp(demonstration.times)
    assert rate == pytest.approx({"glove": 96, "headset": 30, "camera": 30}[tracker], rel=0.02)
    assert demonstration.landmarks.shape == (count, 21, 3)
    assert demonstration.wrist.shape == (count, 7)
    np.testing.assert_array_equal(demonstration.recording.stamps, demonstration.times)
    bones = np.linalg.norm(np.diff(demonstration.landmarks[:, [0, 9, 10, 11, 12]], axis=1), axis=-1)
    assert bones.sum(axis=1).max() == pytest.approx(HAND_LENGTH, rel=0.05)


def test_the_same_world_gives_the_same_recording_and_another_one_another():
    first, again, other = (record("relocate", world, "headset") for world in (5, 5, 6))
    np.testing.assert_array_equal(first.landmarks, again.landmarks)
    np.testing.assert_array_equal(first.wrist, again.wrist)
    assert first.variation.mass != other.variation.mass


@pytest.mark.parametrize("task", list(PLANS))
def test_the_human_moves_without_jumps_and_each_world_has_another_person(task):
    first, second = (record(task, world, "glove") for world in (0, 3))
    for demonstration in (first, second):
        steps = np.diff(demonstration.landmarks[:, list(TIPS)], axis=0)
        speeds = np.linalg.norm(steps, axis=-1) / np.diff(demonstration.times)[:, None]
        assert speeds.max() < 0.5  # [m/s]
    bones = [
        np.linalg.norm(one.landmarks[:, 6] - one.landmarks[:, 5], axis=-1).mean()
        for one in (first, second)
    ]
    assert abs(bones[0] - bones[1]) > 0.0003


@pytest.mark.parametrize("task", list(PLANS))
def test_the_human_reaches_around_the_object_and_squeezes(task):
    demonstration = record(task, 1, "glove")
    gaps = np.array([grip(one)[1] for one in demonstration.landmarks])
    at_touch = gaps[np.searchsorted(demonstration.times, demonstration.touch)]
    opening = 0.0 if task == "hammer" else 0.03  # a fist begins to close at the handle
    assert gaps.max() >= at_touch + opening
    assert gaps.min() < at_touch - 0.02
    thumb = demonstration.landmarks[:, TIPS[0]]
    assert np.linalg.norm(thumb - thumb[0], axis=-1).max() > 0.02


def test_a_task_without_a_plan_is_refused():
    with pytest.raises(UnknownNameError, match="relocate"):
        record("card", 0)


@pytest.mark.parametrize("task", ["relocate", f"relocate{SCALED}"])
def test_the_robots_grip_takes_the_place_of_the_humans(task):
    hand, demonstration = load_hand("leap_hand"), record("relocate", 2)
    scene = demonstration.variation.scene(scene_of(task, hand))
    joints = np.tile(hand.full_configuration(hand.neutral), (len(demonstration.times), 1))
    index = np.searchsorted(demonstration.times, demonstration.touch)
    pose = wrist_path(hand, demonstration, joints, scene)[index]
    robot = pose[:3] + poses.rotate(pose[3:], grip_of(hand, joints[index]))
    human = poses.compose(np.concatenate(scene.start), demonstration.wrist[index])
    centre = human[:3] + poses.rotate(human[3:], demonstration.centre)
    start = scene.start[0]
    np.testing.assert_allclose(robot, start + scene.scale * (centre - start), atol=1e-9)
    np.testing.assert_allclose(pose[3:], human[3:], atol=1e-9)


def test_a_robot_hand_relocates_what_a_human_relocated_and_not_with_a_still_hand():
    retargeter = Retargeter("mimic_p050", method="smooth")
    demonstration = record("relocate", 3, "headset")
    joints = np.asarray(retargeter.run(demonstration.recording)[0].joint_positions)
    assert replay(retargeter.hand, demonstration, joints).score == 1.0
    still = np.tile(joints[:1], (len(joints), 1))
    assert replay(retargeter.hand, demonstration, still).score == 0.0


@pytest.mark.parametrize("task", list(PLANS))
def test_a_scaled_scene_has_the_size_of_the_robot_hand(task):
    hand = load_hand("leap_hand")
    scene, nominal = scene_of(f"{task}{SCALED}", hand), scene_of(task, hand)
    assert scene.scale == pytest.approx(1.25, abs=0.02)
    for scaled, own in (
        (scene.target, nominal.target),
        (scene.varied(0, np.ones(3)).target, nominal.varied(0, np.ones(3)).target),
    ):
        np.testing.assert_allclose(scaled - (0, 0, TOP), scene.scale * (own - (0, 0, TOP)))


@pytest.mark.weekly
@pytest.mark.parametrize("task", ["hammer", "tongs"])
def test_a_robot_hand_works_with_the_tool_of_the_human(task):
    retargeter = Retargeter("mimic_p050", method="smooth")
    demonstration = record(task, 1000, "glove")
    joints = np.asarray(retargeter.run(demonstration.recording)[0].joint_positions)
    assert replay(retargeter.hand, demonstration, joints).score == 1.0
