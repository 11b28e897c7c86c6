"""A command: ``smooth-operator joint-ranges HAND``."""

from dataclasses import dataclass

from tyro.conf import Positional

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class JointRanges(Common):
    """Print how far each joint of a hand moves [rad]."""

    work = "toy_retargeting.joint_ranges:print_ranges"
    details = "Example:\n  smooth-operator joint-ranges toy_gripper"

    hand: Positional[str] = "toy_gripper"
    """Robot hand."""


def print_ranges(options):
    from smooth_operator import load_hand  # here: --help needs no robot hand

    hand = load_hand(options.hand)
    for name, (low, high) in zip(hand.joint_names, hand.joint_limits, strict=True):
        print(f"{name} {high - low:.3f}")
