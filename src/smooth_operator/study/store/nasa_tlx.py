"""NASA-TLX: six scales, their end labels, and the fifteen pairs for weights.

Sources: Hart and Staveland 1988, in the words of the paper-and-pencil version (NASA Ames);
Hart 2006 (the unweighted mean, "raw TLX").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from smooth_operator.errors import StudyError

STEP: Final = 5
HIGHEST: Final = 100


@dataclass(frozen=True)
class Scale:
    """One of the six.

    Attributes:
        name: in data.
        title: on the page.
        question: under the title.
        low: at 0.
        high: at 100; more is always worse.
    """

    name: str
    title: str
    question: str
    low: str = "Very low"
    high: str = "Very high"


SCALES: Final = (
    Scale("mental", "Mental demand", "How mentally demanding was the task?"),
    Scale("physical", "Physical demand", "How physically demanding was the task?"),
    Scale("temporal", "Temporal demand", "How hurried or rushed was the pace of the task?"),
    Scale(
        "performance",
        "Performance",
        "How successful were you in accomplishing what you were asked to do?",
        "Perfect",
        "Failure",
    ),
    Scale(
        "effort",
        "Effort",
        "How hard did you have to work to accomplish your level of performance?",
    ),
    Scale(
        "frustration",
        "Frustration",
        "How insecure, discouraged, irritated, stressed, and annoyed were you?",
    ),
)
SCALE_NAMES: Final = tuple(scale.name for scale in SCALES)
PAIRS: Final = tuple(combinations(SCALE_NAMES, 2))
"""All pairs of scales; of each, the operator says which added more to the workload."""


def check_ratings(ratings: Mapping[str, int]) -> None:
    """Refuses what is no answer to the six scales.

    Raises:
        StudyError: a scale is missing, unknown, or rated with something else than a step.
    """
    if set(ratings) != set(SCALE_NAMES):
        missing = sorted(set(SCALE_NAMES) - set(ratings))
        extra = sorted(set(ratings) - set(SCALE_NAMES))
        raise StudyError(
            f"NASA-TLX has the scales {', '.join(SCALE_NAMES)}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; unknown: {', '.join(extra)}" if extra else "")
        )
    for name, rating in ratings.items():
        whole = isinstance(rating, int) and not isinstance(rating, bool)
        if not whole or not 0 <= rating <= HIGHEST or rating % STEP:
            raise StudyError(
                f"NASA-TLX {name}: expected 0 to {HIGHEST} in steps of {STEP}, not {rating!r}"
            )


def check_winners(winners: Sequence[str]) -> None:
    """Refuses what is no answer to the fifteen pairs.

    Args:
        winners: of each pair of ``PAIRS``, the scale that added more.

    Raises:
        StudyError: their number is another, or one is not of its pair.
    """
    if len(winners) != len(PAIRS):
        raise StudyError(f"NASA-TLX has {len(PAIRS)} pairs to choose from, not {len(winners)}")
    for pair, winner in zip(PAIRS, winners, strict=True):
        if winner not in pair:
            raise StudyError(f"NASA-TLX: of {pair[0]} and {pair[1]} one is chosen, not {winner!r}")


def weights(winners: Sequence[str]) -> dict[str, int]:
    """How often each scale was chosen: 0 to 5 each, 15 together."""
    return {name: list(winners).count(name) for name in SCALE_NAMES}


def raw_workload(ratings: Mapping[str, float]) -> float:
    """Mean of the six ratings."""
    return sum(ratings[name] for name in SCALE_NAMES) / len(SCALE_NAMES)


def weighted_workload(ratings: Mapping[str, float], winners: Sequence[str]) -> float:
    """Mean of the six ratings, each as often as its scale was chosen."""
    by = weights(winners)
    return sum(ratings[name] * by[name] for name in SCALE_NAMES) / len(PAIRS)
