"""Results of checks on a hand, and the random poses that several checks share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.types import Side

Verdict: TypeAlias = Literal["ok", "warning", "failed", "unjudged", "skipped"]
"""Verdict of a check. ``unjudged``: there are figures, but no bound applies to them. ``skipped``:
nothing was measured, and ``Check.measured`` gives the reason."""


@dataclass(frozen=True)
class Check:
    """One line of the checklist that ``hands check`` prints.

    Attributes:
        name: name of the check.
        verdict: verdict of the check.
        measured: the measurement as text.
        advice: advice to the user; empty if nothing is wrong.
        figures: the measurement as plain numbers and strings.
    """

    name: str
    verdict: Verdict
    measured: str
    advice: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class HandValidation:
    """Results of all checks on a hand.

    Attributes:
        hand: name of the hand.
        side: side of the hand.
        checks: results of the checks, in the order of the checklist.
    """

    hand: str
    side: Side
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """True if no check failed; warnings are allowed."""
        return not self.failed

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if check.verdict == "failed")

    def __getitem__(self, name: str) -> Check:
        """A check by its name; KeyError if there is no check of that name."""
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def to_json(self) -> dict[str, Any]:
        """The results as one object of plain lists, numbers and strings."""
        return {
            "hand": self.hand,
            "side": self.side,
            "ok": self.ok,
            "checks": [asdict(check) for check in self.checks],
        }


def worst(*verdicts: Verdict) -> Verdict:
    """Returns the worst of several verdicts, or ok if there are none. Only ok, warning and failed
    count."""
    order: tuple[Verdict, ...] = ("ok", "warning", "failed")
    return max((v for v in verdicts if v in order), key=order.index, default="ok")


_POSES: Final = 800


@dataclass(frozen=True, eq=False)
class Samples:
    """A hand in random poses, uniform within its limits. Some of these poses are self-collisions.

    Attributes:
        hand: the hand.
    """

    hand: Hand

    @cached_property
    def poses(self) -> Float[np.ndarray, "s m"]:
        """Positions of the actuated joints [rad]."""
        low, high = self.hand.limits[:, 0], self.hand.limits[:, 1]
        return np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))

    @cached_property
    def landmarks(self) -> Float[np.ndarray, "s k 3"]:
        """Landmarks in the palm frame [m], in the order of the hand's tree."""
        return self.hand.landmark_positions(self.poses)

    @cached_property
    def tips(self) -> Float[np.ndarray, "s f 3"]:
        """Fingertips in the palm frame [m], thumb first."""
        names = self.hand.tree.names
        return self.landmarks[:, [names.index(name) for name in self.hand.tip_names]]

    @cached_property
    def bases(self) -> Float[np.ndarray, "s f 3"]:
        """Finger bases in the palm frame [m], thumb first."""
        names = self.hand.tree.names
        bases = [LANDMARKS[BASES[FINGERS.index(finger)]] for finger in self.hand.fingers]
        return self.landmarks[:, [names.index(name) for name in bases]]


def movers(hand: Hand, landmark: str) -> tuple[int, ...]:
    """Indices of the joints that move a landmark, in order from the palm to the tip."""
    out: list[int] = []
    joint = hand.tree.keypoints[landmark].joint
    while joint >= 0:
        out.insert(0, hand.tree.joints[joint].source)
        joint = hand.tree.joints[joint].parent
    return tuple(out)
