"""Base class of live sources, and the mailbox that holds the newest frame of each hand.

A source runs on its own thread and posts frames into a mailbox with one place for each hand. A new
frame overwrites one that was not taken, so the loop always uses the newest.
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
"""Monotonic clock [s], such as ``time.perf_counter``."""

LATEST_STAMP_S: Final = 1e11
"""Largest valid stamp [s], the year 5138 in Unix time; larger ones are in another unit."""
JUMP_S: Final = 1.0
"""Jump of the stamps at which a tracker counts as restarted [s]: backward from the newest stamp, or
forward by more than the time since its reception."""

_GAPS: Final = 5  # times between frames for the median, the period of a tracker


@dataclass(frozen=True, eq=False)
class Arrival:
    """A frame that has arrived from a source, with the time of its arrival.

    Attributes:
        frame: the hand; its stamp is by the tracker's clock, or ``received`` if it had none.
        received: time of reception of its last byte, by the loop's clock [s].
        session: number of the tracker's session; its stamps may restart with each. A session begins
            with each start that the source reports, and with each jump of the stamps (``JUMP_S``).
        speed: seconds of its stamps per second of the loop's clock; differs from 1 for a recording
            that is played at another speed.
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
    """Passes the newest frame of each hand from the source to the loop; thread-safe.

    Attributes:
        received: number of posted frames.
        received_of: side -> number of posted frames.
        overwritten: number of frames that were replaced before they were taken.
        stop: emergency stop of the loop, for sources with a stop button; set by the loop.
        mode: function that returns the state of the loop: a ``Mode``, ``compiling``, or an empty
            string without a loop.
        see: function that takes each posted frame and its time of reception [s], such as for
            pinches; set by a run.
        bindings: input of the operator, such as ``button:a``, -> its action; set by a run.
        press: function that carries out the action of an input; set by a run.
        complete: function that completes each frame before it is posted, given its time of
            reception [s]; set by ``CombinedSource``.
    """

    def __init__(self, clock: Clock = time.perf_counter) -> None:
        self.clock = clock
        self.stop: Callable[[], None] = lambda: None
        self.mode: Callable[[], str] = lambda: ""
        self.see: Callable[[HandFrame, float], None] = lambda frame, received: None
        self.bindings: Mapping[str, str] = {}
        self.press: Callable[[str], None] = lambda source: None
        self.complete: Callable[[HandFrame, float], HandFrame] = lambda frame, received: frame
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
        """Posts a frame and returns its arrival; see ``Arrival`` for the arguments."""
        at = self.clock() if received is None else received
        frame = self.complete(frame, at)
        self.see(frame, at)
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
        """Takes the newest frame of a hand; None if no frame has arrived since the last call."""
        with self._arrived:
            return self._newest.pop(side, None)

    def newest(self, side: Side) -> Arrival | None:
        """Returns the frame that ``take`` would return, but leaves it in the mailbox."""
        with self._arrived:
            return self._newest.get(side)

    def following(self, side: Side) -> float | None:
        """Time at which a hand's next frame is expected [s]; None before the second frame."""
        with self._arrived:
            gaps = self._gaps.get(side)
            return self._latest[side] + median(gaps) if gaps else None

    def sleep(self, timeout: float, received: int | None = None) -> None:
        """Sleeps until ``wake`` is called, at most for a timeout [s].

        Args:
            received: last known number of posted frames; the sleep also ends as soon as it differs.
                None ignores frames.
        """
        with self._arrived:
            self._arrived.wait_for(
                lambda: self._woken or (received is not None and self.received != received),
                max(timeout, 0.0),
            )
            self._woken = False

    def wait(self, sides: Collection[Side], timeout: float) -> bool:
        """Sleeps until a frame of one of the hands arrives, at most for a timeout [s]; True if one
        has arrived."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._woken or self._has(sides), timeout)
            self._woken = False
            return self._has(sides)

    def wake(self) -> None:
        """Ends a current ``wait`` or ``sleep``, or the next one."""
        with self._arrived:
            self._woken = True
            self._arrived.notify_all()

    def _has(self, sides: Collection[Side]) -> bool:
        return any(side in self._newest for side in sides)


class _Sessions:
    """Counts the sessions of one hand's tracker: reported starts, and jumps of the stamps."""

    def __init__(self) -> None:
        self._reported: int | None = None
        self._jumps = 0
        # those of the newest stamp: after one late frame, the next one is not a restart
        self._stamp = self._received = 0.0

    def of(self, stamp: float, received: float, reported: int) -> int:
        """Number of the session of a frame."""
        if not abs(stamp) < LATEST_STAMP_S:
            return reported + self._jumps  # the loop refuses the frame
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
        state: ``waiting`` for its tracker, ``running``, ``ended``, or ``failed`` with an error.
        detail: a sentence for the user, for example with the address or the error.
    """

    state: Literal["waiting", "running", "ended", "failed"]
    detail: str = ""


class LiveSource(Protocol):
    """A live source of hand frames: a tracker, a recording or another program."""

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""

    def prepare(self) -> None:
        """Opens everything that ``start`` needs; raises the same errors. Calling it is optional.

        Errors are thus reported before the slow work of a run.
        """

    def start(self, mailbox: Mailbox) -> None:
        """Starts to post frames, and returns immediately.

        Raises:
            SourceError: it can't be opened, such as a missing camera or a port in use.
            MissingExtraError: a library that it needs is not installed.
        """

    def stop(self) -> None:
        """Stops posting and closes everything; a second call does nothing."""

    def health(self) -> SourceHealth:
        """Current health of the source; safe at any time and from any thread."""


def source_gaps(source: LiveSource) -> Mapping[str, float]:
    """Maps each finger to its distance from the thumb that the tracker reports in a pinch [palm
    lengths].

    Only a source with known gaps has the attribute ``pinch_gaps``.
    """
    gaps: Mapping[str, float] = getattr(source, "pinch_gaps", NO_GAPS)
    return gaps


class ThreadedSource(ABC):
    """Base class of sources whose method ``run`` runs on its own thread.

    Subclasses are frozen dataclasses of settings; their state is in ``Running``.
    """

    @property
    @abstractmethod
    def label(self) -> str:
        """Short human-readable name of the source."""

    @abstractmethod
    def run(self, running: Running) -> None:
        """Posts frames until ``running.stopping`` is set, or until the last frame.

        If it raises, the health becomes ``failed`` with the error as the detail.
        """

    def open(self) -> None:  # noqa: B027  (most sources need nothing before their thread)
        """Opens everything that the thread needs. The caller receives the errors."""

    def prepare(self) -> None:
        """Opens the source before ``start``; see ``LiveSource``."""
        self.open()
        object.__setattr__(self, "_prepared", True)

    def start(self, mailbox: Mailbox) -> None:
        """Starts the thread; see ``LiveSource``."""
        if not self.__dict__.pop("_prepared", False):
            self.open()
        running = Running(mailbox, self.label)
        # The settings are frozen, unlike the state of a running source.
        object.__setattr__(self, "_running", running)
        running.begin(self.run)

    def stop(self) -> None:
        """Stops the thread; see ``LiveSource``."""
        running: Running | None = getattr(self, "_running", None)
        if running is not None:
            running.end()

    def health(self) -> SourceHealth:
        """Health of the source; see ``LiveSource``."""
        running: Running | None = getattr(self, "_running", None)
        return SourceHealth("waiting", "not started") if running is None else running.health


class Running:
    """State of a source that was started: its thread, its mailbox and its health.

    Attributes:
        stopping: event that ends the source; ``stopping.wait(seconds)`` sleeps.
        health: health, which the thread may replace.
    """

    def __init__(self, mailbox: Mailbox, label: str) -> None:
        self.mailbox = mailbox
        self.stopping = threading.Event()
        self.health = SourceHealth("waiting")
        self._label = label
        self._thread: threading.Thread | None = None

    def begin(self, run: Callable[[Running], None]) -> None:
        """Starts the thread."""

        def guarded() -> None:
            try:
                # Numbers of a message may overflow. The readers refuse them, and NumPy's warnings
                # would disturb the terminal.
                with np.errstate(all="ignore"):
                    run(self)
            except SmoothOperatorError as error:
                self.health = SourceHealth("failed", str(error))
            except Exception as error:  # of a library: the loop must go on and show it
                self.health = SourceHealth("failed", f"{type(error).__name__}: {error}")
            else:
                if self.health.state != "failed":
                    self.health = SourceHealth("ended", self.health.detail)
            self.mailbox.wake()

        self._thread = threading.Thread(target=guarded, name=f"source {self._label}", daemon=True)
        self._thread.start()

    def end(self, timeout: float = 5.0) -> None:
        """Asks the thread to end, and waits for it up to a timeout [s]."""
        self.stopping.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout)


_Item = TypeVar("_Item")


def on_time(
    due: Iterable[tuple[float, _Item]], clock: Clock, stopping: threading.Event
) -> Iterator[tuple[float, _Item]]:
    """Yields each item when it is due, with its delay [s]; late items immediately.

    Args:
        due: (time since the start [s], item) in order. The start is the time at which the first
            item becomes available.
    """
    items = iter(due)
    first = list(itertools.islice(items, 1))
    start = clock()
    for moment, item in itertools.chain(first, items):
        left = start + moment - clock()
        if stopping.wait(left) if left > 0.0 else stopping.is_set():
            return
        yield clock() - (start + moment), item
