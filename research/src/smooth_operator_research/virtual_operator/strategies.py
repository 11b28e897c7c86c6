"""How people do the tasks: steps for the fingertips that depend on what is seen of the object.

A strategy is a generator. It yields the next step and receives what the person sees when the step
is over, so that strokes are repeated until the goal is seen, and what slipped is taken again.
Strategies follow the instructions of the tasks: the card is pressed, drawn over the edge and
pinched from below; the cube is gripped, turned as far as the fingers reach, let go and gripped
again; the screwdriver is taken between thumb and fingers, and the grip loosened until it hangs.
Where on the object a hand can do that follows from its kinematics, so that any hand has strategies.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from smooth_operator_research.virtual_operator.card_strategy import card_strategy
from smooth_operator_research.virtual_operator.cube_strategy import cube_strategy
from smooth_operator_research.virtual_operator.grip_reach import GripReach
from smooth_operator_research.virtual_operator.screwdriver_strategy import screwdriver_strategy
from smooth_operator_research.virtual_operator.strategy_steps import Seen, Strategy

STRATEGIES: Final[dict[str, Callable[[Any, GripReach, Seen], Strategy]]] = {
    "card": card_strategy,
    "cube": cube_strategy,
    "screwdriver": screwdriver_strategy,
}
"""Task -> how people do it."""
