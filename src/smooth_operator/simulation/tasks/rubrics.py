"""The paper's three tasks with their rubrics: what a trial of each must show for which score.

Source: the paper's supplement, task success rubric, in our words.
"""

from __future__ import annotations

from typing import Final

from smooth_operator.simulation.tasks.task import RubricLine, Task

_DROPPED: Final = RubricLine("dropped", 0.0, "the object left the hand's workspace")
_GAVE_UP: Final = RubricLine("not-done", 0.0, "the operator gave up, or the time was over")
_RESET: Final = RubricLine("done-after-reset", 0.5, "done, after the one reset that is allowed")

CARD_PICKUP: Final = Task(
    "A",
    title="Card pickup",
    instruction="Slide the flat card over the edge of the platform and pinch it.",
    trials=10,
    operators=12,
    rubric=(
        RubricLine("done", 1.0, "slid over the edge and held in a pinch, without a reset"),
        _RESET,
        RubricLine(
            "out-of-reach", 0.5, "out of reach or flicked across the top; pinched after a reset"
        ),
        RubricLine("no-edge", 0.5, "pinched and lifted without having gone over the edge"),
        _DROPPED,
        _GAVE_UP,
    ),
)

CUBE_ROTATION: Final = Task(
    "B",
    title="Vertical cube rotation",
    instruction="Turn the cube by 90 degrees about the vertical axis.",
    trials=10,
    operators=8,
    rubric=(
        RubricLine("done", 1.0, "turned by 90 degrees about the vertical, without a reset"),
        RubricLine("misaligned", 0.5, "turned, after a reset for faces badly misaligned"),
        RubricLine("flipped", 0.5, "turned, but the cube flipped onto another face on the way"),
        _DROPPED,
        _GAVE_UP,
    ),
)

SCREWDRIVER_PIVOT: Final = Task(
    "C",
    title="Screwdriver pivot",
    instruction="Hold the screwdriver in four fingers, loosen the grip until it points down.",
    trials=20,
    operators=6,
    rubric=(
        RubricLine("done", 1.0, "points straight down, still held, without a reset"),
        RubricLine("nearly", 0.5, "nearly down, at a limit where no finer adjustment is possible"),
        _RESET,
        _DROPPED,
        _GAVE_UP,
    ),
)

PAPER_TASKS: Final = (CARD_PICKUP, CUBE_ROTATION, SCREWDRIVER_PIVOT)
