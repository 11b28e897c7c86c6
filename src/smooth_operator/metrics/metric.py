"""A metric: its name, unit, better direction, and the function that computes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from smooth_operator.errors import UnknownNameError

if TYPE_CHECKING:
    from smooth_operator.metrics.trace import Trace

Value: TypeAlias = float | int | str | Mapping[str, float | int | None] | None
"""What a metric may be: mostly a number; None where it can't be measured."""

_DIRECTIONS: Final = {
    "->1": ("→ 1", "best at 1"),
    "down": ("↓", "less is better"),
    "up": ("↑", "more is better"),
    "": ("", ""),
}


@dataclass(frozen=True)
class Metric:
    """One figure of a run.

    Attributes:
        name: key in the result of ``evaluate``; a dot steps into a nested one.
        unit: "" for a plain number.
        goal: ``"->1"`` best at one, ``"down"`` or ``"up"``; ``""`` for a fact that is not a merit.
        meaning: one line for a person.
        group: key of ``GROUPS``; "" for a figure that stands alone.
        compute: from a run to the figure; None where the caller of ``evaluate`` gives it.
        published: the same by the paper's own definition, where that is another.
        short: heading of its column in the main tables of a benchmark; "" where it has none.
    """

    name: str
    unit: str
    goal: Literal["->1", "down", "up", ""]
    meaning: str
    group: str = ""
    compute: Callable[[Trace], Any] | None = None
    published: Callable[[Trace], Any] | None = None
    short: str = ""

    @property
    def key(self) -> str:
        """Its key at the top of a result: its name up to the dot."""
        return self.name.partition(".")[0]

    @property
    def sign(self) -> str:
        """Better direction as a sign; "" for a fact."""
        return _DIRECTIONS[self.goal][0]

    @property
    def better(self) -> str:
        """Better direction in words; "" for a fact."""
        return _DIRECTIONS[self.goal][1]

    def of(self, result: Mapping[str, object]) -> object:
        """This metric's value in a result.

        Raises:
            UnknownNameError: if the result has no such key.
        """
        value: object = result
        for key in self.name.split("."):
            if not isinstance(value, Mapping) or key not in value:
                available = value.keys() if isinstance(value, Mapping) else ()
                raise UnknownNameError("metric", self.name, available)
            value = value[key]
        return value


GROUPS: Final[Mapping[str, str]] = {
    "posture": "Posture: is the robot hand open and closed as the human hand is?",
    "grasping": "Grasping: do pinches close, and do fingers stay out of each other?",
    "motion": "Motion: does the robot hand move as the human hand does?",
    "smoothness": "Smoothness: does it move without jitter?",
    "accuracy": "Accuracy: do the vectors between wrist and fingertips agree, as in the paper?",
    "reach": "Reach: how much of its range is in use?",
    "latency": "Latency: how long does a command take?",
    "run": "Run: what was measured?",
}
"""Groups of metrics, in the order of reports, and the question that each answers."""
