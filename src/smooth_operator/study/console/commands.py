"""Commands of the pages: checked, and turned into events of the store.

A command is a JSON object: ``token`` (any text that belongs to it alone), ``do`` (a word below),
``operator``, ``after`` (number of the last event that the page had seen), ``waited_s`` (time since
it was given: it may have lain in a page that was cut off) and the fields of its word.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import StudyError
from smooth_operator.study.store.clock import Elapsed
from smooth_operator.study.store.events import ASIDE, Amended, Event, event_of
from smooth_operator.study.store.events import EVENTS as KINDS
from smooth_operator.study.store.nasa_tlx import shown_pairs
from smooth_operator.study.store.operator_state import Trial
from smooth_operator.study.store.progress import Progress

Role: TypeAlias = Literal["experimenter", "operator"]
EVENTS: Final = {event.word: kind for kind, event in KINDS.items() if event.word}
"""Word -> kind of the event that it causes."""
OTHER: Final = ("choose", "enrol", "replace", "switch", "cancel_start")
"""Words that cause no event of the operator who is on."""
OPERATOR_MAY: Final = ("answer", "weigh", "form")
_LONGEST_WAIT: Final = 86_400.0
_TOKEN: Final = range(8, 129)


@dataclass(frozen=True)
class Command:
    """One thing that a page asks for.

    Attributes:
        token: belongs to it alone, however often it is sent.
        do: one of ``EVENTS`` or ``OTHER``.
        operator: pseudonym.
        after: number of the last event that the page had seen; None where that doesn't matter.
        fields: what else its word needs.
        waited_s: since it was given [s]; of a score: since the clock was stopped.
    """

    token: str
    do: str
    operator: str
    after: int | None
    fields: Mapping[str, Any]
    waited_s: float = 0.0


def command_of(message: Mapping[str, Any], role: Role) -> Command:
    """A command from a page, checked as far as it can be without the study.

    Raises:
        StudyError: it is none, or not one that this page may give.
    """
    token, do, operator = message.get("token"), message.get("do"), message.get("operator", "")
    if not isinstance(token, str) or len(token) not in _TOKEN or not token.isprintable():
        raise StudyError(f"a command needs a token of 8 to 128 characters, not {token!r}")
    if not isinstance(do, str) or do not in (*EVENTS, *OTHER):
        raise StudyError(f"no such command: {do!r}; reload the page")
    if role == "operator" and do not in OPERATOR_MAY:
        raise StudyError(f"the operator's page may not do {do!r}")
    after, fields, waited = (
        message.get("after"),
        message.get("fields", {}),
        message.get("waited_s", 0.0),
    )
    if not isinstance(operator, str) or not isinstance(fields, Mapping):
        raise StudyError("a command needs an operator and its fields; reload the page")
    if after is not None and (isinstance(after, bool) or not isinstance(after, int)):
        raise StudyError(f"after must be the number of an event, not {after!r}")
    number = isinstance(waited, int | float) and not isinstance(waited, bool)
    if not number or not math.isfinite(waited) or not 0 <= waited <= _LONGEST_WAIT:
        raise StudyError(f"waited_s must be 0 to {_LONGEST_WAIT:g} s, not {waited!r}")
    who = fields.get("who", "")
    typed = bool(who.strip()) if isinstance(who, str) else bool(who)
    if do in OPERATOR_MAY and typed != (role == "experimenter"):
        raise StudyError(
            "what an operator answers needs the initials of who types it in for them, on the "
            "experimenter's page and nowhere else"
        )
    return Command(token, do, operator, after, dict(fields), float(waited))


def event_for(
    command: Command,
    progress: Progress,
    elapsed: Elapsed | None,
    measured_s: float | None = None,
    more: Mapping[str, Any] | None = None,
) -> Event:
    """The event that a command causes. What the protocol decides is not taken from the page.

    Args:
        command: what is asked for.
        progress: of its operator.
        elapsed: from the start of the trial until it came; None where none runs.
        measured_s: how long the trial took, where something better than a person measured it [s].
        more: fields that this program knows and a page does not say.

    Raises:
        StudyError: a field is missing, unknown or wrong, or nothing runs that could be scored.
        UnknownNameError: the rubric has no such line.
    """
    values = dict(command.fields)
    if command.do == "score":
        line = str(values.get("line"))
        values["score"] = progress.capped(line)
        _check_reset(line, progress.running)
        values["time_s"] = trial_time(progress, elapsed, command.waited_s, measured_s)
    elif command.do == "start_block":
        block = progress.step.block
        values["condition"] = "" if block is None else block.condition.name
    elif command.do == "weigh" and not values.get("who"):  # paper has an order of its own
        pairs = shown_pairs(progress.plan.protocol.seed, progress.operator)
        values["shown"] = ["-".join(pair) for pair in pairs]
    elif command.do == "amend":
        values = _amended(values, progress)
    return event_of(EVENTS[command.do], {**values, **(more or {})})


def _check_reset(line: str, trial: Trial | None) -> None:
    if trial is not None and not trial.resets and line.endswith("after-reset"):
        raise StudyError(
            f"line {line!r} of the rubric needs a reset, and this trial had none; if the object "
            "was put back, say so first"
        )


def _amended(values: dict[str, Any], progress: Progress) -> dict[str, Any]:
    """An amendment with what it leaves as it is; its score is the rubric's."""
    task, block, number = (values.get(name) for name in ("task", "block", "trial"))
    trial = progress.scored_trial(str(task), _whole(block), _whole(number))
    line = str(values.get("line") or trial.line)
    if line != trial.line:
        _check_reset(line, trial)
    time_s = trial.time_s if values.get("time_s") is None else values["time_s"]
    return {**values, "line": line, "score": progress.capped(line, trial), "time_s": time_s}


def _whole(value: Any) -> int:
    return value if isinstance(value, int) else -1


def trial_time(
    progress: Progress,
    elapsed: Elapsed | None,
    waited_s: float,
    measured_s: float | None = None,
) -> float:
    """Time of the trial that runs [s], to the millisecond.

    From its stored start until its clock was stopped, so that neither a killed server nor a lost
    connection changes it. A trial whose score was undone keeps the time that it had.

    Args:
        progress: of the operator.
        elapsed: from its start until now.
        waited_s: how long ago the clock was stopped [s].
        measured_s: what a simulation says, without pauses [s]; by its own clock.
    """
    trial = progress.running
    if trial is None or elapsed is None:
        raise StudyError(f"operator {progress.operator}: no trial runs that could be scored")
    if trial.undone_time_s is not None:
        return trial.undone_time_s
    if measured_s is not None:
        return round(measured_s, 3)
    return round(max(0.0, elapsed.seconds - waited_s - trial.paused_s), 3)


def check_seen(command: Command, progress: Progress) -> None:
    """Refuses what was asked for on a page that had not seen what happened meanwhile.

    Raises:
        StudyError: says what happened.
    """
    if command.after is None or command.do == "note":
        return
    for record in progress.records[command.after :]:
        if isinstance(record.event, Amended) and command.do not in ("amend", "undo"):
            continue  # of an earlier trial: what is due is the same
        if not isinstance(record.event, ASIDE):
            what = record.event.kind.replace("_", " ")
            raise StudyError(
                f"not done: meanwhile another page, or this console itself, wrote event "
                f"{record.number} ({what}); look again and repeat it if it is still right"
            )
