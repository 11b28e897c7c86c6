"""Base of live sources, and the mailbox with the newest frame of each hand.

A source runs on its own thread and posts received frames into a mailbox with one place per hand. A
frame that was not taken is overwritten by the next one, so there is no queue, and the loop always
answers the newest.
"""

from __future__ import annotations

import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from statistics import median
from typing import Final, Literal, Protocol, TypeAlias, TypeVar

import numpy as np

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.retargeting.known_gaps import NO_GAPS
from smooth_operator.types import HandFrame, Side

Clock: TypeAlias = Callable[[], float]
"""Seconds that never go back: ``time.perf_counter``."""

LATEST_STAMP_S: Final = 1e11
"""Stamps are seconds and below this, the year 5138 of Unix time [s]; larger ones are of another
unit."""
JUMP_S: Final = 1.0
"""Jump of the stamps from which on the tracker was restarted or set its clock [s]: back from the
newest stamp, or ahead of the time since its reception."""


_GAPS: Final = 5
"""Number of times between frames for the median, a tracker's period; few, since trackers change."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """A received frame.

    Attributes:
        frame: the hand; its stamp is by the tracker's clock, or ``received`` if it had none.
        received: time of reception of its last byte, by the loop's clock [s].
        session: number of the tracker's start; stamps of another session may restart. It
            increases with each start that the source reports, and with each jump of the stamps
            (``JUMP_S``).
        speed: seconds of its stamps per second of the loop's clock, which differ for a recording
            that is played slower or faster.
    """

    frame: HandFrame
    received: float
    session: int = 0
    speed: float = 1.0

    def __post_init__(self) -> None:
        if self.frame.stamp is None:
            object.__setattr__(self, "frame", replace(self.frame, stamp=self.received))

    @property
    def stamp(self) -> float:
        """The frame's stamp [s]."""
        return self.frame.time


class Mailbox:
    """The newest frame of each hand; safe for several threads.

    Attributes:
        received: number of posted frames.
        received_of: side -> number of posted frames.
        overwritten: number of frames that were replaced before they were taken.
        stop: emergency stop of the loop that takes the frames, for sources whose operator can press
            one; set by the loop.
        mode: state of that loop, to show to the operator: a ``Mode`` or ``compiling``; empty
            without a loop.
    """

    def __init__(self, clock: Clock = time.perf_counter) -> None:
        self.clock = clock
        self.stop: Callable[[], None] = lambda: None
        self.mode: Callable[[], str] = lambda: ""
        self.received = 0
        self.received_of: Counter[Side] = Counter()
        self.overwritten = 0
        self._newest: dict[Side, Arrival] = {}
        self._latest: dict[Side, float] = {}
        self._gaps: dict[Side, deque[float]] = {}
        self._sessions: dict[Side, _Sessions] = {}
        self._woken = False
        self._arrived = threading.Condition()

    def post(
        self,
        frame: HandFrame,
        *,
        received: float | None = None,
        session: int = 0,
        speed: float = 1.0,
    ) -> Arrival:
        """Post a frame.

        Args:
            received: time of reception [s]; by default now.
            session: number of the tracker's start, as far as the source knows.
            speed: see ``Arrival``.

        Returns:
            the arrival in the mailbox.
        """
        at = self.clock() if received is None else received
        with self._arrived:
            self.received += 1
            self.received_of[frame.side] += 1
            self.overwritten += frame.side in self._newest
            sessions = self._sessions.setdefault(frame.side, _Sessions())
            stamp = at if frame.stamp is None else frame.stamp
            arrival = Arrival(frame, at, sessions.of(stamp, at, session), speed)
            self._newest[frame.side] = arrival
            if frame.side in self._latest:
                gaps = self._gaps.setdefault(frame.side, deque(maxlen=_GAPS))
                gaps.append(at - self._latest[frame.side])
            self._latest[frame.side] = at
            self._arrived.notify_all()
        return arrival

    def take(self, side: Side) -> Arrival | None:
        """Take the newest frame of a hand; None if none came since the last call."""
        with self._arrived:
            return self._newest.pop(side, None)

    def newest(self, side: Side) -> Arrival | None:
        """The arrival that ``take`` would return, left in the mailbox."""
        with self._arrived:
            return self._newest.get(side)

    def following(self, side: Side) -> float | None:
        """Expected time of the next frame of a hand, from the last few [s]; None before there are
        two."""
        with self._arrived:
            gaps = self._gaps.get(side)
            return self._latest[side] + median(gaps) if gaps else None

    def sleep(self, timeout: float, received: int | None = None) -> None:
        """Sleep up to a timeout, until ``wake``, or until a frame is posted.

        Args:
            timeout: longest time [s].
            received: value of ``received`` above which a frame ends the sleep; None for no frame.
        """
        with self._arrived:
            self._arrived.wait_for(
                lambda: self._woken or (received is not None and self.received != received),
                max(timeout, 0.0),
            )
            self._woken = False

    def wait(self, sides: Collection[Side], timeout: float) -> bool:
        """Sleep until a frame of one of some hands is here, up to a timeout [s].

        Returns:
            True if there is a frame.
        """
        with self._arrived:
            self._arrived.wait_for(lambda: self._woken or self._has(sides), timeout)
            self._woken = False
            return self._has(sides)

    def wake(self) -> None:
        """End the current or the next ``wait`` or ``sleep`` without a frame."""
        with self._arrived:
            self._woken = True
            self._arrived.notify_all()

    def _has(self, sides: Collection[Side]) -> bool:
        return any(side in self._newest for side in sides)


