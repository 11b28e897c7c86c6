"""The poses of a calibration, as data: what an operator is asked to do, and for how long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.calibration.segments import Segment
from smooth_operator.landmarks import FINGERS


@dataclass(frozen=True)
class Prompt:
    """One pose to hold.

    Attributes:
        pose: its name, as in ``Segment``.
        text: the instruction to the operator.
        settle: time to get there, which is not used [s].
        hold: time to hold it, which is used [s].
    """

    pose: str
    text: str
    settle: float = 2.0
    hold: float = 4.0


def prompts(fingers: Sequence[str] = FINGERS) -> tuple[Prompt, ...]:
    """What to ask of an operator whose fingers drive a robot, thumb first."""
    return (
        Prompt("flat", "hold your hand flat, fingers straight and together"),
        Prompt("spread", "spread your fingers as far as they go"),
        Prompt("fist", "make a fist"),
        *(
            Prompt(f"pinch_{name}", f"pinch: thumb pad on {name} finger pad, lightly", hold=5.0)
            for name in fingers
            if name != "thumb"
        ),
    )


def prompted(
    stamps: Float[np.ndarray, " T"], schedule: Sequence[tuple[Prompt, float]]
) -> list[Segment]:
    """The segments that prompts mark in a recording: what was asked is taken as done.

    Args:
        stamps: (T,) of the frames [s].
        schedule: each prompt and the stamp at which it was shown [s].
    """
    segments = []
    for prompt, shown in schedule:
        begin = shown + prompt.settle
        start, stop = np.searchsorted(stamps, [begin, begin + prompt.hold])
        if stop > start:
            segments.append(Segment(prompt.pose, int(start), int(stop), 1.0))
    return segments
