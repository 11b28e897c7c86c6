"""``smooth`` takes the shape of an operator whose fingers are not the robot's."""

import numpy as np
import pytest

from smooth_operator import Hand, Retargeter, assemble_trace, evaluate, hand_names, load_hand
from smooth_operator.landmarks import TIPS
from smooth_operator.retargeting.program import FrameState, RetargetState
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import CommandTrajectory, HandFrame, HandRecording, Status


@pytest.fixture(scope="module")
def smooth(hand) -> Retargeter:
    return Retargeter(hand, method="smooth")


@pytest.fixture(scope="module")
def operator() -> HandRecording:
    """4 s of the built-in operator, who opens, closes and pinches."""
    return SyntheticOperator(seed=1, rate_hz=60.0).record(4.0)


@pytest.fixture(scope="module")
def answer(smooth, operator) -> CommandTrajectory:
    return smooth.run(operator)[0]


def test_open_and_closed_as_the_human(hand, operator, answer):
    old = Retargeter(hand, method="smooth", preset="precise").run(operator)[0]
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


SLOW = {
    "brainco_revo2",
    "fourier_hand",
    "inspire_ftp",
    "inspire_hand",
    "inspire_rh56f1",
    "leap_hand",
    "leap_v2_advanced",
    "rohand",
    "schunk_svh",
    "shadow_hand",
    "unitree_dex3",
}
"""Hands that are still 3 to 10 mm apart a second after the fault, and agree half a second later."""

STUCK = {"orca_v1", "shadow_dexee"}
"""Hands that keep another pose, 15 mm apart, until the human moves on."""

EVERY_HAND = [
    pytest.param(
        name,
        marks=[
            *([] if name == "mimic_p050" else [pytest.mark.weekly]),
            *([pytest.mark.xfail(strict=True, reason="it stays 15 mm apart")] * (name in STUCK)),
        ],
    )
    for name in hand_names()
]


@pytest.mark.parametrize("name", EVERY_HAND)
def test_a_fault_is_forgotten_within_a_second(name, operator):
    faulty = operator.landmarks.copy()
    faulty[60] *= (-1, 1, 1)  # a tracker that takes the hand for the other one
    faulty[61, TIPS[1]] += 0.04
    mirrored = HandRecording(faulty, operator.stamps, "right")
    hand = load_hand(name)
    smooth = Retargeter(hand, method="smooth")
    recordings = (operator, mirrored, operator[60:])
    answer, after_fault, begun_later = (smooth.run(each)[0] for each in recordings)
    later = 150 if name in SLOW else 125
    assert tips_apart(hand, after_fault, answer)[later:].max() < 3e-3
    tips = [hand.tips(c.joint_positions) for c in (begun_later, answer)]
    apart = np.linalg.norm(tips[0] - tips[1][60:], axis=-1).mean(axis=1)
    assert np.median(apart[60:]) < 3e-3
    assert apart[100:].max() < 3e-3  # a fast step of LEAP's middle finger still differs at 1.5 s


def test_a_finger_in_a_wrong_basin_finds_back(operator):
    """LEAP's folded fingers with the side joint at its limit: 0.1 m from their places, and no step
    leads out."""
    hand = load_hand("leap_hand")
    leap = Retargeter(hand, method="smooth")
    state = leap.init()
    for frame in operator[:30]:
        state, _ = leap.step(state, frame)
    trees = state.trees
    q = np.array(trees.method.q)
    for middle in (4, 8):
        q[middle : middle + 4] = (-0.31, -1.05, 1.6, 1.8)
    reach = (hand.tips(hand.full_configuration(q)) - hand.wrist).astype(np.float32)
    method = trees.method._replace(q=q, reach=reach)
    state = RetargetState.of(FrameState(method, q))
    positions = []
    for i in range(60):
        still = HandFrame(operator.landmarks[29], float(operator.stamps[30 + i]), "right")
        state, result = leap.step(state, still)
        positions.append(result.command.joint_positions)
    start, target = hand.tips(hand.full_configuration(np.stack([q, trees.method.q])))
    assert np.linalg.norm(start - target, axis=-1).max() > 0.05
    end = hand.tips(np.array(positions[-1:]))[0]
    assert np.linalg.norm(end - target, axis=-1).max() < 0.01


def test_a_gap_measures_the_operator_again(hand, smooth, operator, answer):
    valid = np.ones((len(operator), 21), bool)
    valid[60:90] = False
    lossy = HandRecording(operator.landmarks, operator.stamps, "right", valid=valid)
    commands = smooth.run(lossy)[0]
    assert (commands.status[60:90] == Status.INVALID_LANDMARKS).all()
    held = commands.joint_positions[60:90]
    np.testing.assert_array_equal(held, np.tile(commands.joint_positions[59], (30, 1)))
    assert tips_apart(hand, commands, answer)[180:].max() < 4e-3


def test_the_size_of_the_operator_makes_no_difference(hand, smooth, operator, answer):
    small = HandRecording(0.85 * operator.landmarks, operator.stamps, "right")
    assert tips_apart(hand, smooth.run(small)[0], answer).mean() < 1e-3
