"""A finger that was straight follows the human's when that bends."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator import HandFrame, Retargeter, load_hand, method_config
from smooth_operator.objective.straight_fingers import StraightFingers
from smooth_operator.synthetic.robot_landmarks import human_landmarks


def test_fingers_are_found_where_a_joint_bends_them_past_straight() -> None:
    hand = load_hand("mimic_p050")
    fingers = StraightFingers(hand)
    assert [hand.fingers[f] for f, *_ in fingers.found] == ["index", "middle", "ring", "pinky"]
    assert [hand.actuated_names[joint] for _, joint, *_ in fingers.found] == [
        f"{name}_pp2mp" for name in ("index", "middle", "ring", "pinky")
    ]
    for (f, joint, longest, length), centre in zip(fingers.found, fingers.centres, strict=True):
        for lengths, position in ((length, 0.0), (None, longest)):
            q = np.array(hand.neutral)
            q[joint] = position
            at = np.linalg.norm(hand.tips(hand.full_configuration(q))[f] - hand.wrist - centre)
            assert at == pytest.approx(length, abs=1e-6) if lengths else at > length + 1e-3
    for name in ("inspire_hand", "shadow_hand", "allegro_hand"):  # longest at the limit
        hand = load_hand(name)
        tips = hand.tips(hand.full_configuration(hand.neutral)) - hand.wrist
        assert StraightFingers(hand).limits(hand.limits, tips) is hand.limits


def test_only_a_fingertip_nearer_than_the_finger_at_its_limit_moves_the_limit() -> None:
    hand = load_hand("mimic_p050")
    fingers = StraightFingers(hand)
    tips = hand.tips(hand.full_configuration(hand.neutral)) - hand.wrist
    f, joint, longest, length = fingers.found[1]
    for away, low in ((length + 5e-4, 0.0), (length - 5e-4, 0.0), (length - 2e-3, longest)):
        tips[f] = fingers.centres[1] + [0.0, 0.0, away]
        found = np.asarray(fingers.limits(hand.limits, tips))
        assert found[joint, 0] == pytest.approx(low)
        others = np.arange(len(found)) != joint
        assert (found[others, 1] == hand.limits[others, 1].astype(np.float32)).all()


def test_a_finger_stretched_too_far_is_not_left_straight() -> None:
    hand = load_hand("mimic_p050")
    bent, stretched = np.array(hand.neutral), np.array(hand.neutral)
    middle = [hand.actuated_names.index(f"middle_{part}") for part in ("mcp2pp", "pp2mp")]
    bent[middle], stretched[middle] = (0.3, 0.8), (0.3, 0.2)
    share = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 60))[:, None]
    frames = human_landmarks(hand, stretched + share * (bent - stretched))
    longer = frames.copy()  # as with longer bones: out of reach while the finger is straight
    base, tips = longer[:, 9:10], slice(10, 13)
    longer[:, tips] = base + 1.03 * (longer[:, tips] - base)
    config = method_config("smooth")
    retargeter = Retargeter(hand, config=replace(config, settle_rounds=2))
    state = retargeter.init(seed=0)
    for points, stamp in zip(longer, 0.02 * np.arange(60), strict=True):
        state, result = retargeter.step(state, HandFrame(points, stamp, hand.spec.side))
    q = result.command.positions
    asked = longer[-1, 12] - longer[-1, 0]
    reached = hand.tips(q)[hand.fingers.index("middle")] - hand.wrist
    assert np.linalg.norm(reached - asked) < 2e-3
