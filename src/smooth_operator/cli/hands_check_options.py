"""Options of ``smooth-operator hands check``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide


@dataclass(frozen=True, kw_only=True)
class Check(Common):
    """Is a hand's description right? Limits, axes, tips, pinches, and a round trip."""

    work: ClassVar[str] = "smooth_operator.cli.hands_check:check_hand_command"
    details: ClassVar[str] = """Each check says what was measured and what to do. In the round trip
random poses of the hand are retargeted from their own landmarks: they should come back. The exit
status is 0 if all is well, 1 if a check failed, 2 if the hand can't be loaded.

Examples:
  smooth-operator hands check my_hand
  smooth-operator hands check my_hand.right.toml --quick
  smooth-operator hands check shadow_hand --side left --json"""

    hand: Annotated[Positional[str], arg(metavar="SPEC")]
    """Name of a hand, or path of a spec file (.toml)."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; right, or as the spec file says, if left out."""

    quick: bool = False
    """Take the round trip through sbr and smooth only, not through every method."""

    poses: int = 20
    """Poses of each round trip."""

    seed: int = 0
    """Seed of these poses."""

    json: bool = False
    """One JSON object on standard output instead of the checklist."""

    quiet: bool = False
    """No progress on standard error."""
