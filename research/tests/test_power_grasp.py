"""Grasps with the whole hand in recordings, on objects in physics."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator import HandRecording, load_hand, method_config
from smooth_operator.errors import RecordingError
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.physics.grasp_measures import (
    GraspResult,
    PowerGrasp,
    RobotGrasp,
    try_power_grasp,
)
from smooth_operator_research.physics.grasp_physics import POWER_GRASP_OBJECTS, PowerGraspPhysics
from smooth_operator_research.physics.human_grasps import find_closings, finger_straightness
from smooth_operator_research.physics.measure import Case, PhysicsSettings, Unit
from smooth_operator_research.physics.suite import find_measure

pytestmark = pytest.mark.weekly

HANDLE = next(one for one in POWER_GRASP_OBJECTS if one.name == "handle 50")


@pytest.fixture(scope="module")
def recording() -> HandRecording:
    return SyntheticOperator(seed=3, gestures=("open_close", "pinch_index")).record(4.6)


def test_a_fist_is_found_and_a_pinch_is_not(recording):
    (closing,) = find_closings(recording)
    straight = finger_straightness(recording)
    assert closing.first < closing.tight < closing.shut <= closing.opened <= closing.last
    assert straight[closing.tight].max() < 0.65
    assert straight[closing.opened].min() > 0.85
    assert straight[closing.shut].mean() == pytest.approx(
        straight[closing.tight].mean() + 0.1, abs=0.05
    )
    (cut,) = find_closings(recording[: closing.tight + 20])
    assert (cut.opened, cut.last) == (None, closing.tight + 19)
    known = recording.valid.copy()
    known[:, 8] = False  # nobody knows whether the index is bent
    assert find_closings(replace(recording, valid=known)) == []


def grasped(*, share: float = 1.0, early: bool = False, friction: float = 1.0) -> GraspResult:
    """Mimic's fingers close on a handle in 0.4 s, rest, and open in 0.15 s.

    Args:
        share: of the way to the fist.
        early: the robot opens in the middle of the rest.
        friction: of the object, a factor.
    """
    hand = load_hand("mimic_p050")
    fist = hand.limits[:, 1].copy()
    wide = np.array(hand.neutral)
    thumb = [name.startswith("right_t") for name in hand.actuated_names]
    fist[thumb] = wide[thumb]
    stamps = np.arange(0.0, 3.0, 0.01)
    rest = 0.9 if early else 1.7
    closed = share * np.interp(stamps, [0.0, 0.4, rest, rest + 0.15], [0.0, 1.0, 1.0, 0.0])
    commands = hand.full_configuration(wide + closed[:, None] * (fist - wide))
    physics = PowerGraspPhysics(hand, HANDLE)
    physics._built.model.geom_friction[:, 0] *= friction
    grasp = RobotGrasp(stamps=stamps, commands=commands, tight=0.4, shut=1.7, opened=1.75)
    return try_power_grasp(physics, grasp)


def test_a_fist_holds_a_handle_and_lets_go():
    result = grasped()
    assert (result.held, result.dropped, result.let_go) == (True, False, True)
    assert 1.0 < result.force < 100.0


def test_an_open_hand_holds_nothing_and_an_early_one_drops():
    open_hand = grasped(share=0.1)
    assert (open_hand.held, open_hand.dropped, open_hand.let_go) == (False, False, None)
    early = grasped(early=True)
    assert (early.held, early.dropped) == (False, True)


def test_the_object_lies_in_the_palm_and_touches_nothing():
    hand = load_hand("mimic_p050")
    for thing in POWER_GRASP_OBJECTS[1:3]:
        physics = PowerGraspPhysics(hand, thing)
        physics.begin(hand.full_configuration(hand.neutral))
        depth = physics.appear()
        assert thing.width / 2 - 0.01 < depth < 0.09
        at = physics.position
        assert physics.grip == 0.0
        physics.advance(0.1)
        assert np.linalg.norm(physics.position - at) < 1e-6  # somebody holds it


def test_the_measure_counts_what_was_tried(recording):
    measure = find_measure("grasp")
    case = Case(
        "grasp",
        "mimic_p050",
        "right",
        "keyvector",
        "published",
        method_config("keyvector"),
        "",
        Unit("one fist", data=recording),
        quick=True,
    )
    row = measure.run(case).row
    assert row == measure.run(case).row  # deterministic
    assert (row["closings"], row["tried"], row["diverged"]) == (1, 1, 0)
    assert row["held"] == row["held_handle_30"]


def test_a_recording_without_a_closed_hand_is_refused():
    with pytest.raises(RecordingError, match="the hand never closes"):
        PowerGrasp().units(PhysicsSettings(output=None, recordings=("synthetic@:30",)))
