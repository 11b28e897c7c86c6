"""Prompts in the terminal that ask an operator for the poses and motions of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from smooth_operator.calibration.segments import Prompt, Segment
from smooth_operator.cli.console import Progressing
from smooth_operator.errors import SourceError
from smooth_operator.teleop.runtime.calibration_session import CalibrationSession, Moment
from smooth_operator.teleop.sources.live import LiveSource, Mailbox
from smooth_operator.types import HandRecording, Side

_TURN_S: Final = 0.05
_PATIENCE_S: Final = 30.0
"""Time without frames from the tracker after which the calibration ends [s]."""


def ask(
    source: LiveSource, side: Side, prompts: Sequence[Prompt], progress: Progressing
) -> tuple[HandRecording, list[Segment]]:
    """Shows the prompts one after the other, with a progress bar.

    Args:
        source: where frames come from; started and stopped here.
        side: side of the hand.
        prompts: the prompts, in order.

    Returns:
        the recorded frames, and the span of them that belongs to each prompt.

    Raises:
        SourceError: no hand was tracked for half a minute, or the source failed.
    """
    mailbox = Mailbox()
    session = CalibrationSession(side, prompts)
    source.start(mailbox)
    try:
        with progress.bar("calibrating") as show:
            _go_through(session, source, mailbox, show)
    finally:
        source.stop()
    return session.recording(), session.segments()


def _go_through(
    session: CalibrationSession,
    source: LiveSource,
    mailbox: Mailbox,
    show: Callable[[str, float], None],
) -> None:
    last_stamp = mailbox.clock()
    while (moment := session.at(mailbox.clock())) is not None:
        show(_told(moment), moment.done)
        mailbox.wait((session.side,), _TURN_S)
        if (arrival := mailbox.take(session.side)) is not None:
            session.see(arrival)
            last_stamp = mailbox.clock()
        health = source.health()
        if health.state in ("failed", "ended") or mailbox.clock() - last_stamp > _PATIENCE_S:
            raise SourceError(
                f"{source.label}: the {session.side} hand is no longer tracked "
                f"({100 * moment.done:.0f} % completed); {health.detail or health.state}"
            )


def _told(moment: Moment) -> str:
    if moment.phase == "wait":
        return f"no hand is tracked; next: {moment.prompt.text}"
    verb = "get ready" if moment.phase == "settle" else "now"
    return f"{moment.prompt.text} ({verb}, {moment.left_s:.0f} s)"