class _Sessions:
    """Starts of the tracker of one hand: those that its source reports, and jumps of the stamps."""

    def __init__(self) -> None:
        self._reported: int | None = None
        self._jumps = 0
        # The newest, so that one late frame does not make the next one look like a restart.
        self._stamp = self._received = 0.0

    def of(self, stamp: float, received: float, reported: int) -> int:
        """The session of a frame."""
        if not abs(stamp) < LATEST_STAMP_S:
            return reported + self._jumps  # it is refused, and nothing follows from it
        ahead = stamp - self._stamp
        jumped = ahead < -JUMP_S or ahead - (received - self._received) > JUMP_S
        if reported != self._reported:
            self._reported = reported
        elif jumped:
            self._jumps += 1
        elif ahead < 0:
            return reported + self._jumps
        self._stamp, self._received = stamp, received
        return reported + self._jumps


@dataclass(frozen=True)
class SourceHealth:
    """Health of a source.

    Attributes:
        state: ``waiting`` for its tracker; ``running``; ``ended`` without further frames;
            ``failed`` with an error.
        detail: a sentence for a person: the address on which it listens, or the error.
    """

    state: Literal["waiting", "running", "ended", "failed"]
    detail: str = ""


class LiveSource(Protocol):
    """A source of frames."""

    @property
    def label(self) -> str:
        """Name for a person, in a few words."""

    def prepare(self) -> None:
        """Open everything that ``start`` needs, before anything slow is done; optional.

        Raises:
            SourceError, RecordingError, MissingExtraError, ConfigError: as ``start``.
        """

    def start(self, mailbox: Mailbox) -> None:
        """Begin to post frames, and return immediately.

        Raises:
            SourceError: it can't be opened: no such camera, a port in use.
            MissingExtraError: a library that it needs is not installed.
        """

    def stop(self) -> None:
        """Stop posting and close everything; a second call does nothing."""

    def health(self) -> SourceHealth:
        """Health of the source, at any time, from any thread."""


def source_gaps(source: LiveSource) -> Mapping[str, float]:
    """Gaps that a source's tracker leaves where thumb and finger touch, finger -> gap [palm
    lengths]: its attribute ``pinch_gaps``, which only a source with known gaps has."""
    gaps: Mapping[str, float] = getattr(source, "pinch_gaps", NO_GAPS)
    return gaps


class ThreadedSource(ABC):
    """A source with its own thread, on which a subclass's ``run`` runs.

    Subclasses are frozen dataclasses of settings; their state is in ``Running``.
    """

    @property
    @abstractmethod
    def label(self) -> str:
        """Name for a person, in a few words."""

    @abstractmethod
    def run(self, running: Running) -> None:
        """Post frames until ``running.stopping`` is set, or there are no more.

        An exception becomes the health ``failed``, with the error as the detail.
        """

    def open(self) -> None:  # noqa: B027  (most sources need nothing before their thread)
        """Get hold of what is needed, before the thread starts; errors reach the caller."""

    def prepare(self) -> None:
        """Open it ahead of ``start``; see ``LiveSource``."""
        self.open()
        object.__setattr__(self, "_prepared", True)

    def start(self, mailbox: Mailbox) -> None:
        """Begin; see ``LiveSource``."""
        if not self.__dict__.pop("_prepared", False):
            self.open()
        running = Running(mailbox, self.label)
        # The settings are frozen, the state of a running source is not.
        object.__setattr__(self, "_running", running)
        running.begin(self.run)

    def stop(self) -> None:
        """Stop; see ``LiveSource``."""
        running: Running | None = getattr(self, "_running", None)
        if running is not None:
            running.end()

    def health(self) -> SourceHealth:
        """Health of the source; see ``LiveSource``."""
        running: Running | None = getattr(self, "_running", None)
        return SourceHealth("waiting", "not started") if running is None else running.health


class Running:
    """A started source: its thread, its mailbox, its health.

    Attributes:
        mailbox: mailbox of the frames.
        stopping: event that ends the source; ``stopping.wait(seconds)`` sleeps.
        health: may be replaced by the thread at any time.
    """

    def __init__(self, mailbox: Mailbox, label: str) -> None:
        self.mailbox = mailbox
        self.stopping = threading.Event()
        self.health = SourceHealth("waiting")
        self._label = label
        self._thread: threading.Thread | None = None

    def begin(self, run: Callable[[Running], None]) -> None:
        """Run on a thread."""

        def guarded() -> None:
            try:
                # What a message holds may be of any size; what overflows is refused, without a word
                # of NumPy's on the terminal.
                with np.errstate(all="ignore"):
                    run(self)
            except SmoothOperatorError as error:
                self.health = SourceHealth("failed", str(error))
            except Exception as error:  # a library's: the loop must go on, and say what happened
                self.health = SourceHealth("failed", f"{type(error).__name__}: {error}")
            else:
                if self.health.state != "failed":
                    self.health = SourceHealth("ended", self.health.detail)
            self.mailbox.wake()

        self._thread = threading.Thread(target=guarded, name=f"source {self._label}", daemon=True)
        self._thread.start()

    def end(self, timeout: float = 5.0) -> None:
        """Request the end, and wait for it up to a timeout [s]."""
        self.stopping.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout)


_Item = TypeVar("_Item")


def on_time(
    due: Iterable[tuple[float, _Item]], clock: Clock, stopping: threading.Event
) -> Iterator[tuple[float, _Item]]:
    """Yield items when they are due; late ones immediately, in order.

    Args:
        due: (time since the start [s], item), times not decreasing.
        clock: monotonic clock [s]. The start is the time of the first item, which may take a while.

    Yields:
        delay of the item [s], and the item.
    """
    items = iter(due)
    first = list(itertools.islice(items, 1))
    start = clock()
    for moment, item in itertools.chain(first, items):
        left = start + moment - clock()
        if stopping.wait(left) if left > 0.0 else stopping.is_set():
            return
        yield clock() - (start + moment), item
