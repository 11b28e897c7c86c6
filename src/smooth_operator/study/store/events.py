"""Events of an operator in a study; only events are stored.

Events are values; they say where they belong (task, block, trial), so that a page that was left
open can't score the wrong trial. Nothing is changed or taken back in the log: a mistake is undone
by one more event.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any, ClassVar, Final, TypeAlias, get_type_hints

from smooth_operator.errors import StudyError
from smooth_operator.study.design.protocol import Point
from smooth_operator.study.store.nasa_tlx import check_ratings, check_winners

_LONGEST_TEXT: Final = 20_000


@dataclass(frozen=True)
class _Event:
    kind: ClassVar[str]


@dataclass(frozen=True)
class _OfBlock(_Event):
    task: str
    block: int


@dataclass(frozen=True)
class _OfTrial(_OfBlock):
    trial: int


@dataclass(frozen=True)
class Calibrated(_Event):
    """The tracker was calibrated to the operator, or that was left out."""

    kind: ClassVar[str] = "calibrated"
    task: str
    detail: str = ""


@dataclass(frozen=True)
class BlockStarted(_OfBlock):
    """The retargeter was switched to the block's condition."""

    kind: ClassVar[str] = "block_started"
    condition: str


@dataclass(frozen=True)
class FamiliarisationStarted(_OfBlock):
    """Free movement begins, and its countdown.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    kind: ClassVar[str] = "familiarisation_started"
    clock: str = field(default="", compare=False)


@dataclass(frozen=True)
class FamiliarisationEnded(_OfBlock):
    """Free movement is over."""

    kind: ClassVar[str] = "familiarisation_ended"


@dataclass(frozen=True)
class TrialStarted(_OfTrial):
    """The clock of a trial runs.

    Attributes:
        clock: reading of a steady clock (``smooth_operator.study.store.clock``).
    """

    kind: ClassVar[str] = "trial_started"
    clock: str = field(default="", compare=False)


@dataclass(frozen=True)
class TrialReset(_OfTrial):
    """The object was put back; caps the score."""

    kind: ClassVar[str] = "trial_reset"


@dataclass(frozen=True)
class TrialScored(_OfTrial):
    """The trial ended.

    Attributes:
        line: of the task's rubric.
        score: of that line, capped if there was a reset.
        time_s: from its start [s].
    """

    kind: ClassVar[str] = "trial_scored"
    line: str
    score: float
    time_s: float


@dataclass(frozen=True)
class TrialVoided(_OfTrial):
    """The trial doesn't count, for a reason that is not the operator's; it is done again."""

    kind: ClassVar[str] = "trial_voided"
    reason: str


@dataclass(frozen=True)
class Answered(_OfBlock):
    """NASA-TLX was filled in."""

    kind: ClassVar[str] = "questionnaire_answered"
    point: Point
    ratings: Mapping[str, int]


@dataclass(frozen=True)
class Weighed(_OfBlock):
    """The fifteen pairs of NASA-TLX were chosen from."""

    kind: ClassVar[str] = "weights_answered"
    winners: tuple[str, ...]


@dataclass(frozen=True)
class BreakStarted(_Event):
    """The operator rests."""

    kind: ClassVar[str] = "break_started"


@dataclass(frozen=True)
class BreakEnded(_Event):
    """The operator is back."""

    kind: ClassVar[str] = "break_ended"


@dataclass(frozen=True)
class Noted(_Event):
    """Something worth remembering."""

    kind: ClassVar[str] = "noted"
    text: str


@dataclass(frozen=True)
class Undone(_Event):
    """An earlier event counts no more.

    Attributes:
        number: of the event among the operator's.
        reason: why.
    """

    kind: ClassVar[str] = "undone"
    number: int
    reason: str = ""


Event: TypeAlias = (
    Calibrated
    | BlockStarted
    | FamiliarisationStarted
    | FamiliarisationEnded
    | TrialStarted
    | TrialReset
    | TrialScored
    | TrialVoided
    | Answered
    | Weighed
    | BreakStarted
    | BreakEnded
    | Noted
    | Undone
)

EVENTS: Final[dict[str, type[Event]]] = {
    made.kind: made
    for made in (
        Calibrated, BlockStarted, FamiliarisationStarted, FamiliarisationEnded, TrialStarted,
        TrialReset, TrialScored, TrialVoided, Answered, Weighed, BreakStarted, BreakEnded, Noted,
        Undone,
    )
}  # fmt: skip
"""Kind, as it is stored -> class."""


@dataclass(frozen=True)
class Record:
    """An event in the log.

    Attributes:
        number: among the operator's events, from 1, without gaps.
        at: when it was written, UTC.
        author: who did it: ``experimenter``, ``operator`` or ``system``.
        event: what happened.
    """

    number: int
    at: datetime
    author: str
    event: Event


def payload(event: Event) -> dict[str, Any]:
    """An event's fields as plain values."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in dataclasses.asdict(event).items()
    }


def event_of(kind: str, values: Mapping[str, Any]) -> Event:
    """An event from its kind and fields, checked as far as it can be without the plan.

    Raises:
        StudyError: no such kind, or a field is missing, unknown or of the wrong type.
    """
    if kind not in EVENTS:
        raise StudyError(f"no event is called {kind!r}; expected one of {', '.join(EVENTS)}")
    made = EVENTS[kind]
    hints = get_type_hints(made)
    known = [f.name for f in fields(made)]
    needed = {f.name for f in fields(made) if f.default is dataclasses.MISSING}
    missing, unknown = sorted(needed - set(values)), sorted(set(values) - set(known))
    if missing or unknown:
        raise StudyError(
            f"event {kind!r} has the fields {', '.join(known) or '(none)'}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; unknown: {', '.join(unknown)}" if unknown else "")
        )
    return made(**{name: _checked(kind, name, v, hints[name]) for name, v in values.items()})


def _checked(kind: str, name: str, value: Any, hint: Any) -> Any:
    where = f"event {kind!r}: {name}"
    if name == "ratings":
        if not isinstance(value, Mapping):
            raise StudyError(f"{where} must be a table of the six scales, not {value!r}")
        check_ratings(value)
        return dict(value)
    if name == "winners":
        if not isinstance(value, list | tuple):
            raise StudyError(f"{where} must be a list of scales, not {value!r}")
        check_winners(value)
        return tuple(value)
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise StudyError(f"{where} must be a whole number, not {value!r}")
        return value
    if hint is float:
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or not math.isfinite(value) or value < 0:
            raise StudyError(f"{where} must be a number of 0 or more, not {value!r}")
        return float(value)
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or "\x00" in value:
        raise StudyError(f"{where} must be a text of up to {_LONGEST_TEXT} characters")
    return value
