"""The synthetic operators that GeoRT's built-in models are trained on."""

from __future__ import annotations

from typing import Final

from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.types import HandRecording, Side

FIRST_SEED: Final = 9000
"""Operators of this seed and above are for training; judge a model on others."""
TRAINING_OPERATORS: Final = 12
HELD_OUT_OPERATORS: Final = 2
DURATION_S: Final = 40.0
"""About two rounds of all gestures."""
RATE_HZ: Final = 50.0
_LENGTHS: Final = (0.165, 0.205)  # hands of most adults [m]


def synthetic_recordings(
    side: Side, seed: int = 0
) -> tuple[list[HandRecording], list[HandRecording]]:
    """Recordings of several people with hands of several sizes.

    Args:
        side: side of the hand.
        seed: other seeds are other people.

    Returns:
        ``TRAINING_OPERATORS`` recordings to train on, and ``HELD_OUT_OPERATORS`` of other
        people to validate on; their names hold the seeds.
    """
    count = TRAINING_OPERATORS + HELD_OUT_OPERATORS
    low, high = _LENGTHS
    recordings = [
        SyntheticOperator(
            seed=FIRST_SEED + count * seed + i,
            side=side,
            # every size among those trained on, and the held-out ones in between
            hand_length=low + (high - low) * (i % TRAINING_OPERATORS + 0.5) / TRAINING_OPERATORS,
            rate_hz=RATE_HZ,
        ).record(DURATION_S)
        for i in range(count)
    ]
    return recordings[:TRAINING_OPERATORS], recordings[TRAINING_OPERATORS:]
