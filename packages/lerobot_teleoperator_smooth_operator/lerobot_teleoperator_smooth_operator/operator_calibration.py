"""Guided calibration of an operator's pinches, from the hands in the commands that arrive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lerobot_teleoperator_smooth_operator.commands import Command, Newest
from lerobot_teleoperator_smooth_operator.subscription import Feed
from smooth_operator.calibration import calibrate
from smooth_operator.calibration.operator_file import (
    OperatorProfile,
    read_operator,
    write_operator,
)
from smooth_operator.calibration.segments import PROMPTS
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.prompting import ask
from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.live import Running, ThreadedSource
from smooth_operator.types import HandFrame

_TURN_S = 0.002
"""Interval at which the newest command is checked [s]."""


@dataclass(frozen=True)
class HandsOfCommands(ThreadedSource):
    """Source of the human hands from which the commands of a running loop were computed.

    Attributes:
        newest: store of the commands.
        feed: connection from which they arrive.
        side: side of the hand.
    """

    newest: Newest
    feed: Feed
    side: Any

    @property
    def label(self) -> str:
        """The word ``smooth_operator``."""
        return "smooth_operator"

    def run(self, running: Running) -> None:
        """Posts the hand of each command."""
        last: Command | None = None
        while not running.stopping.wait(_TURN_S):
            if self.feed.error is not None:
                raise SourceError(str(self.feed.error))
            command = self.newest.command(self.side)
            if command is not None and command is not last and command.landmarks is not None:
                running.mailbox.post(HandFrame(command.landmarks, side=self.side))
            last = command


def calibrate_operator(file: Path, newest: Newest, feed: Feed, side: Any) -> OperatorProfile:
    """Ask the operator in the terminal for one pinch after the other, and write their gaps.

    Args:
        file: the operator's file; the mounts of trackers in it are kept.
        newest: store of the commands.
        feed: connection from which they arrive; it is closed.
        side: side of the hand.

    Returns:
        the calibration that was written.

    Raises:
        SmoothOperatorError: no hand was tracked, or the file can't be read or written.
    """
    mounts = read_operator(file).mounts if file.exists() else {}
    source = HandsOfCommands(newest, feed, side)
    recording, segments = ask(source, side, PROMPTS, Progressing())
    feed.close()  # a loop in this process writes its own estimates into the file when it ends
    operator = replace(calibrate(recording, segments).operator, mounts=mounts)
    write_operator(file, operator)
    return operator
