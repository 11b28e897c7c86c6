"""A source that takes the fingers from one tracker and the wrist from another."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from smooth_operator.poses import compose
from smooth_operator.teleop.sources.live import LiveSource, Mailbox, SourceHealth, source_gaps
from smooth_operator.types import HandFrame, Side

WRIST_AGE_S: Final = 0.1
"""Age of a wrist's pose after which it does not count as valid [s]."""
_Part = TypeVar("_Part")
_WORST_FIRST: Final = ("failed", "ended", "waiting", "running")


@dataclass(frozen=True)
class CombinedSource:
    """Source with the hands of one source and the wrist poses of another; see ``LiveSource``.

    A frame gets the newest pose that arrived before it; if this is older than ``WRIST_AGE_S``, its
    wrist is not valid.

    Attributes:
        hands: source of the landmarks; its own wrists are not used.
        wrist: source of the poses; only ``HandFrame.T_world_wrist`` of its frames is used.
        mounts: where its trackers sit on the hands: side -> pose of the wrist in the tracker's
            frame. Without an entry, the pose of the tracker is that of the wrist.
    """

    hands: LiveSource
    wrist: LiveSource
    mounts: Mapping[Side, tuple[float, ...]]

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"{self.hands.label} with the wrist from {self.wrist.label}"

    @property
    def pinch_gaps(self) -> Mapping[str, float]:
        """Gaps that the finger tracker is known to report in pinches; see ``source_gaps``."""
        return source_gaps(self.hands)

    def prepare(self) -> None:
        """Opens both sources."""
        self.hands.prepare()
        self.wrist.prepare()

    def start(self, mailbox: Mailbox) -> None:
        """Starts both sources."""
        wrists = Mailbox(mailbox.clock)

        def complete(frame: HandFrame, received: float) -> HandFrame:
            newest = wrists.newest(frame.side)
            if newest is None:
                return dataclasses.replace(frame, T_world_wrist=None)
            pose, mount = newest.frame.T_world_wrist, self.mounts.get(frame.side)
            if pose is None or received - newest.received > WRIST_AGE_S:
                pose = np.full(7, np.nan)
            elif mount is not None:
                pose = compose(pose, np.array(mount))
            return dataclasses.replace(frame, T_world_wrist=pose, world=newest.frame.world)

        mailbox.complete = complete
        self.wrist.start(wrists)
        try:
            self.hands.start(mailbox)
        except BaseException:
            self.wrist.stop()
            raise

    def stop(self) -> None:
        """Stops both sources."""
        self.hands.stop()
        self.wrist.stop()

    def health(self) -> SourceHealth:
        """Health of the source that is worse off, with the details of both."""
        both = [(source.label, source.health()) for source in (self.hands, self.wrist)]
        state = min((health.state for _, health in both), key=_WORST_FIRST.index)
        details = (f"{label}: {health.detail}" for label, health in both if health.detail)
        return SourceHealth(state, "; ".join(details))


def part_of(source: LiveSource, kind: type[_Part]) -> _Part | None:
    """Returns the source, or the part of a ``CombinedSource``, that is of a class; None if there is
    none."""
    parts = (source.hands, source.wrist) if isinstance(source, CombinedSource) else (source,)
    return next((part for part in parts if isinstance(part, kind)), None)
