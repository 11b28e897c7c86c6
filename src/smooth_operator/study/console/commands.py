"""Commands of the pages: checks them, and makes events of them.

A command is a JSON object: ``token`` (unique text), ``do`` (a word below), ``operator``, ``after``
(number of the last event that the page had seen), ``waited_s`` (age of the command [s]: it may have
waited in a page without a connection) and the ``fields`` of its word.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import StudyError
from smooth_operator.study.store import events
from smooth_operator.study.store.progress import Progress, Trial

Role: TypeAlias = Literal["experimenter", "operator"]
EVENTS: Final = {event.command: kind for kind, event in events.EVENTS.items() if event.command}
"""Command -> kind of the event that it causes."""
OTHER: Final = ("choose", "enrol", "switch")
"""Commands that cause no event of the current operator."""
OPERATOR_COMMANDS: Final = ("answer", "form")
"""Commands of the operator's page; the experimenter's page has all others."""
_LONGEST_WAIT: Final = 86_400.0
_TOKEN: Final = range(8, 129)


@dataclass(frozen=True)
class Command:
    """A request of a page.

    Attributes:
        token: unique text of the command, the same each time that it is sent.
        do: one of ``EVENTS`` or ``OTHER``.
        operator: pseudonym.
        after: number of the last event that the page had seen; None where that doesn't matter.
        fields: further fields of the command.
        waited_s: age of the command [s]; for a score the time since the clock was stopped.
    """

    token: str
    do: str
    operator: str
    after: int | None
    fields: Mapping[str, Any]
    waited_s: float = 0.0


def command_of(message: Mapping[str, Any], role: Role) -> Command:
    """Makes a command of a page's message, checked as far as possible without the study.

    Raises:
        StudyError: the message is no command, or not one of this page.
    """
    token, do, operator = message.get("token"), message.get("do"), message.get("operator", "")
    after, fields = message.get("after"), message.get("fields", {})
    waited = message.get("waited_s", 0.0)
    if not isinstance(token, str) or len(token) not in _TOKEN or not token.isprintable():
        raise StudyError(f"a command needs a token of 8 to 128 characters, not {token!r}")
    if not isinstance(do, str) or do not in (*EVENTS, *OTHER):
        raise StudyError(f"no such command: {do!r}; reload the page")
    if (role == "operator") != (do in OPERATOR_COMMANDS):
        raise StudyError(f"the {role}'s page may not do {do!r}")
    if not isinstance(operator, str) or not isinstance(fields, Mapping):
        raise StudyError("a command needs an operator and its fields; reload the page")
    if after is not None and (isinstance(after, bool) or not isinstance(after, int)):
        raise StudyError(f"after must be the number of an event, not {after!r}")
    number = isinstance(waited, int | float) and not isinstance(waited, bool)
    if not number or not math.isfinite(waited) or not 0 <= waited <= _LONGEST_WAIT:
        raise StudyError(f"waited_s must be 0 to {_LONGEST_WAIT:g} s, not {waited!r}")
    return Command(token, do, operator, after, dict(fields), float(waited))


def event_for(
    command: Command,
    progress: Progress,
    elapsed_s: float | None,
    measured_s: float | None = None,
    more: Mapping[str, Any] | None = None,
) -> events.Event:
    """Makes the event of a command. Facts that the protocol decides are not taken from the page.

    Args:
        command: request of the page.
        progress: progress of its operator.
        elapsed_s: time from the start of the trial to the command [s]; None without a trial.
        measured_s: time of the trial by a simulation [s]; None without one.
        more: fields that the console knows and the page does not send.

    Raises:
        StudyError: a field is missing, unknown or wrong, or no trial runs that could be scored.
        UnknownNameError: the rubric has no such line.
    """
    values = dict(command.fields)
    if command.do == "score":
        line = str(values.get("line"))
        values["score"] = progress.capped(line)
        _check_reset(line, progress.running)
        values["time_s"] = trial_time(progress, elapsed_s, command.waited_s, measured_s)
    elif command.do == "start_block":
        block = progress.step.block
        values["condition"] = "" if block is None else block.condition.name
    elif command.do == "amend":
        values = _amended(values, progress)
    return events.event_of(EVENTS[command.do], {**values, **(more or {})})


def _check_reset(line: str, trial: Trial | None) -> None:
    if trial is not None and not trial.resets and line.endswith("after-reset"):
        raise StudyError(
            f"line {line!r} of the rubric needs a reset, and this trial had none; if the object "
            "was put back, say so first"
        )


def _amended(values: dict[str, Any], progress: Progress) -> dict[str, Any]:
    """Completes an amendment by the trial's line and time, and by the score of the rubric."""
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
    elapsed_s: float | None,
    waited_s: float,
    measured_s: float | None = None,
) -> float:
    """Time of the running trial [s], to the millisecond.

    It goes from the stored start to the moment when the page stopped the clock, so that neither a
    killed server nor a lost connection changes it. A trial whose score was undone keeps its time.

    Args:
        progress: progress of the operator.
        elapsed_s: time from the start of the trial until now [s].
        waited_s: time since the page stopped the clock [s].
        measured_s: time by the clock of a simulation, without pauses [s].
    """
    trial = progress.running
    if trial is None or elapsed_s is None:
        raise StudyError(f"operator {progress.operator}: no trial runs that could be scored")
    if trial.undone_time_s is not None:
        return trial.undone_time_s
    if measured_s is not None:
        return round(measured_s, 3)
    return round(max(0.0, elapsed_s - waited_s - trial.paused_s), 3)


def check_seen(command: Command, progress: Progress) -> None:
    """Refuses a command of a page that had not seen the latest events.

    Raises:
        StudyError: says which event the page had not seen.
    """
    if command.after is None or command.do == "note":
        return
    for record in progress.records[command.after :]:
        if isinstance(record.event, events.Amended) and command.do not in ("amend", "undo"):
            continue  # it concerns an earlier trial: the step that is due is the same
        if not isinstance(record.event, events.Noted):
            what = record.event.kind.replace("_", " ")
            raise StudyError(
                f"not done: meanwhile another page, or this console itself, wrote event "
                f"{record.number} ({what}); look again and repeat it if it is still right"
            )
