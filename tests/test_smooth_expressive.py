"""``smooth:expressive``: the shape of an operator whose fingers are not the robot's."""

from __future__ import annotations

import numpy as np
import pytest

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import AlignmentConfig, align_recording
from smooth_operator.landmarks import TIPS
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.metrics.evaluation import evaluate
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import CommandTrajectory, HandFrame, HandRecording, Status


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand()


@pytest.fixture(scope="module")
def expressive(hand: Hand) -> Retargeter:
    return Retargeter(hand, method="smooth", preset="expressive")


@pytest.fixture(scope="module")
def operator() -> HandRecording:
    """4 s of the built-in operator, who opens, closes and pinches."""
    return SyntheticOperator(seed=1, rate_hz=60.0).record(4.0)


@pytest.fixture(scope="module")
def answer(expressive: Retargeter, operator: HandRecording) -> CommandTrajectory:
    return expressive.run(operator)[0]


def test_open_and_closed_as_the_human(
    hand: Hand, operator: HandRecording, answer: CommandTrajectory
) -> None:
    old = Retargeter(hand, method="smooth", preset="teleop").run(operator)[0]
    new, before = (
        evaluate(assemble_trace(operator, commands, hand, reach_samples=0))
        for commands in (answer, old)
    )
    assert new["finger_extension_error"] < 0.7 * before["finger_extension_error"]
    assert new["curl_error_deg"] < 0.85 * before["curl_error_deg"]
    assert new["motion_preservation"] > 0.85


def tips_apart(hand: Hand, one: CommandTrajectory, other: CommandTrajectory) -> np.ndarray:
    """(T,) mean distance of the fingertips [m]."""
    tips = [hand.tips(commands.joint_positions) for commands in (one, other)]
    return np.linalg.norm(tips[0] - tips[1], axis=-1).mean(axis=1)


def test_a_fault_is_forgotten(
    hand: Hand, expressive: Retargeter, operator: HandRecording, answer: CommandTrajectory
) -> None:
    faulty = operator.landmarks.copy()
    faulty[60] *= (-1, 1, 1)  # a tracker that takes the hand for the other one
    faulty[61, TIPS[1]] += 0.04
    mirrored = HandRecording(faulty, operator.stamps, "right")
    apart = tips_apart(hand, expressive.run(mirrored)[0], answer)
    assert apart[125:].max() < 3e-3


def test_a_gap_measures_the_operator_again(
    hand: Hand, expressive: Retargeter, operator: HandRecording, answer: CommandTrajectory
) -> None:
    valid = np.ones((len(operator), 21), bool)
    valid[60:90] = False
    lossy = HandRecording(operator.landmarks, operator.stamps, "right", valid=valid)
    commands = expressive.run(lossy)[0]
    assert (commands.status[60:90] == Status.INVALID_LANDMARKS).all()
    held = commands.joint_positions[60:90]
    np.testing.assert_array_equal(held, np.tile(commands.joint_positions[59], (30, 1)))
    assert tips_apart(hand, commands, answer)[180:].max() < 4e-3


def test_the_size_of_the_operator_makes_no_difference(
    hand: Hand, expressive: Retargeter, operator: HandRecording, answer: CommandTrajectory
) -> None:
    small = HandRecording(0.85 * operator.landmarks, operator.stamps, "right")
    assert tips_apart(hand, expressive.run(small)[0], answer).mean() < 1e-3


def test_a_left_hand_mirrors_the_right(operator: HandRecording, answer: CommandTrajectory) -> None:
    left = Retargeter("mimic_p050", side="left", method="smooth", preset="expressive")
    mirrored = HandRecording(operator.landmarks * (-1, 1, 1), operator.stamps, "left")
    commands = left.run(mirrored)[0]
    np.testing.assert_allclose(commands.joint_positions, answer.joint_positions, atol=3e-3)


def test_the_fingertips_are_near_their_targets_on_either_side(
    hand: Hand, expressive: Retargeter, operator: HandRecording
) -> None:
    """The left hand is described as the mirror image: its targets are those of the right, too."""
    assert expressive.fingertip_targets(expressive.init()) is None
    assert Retargeter(hand, method="sbr").fingertip_targets() is None
    left = Retargeter("mimic_p050", side="left", method="smooth", preset="expressive")
    states = expressive.init(), left.init()
    gaps, human_gaps = [], []
    human = align_recording(operator, hand, AlignmentConfig())
    for i in range(0, len(operator), 2):
        frame = operator[i]
        mirrored = HandFrame(frame.landmarks * [-1, 1, 1], frame.stamp, "left")
        (one, right), (other, _) = (
            retargeter.step(state, shown)
            for retargeter, state, shown in zip(
                (expressive, left), states, (frame, mirrored), strict=True
            )
        )
        states = one, other
        targets = expressive.fingertip_targets(one)
        assert targets is not None
        np.testing.assert_allclose(left.fingertip_targets(other), targets * [-1, 1, 1], atol=1e-6)
        tips = hand.tips(right.command.positions)
        gaps.append(np.linalg.norm(tips - targets, axis=1).mean())
        human_gaps.append(np.linalg.norm(tips - human[i, list(TIPS)], axis=1).mean())
    assert np.mean(gaps) < 0.008  # [m]
    assert np.mean(gaps) < 0.5 * np.mean(human_gaps)  # where the human's are drawn
