"""Records a session: writes every tick to MCAP logs, one for each hand."""

from __future__ import annotations

import contextlib
import datetime
import errno
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, OutputError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.teleop.recording import LogWriter
from smooth_operator.teleop.recording.messages import LoopState, landmark_keypoints
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Driver, HandState, StampMap, Tick
from smooth_operator.types import JointCommand, Side, Status


@dataclass(frozen=True)
class RecordSink(Sink):
    """Sink that records a session as MCAP logs: frames, commands, modes, events, timing of every
    tick.

    There is one file for each hand: ``NAME.mcap``, or ``NAME.right.mcap`` and ``NAME.left.mcap``
    for two. The file is complete up to the last flush, even after a crash. Its stamps are from the
    loop's clock, also for commands without a frame. The tracker's stamp of each frame is recorded
    too.

    After a failure, the recording continues in a new file and leaves earlier ones unchanged.

    Attributes:
        path: a file that ends in ``.mcap``, or a folder, in which recordings are numbered
            ``take-001.mcap``, ``take-002.mcap``, ...
        overwrite: replace an existing file of that name.
        flush_s: longest time that a tick waits for the disk [s].
        buffer: largest number of ticks that wait for a slow disk; further ones are dropped and
            counted.

    Raises:
        ConfigError: a setting is out of its range, or the file is not an ``.mcap`` file.
    """

    path: Path
    overwrite: bool = False
    flush_s: float = 0.5
    buffer: int = 4000

    observes: ClassVar[bool] = True

    _recorder: Recorder | None = field(default=None, init=False, repr=False, compare=False)
    _history: tuple[Path, ...] = field(default=(), init=False, repr=False, compare=False)
    _lost: int = field(default=0, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        is_folder(self.path)
        check_range("record: flush_s", self.flush_s, 0.01, 60.0, "s")
        if self.buffer < 1:
            raise ConfigError(f"record: buffer must be at least 1 tick, not {self.buffer}")

    @property
    def label(self) -> str:
        """The word ``record`` and the file or folder, for display."""
        return f"record {self.path}"

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that this sink has written, in order."""
        return self._history

    @property
    def note(self) -> str:
        """Warning about ticks that are missing from the files."""
        lost = self._lost + (0 if self._recorder is None else self._recorder.dropped)
        if not lost:
            return ""
        ticks = "1 tick is" if lost == 1 else f"{lost} ticks are"
        return f"{ticks} not recorded, because the disk was too slow or failed"

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Refuses an existing file, or a folder that can't be created; see ``Sink``."""
        for file in take_paths(self.path, list(hands), overwrite=self.overwrite).values():
            if not os.access(file.parent, os.W_OK):
                why = errno.EACCES if file.parent.is_dir() else errno.ENOENT
                raise output_error(file, OSError(why, os.strerror(why)))

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Creates the files; see ``Sink``."""
        if self._recorder is not None:
            raise SinkError(f"{self.label}: the sink is already open")
        sides = list(hands)
        if self._history:
            files = next_part(self.path, sides)
        else:
            files = take_paths(self.path, sides, overwrite=self.overwrite)
        recorder = Recorder(
            files,
            hands,
            config,
            overwrite=self.overwrite and not self._history,
            flush_s=self.flush_s,
            buffer=self.buffer,
        )
        self._set(_recorder=recorder, _history=(*self._history, *files.values()))

    def send(self, tick: Tick) -> None:
        """Puts a tick into the buffer. OutputError if the disk is full or gone; raised once."""
        if self._recorder is None:
            raise SinkError(f"{self.label}: the sink is not open")
        self._recorder.put(tick)

    def stalled(self, seconds: float) -> None:
        """Records a time without commands, as an event of the next tick."""
        if self._recorder is not None:
            self._recorder.silence(seconds)

    def close(self) -> None:
        """Writes pending ticks, and finishes the files. OutputError if the files could not be
        finished; parts that were flushed stay readable."""
        recorder = self._recorder
        if recorder is None:
            return
        self._set(_recorder=None)
        try:
            recorder.close()
        finally:
            self._set(_lost=self._lost + recorder.dropped)
            for path in recorder.empty:
                with contextlib.suppress(OSError):
                    path.unlink()
            self._set(_history=tuple(p for p in self._history if p not in recorder.empty))


_CHUNK_BYTES: Final = 256 * 1024
_PERIOD_S: Final = 0.5
"""Longest interval at which ticks are written [s]. Waking for each tick would delay the loop."""
_AT_ONCE: Final = 200
"""Number of waiting ticks that are written at once, before the interval is over."""
_TURN: Final = 4
"""Number of ticks to encode before the loop may take the interpreter; this takes 0.6 ms."""
_END_S: Final = 20.0
"""Longest time to finish a recording, that is, write the buffer and close two files [s]."""


@dataclass(frozen=True)
class TakeSink(RecordSink):
    """Records a take. Stores the configuration at the take's start, which may differ from that at
    the run's start."""

    configuration: Callable[[], Mapping[str, Any]] = dict

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Creates the files."""
        super().open(hands, {**config, **self.configuration()})


class Recorder:
    """Writes ticks on its own thread, until it is closed or the disk fails.

    Args:
        files: side -> file.
        hands: side -> robot hand, for the drawing.
        config: the resolved configuration, for every file.
        overwrite: True to replace existing files.
        flush_s: longest time that a tick waits for the disk [s].
        buffer: largest number of waiting ticks.

    Attributes:
        dropped: number of ticks that are missing from the files. While the recorder runs, waiting
            ticks count as recorded.
        empty: files without any command, because the disk failed before the first one.

    Raises:
        OutputError: a file can't be created; no file is left behind.
    """

    def __init__(
        self,
        files: Mapping[Side, Path],
        hands: Mapping[Side, Hand],
        config: Mapping[str, Any],
        *,
        overwrite: bool,
        flush_s: float,
        buffer: int,
    ) -> None:
        self.dropped = 0
        self.empty: list[Path] = []
        self._flush_s, self._buffer = flush_s, buffer
        self._lot = max(1, min(_AT_ONCE, buffer // 2))
        self._waiting: deque[Tick] = deque()
        self._events: list[str] = []
        self._buffered = 0  # number of ticks put into the buffer
        self._failed = False
        self._missed = 0  # number of dropped ticks since the last buffered one
        self._stalled = 0.0
        self._error: Exception | None = None
        self._ending = False
        self._change = threading.Condition()
        self._logs: dict[Side, _HandLog] = {}
        for side, path in files.items():
            existed = path.exists()
            try:
                self._logs[side] = _HandLog(path, hands[side], config, overwrite=overwrite)
            except Exception:
                for begun in self._logs.values():
                    begun.log.close()
                    begun.log.path.unlink(missing_ok=True)
                if not existed:
                    path.unlink(missing_ok=True)
                raise
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)
        self._thread.start()

    def put(self, tick: Tick) -> None:
        """Puts a tick into the buffer. OutputError if the disk failed; raised once, then ticks are
        only counted."""
        with self._change:
            error, self._error = self._error, None
            if error is not None:
                raise error  # and the caller counts the tick
            if self._failed or len(self._waiting) >= self._buffer:
                self.dropped += 1
                self._missed += 1
                return
            if self._missed:
                self._events.append(
                    f"{self._missed} ticks before this one were not recorded: the disk is too slow"
                )
                self._missed = 0
            if self._stalled:
                self._events.append(f"no command for {self._stalled:.2f} s: the loop was stalled")
                self._stalled = 0.0
            self._waiting.append(tick)
            self._buffered += 1
            if len(self._waiting) >= self._lot:
                self._change.notify_all()

    def silence(self, seconds: float) -> None:
        """Notes a time without commands [s], to be recorded."""
        with self._change:
            self._stalled = seconds

    def close(self) -> None:
        """Writes waiting ticks, and finishes the files.

        Raises:
            OutputError: the disk failed.
            SinkError: the disk takes too long; the thread continues to write.
        """
        with self._change:
            self._ending = True
            self._change.notify_all()
        self._thread.join(_END_S)
        if self._thread.is_alive():
            raise SinkError(
                f"the recording is not yet written after {_END_S:.0f} s: the disk is too "
                "slow; the recording is complete up to the last flush"
            )
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _run(self) -> None:
        try:
            self._write()
        except Exception as error:  # of the disk, or of a tick that no log can hold
            logs = list(self._logs.values())
            with self._change:
                self._failed = True
            for each in logs:
                with contextlib.suppress(OutputError):
                    each.log.close()
            self.empty += [each.log.path for each in logs if not each.log.commands_flushed]
            with self._change:
                # waiting ticks, and those in a chunk that was lost
                self.dropped += self._buffered - sum(each.log.commands_flushed for each in logs)
                self._waiting.clear()
                self._error = error

    def _write(self) -> None:
        flushed = time.monotonic()
        while True:
            due = max(flushed + self._flush_s - time.monotonic(), 0.0)
            with self._change:
                self._change.wait_for(
                    lambda: self._ending or len(self._waiting) >= self._lot, min(due, _PERIOD_S)
                )
                ticks, ending = list(self._waiting), self._ending
                self._waiting.clear()
                events, self._events = tuple(self._events), []
            for position, tick in enumerate(ticks):
                if tick.side in self._logs:
                    self._logs[tick.side].write(tick, events if position == 0 else ())
                if position % _TURN == 0:
                    time.sleep(0)
            if time.monotonic() - flushed >= self._flush_s:
                for each in self._logs.values():
                    each.flush()
                flushed = time.monotonic()
            if ending and not ticks:
                for each in self._logs.values():
                    each.log.close()
                return


class _HandLog:
    """The log of one hand."""

    def __init__(
        self, path: Path, hand: Hand, config: Mapping[str, Any], *, overwrite: bool
    ) -> None:
        # The recorder flushes both hands together, also when no ticks come any more.
        self.log = LogWriter(
            path,
            overwrite=overwrite,
            chunk_bytes=_CHUNK_BYTES,
            flush_seconds=3600.0,
            keypoints=landmark_keypoints(hand),
        )
        started = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        meta = f'{{"started":"{started}","clock":"{time.perf_counter():.6f}"}}'
        self.log.write_origin({"name": path.stem, "meta": meta})
        self.log.write_config(config)
        self._stamps = StampMap()
        self._driver: Driver | None = None
        self._state: HandState | None = None
        self._pending = False

    def write(self, tick: Tick, events: tuple[str, ...]) -> None:
        stamp, frame = self._stamps(tick)
        if frame is not None:
            self.log.write_hand(frame, stamp)
        if tick.driver is not None and tick.driver is not self._driver:
            self._driver = tick.driver
            self.log.write_method(stamp, tick.driver.method, tick.driver.preset, tick.driver.config)
        if tick.state is not None and tick.state is not self._state:
            self._state = tick.state
            self.log.write_state(tick.state)
        arrival = tick.arrival
        self.log.write_command(
            JointCommand(tick.command.joint_positions, tick.command.joint_names, stamp),
            Status.OK if tick.status is None else tick.status,
            float("nan") if arrival is None else (tick.time - arrival.received) * 1e3,
            tick.stages,
            LoopState(
                number=tick.number,
                mode=tick.mode.value,
                time=tick.time,
                received=None if arrival is None else arrival.received,
                tracker_stamp=None if arrival is None else arrival.stamp,
                session=None if arrival is None else arrival.session,
                tracking_loss=tick.tracking_loss,
                scale=tick.scale,
                events=(*events, *tick.events),
            ),
            tick.wrist,
            tick.arm,
        )
        self._pending = True

    def flush(self) -> None:
        """Write pending messages to the disk, where they survive a power cut."""
        if self._pending:
            self.log.flush(sync=True)
            self._pending = False


SUFFIX = ".mcap"


def is_folder(path: Path) -> bool:
    """True if a path stands for a folder of takes: it is a folder, or has no suffix. ConfigError if
    its suffix is not that of a log."""
    if path.is_dir() or not path.suffix:
        return True
    if path.suffix.lower() != SUFFIX:
        raise ConfigError(
            f"a recording is an MCAP log: expected NAME{SUFFIX} or a folder, not {str(path)!r}"
        )
    return False


def take_paths(path: Path, sides: Sequence[Side], *, overwrite: bool) -> dict[Side, Path]:
    """Paths of the files of a new recording; creates the folder if necessary.

    Args:
        path: see ``is_folder``. In a folder, recordings are named ``take-001.mcap`` and so on.
        sides: hands that are recorded. Two hands have one file each, as in
            ``take-001.right.mcap``.
        overwrite: True if an existing file may be replaced.

    Raises:
        OutputError: a named file exists, or the folder can't be created.
    """
    if not is_folder(path):
        files = _files(path, sides)
        present = [] if overwrite else [file for file in files.values() if file.exists()]
        if present:
            raise OutputError(
                f"can't write {str(present[0])!r}: the file already exists; choose another name, "
                "name a folder, which gets numbered takes, or set overwrite=true"
            )
        return files
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(path, error) from error
    return _first_free(path / f"take-{{:03d}}{SUFFIX}", sides, 1)


def next_part(path: Path, sides: Sequence[Side]) -> dict[Side, Path]:
    """Paths of the files that continue an interrupted recording: the next take, or
    ``NAME.part2.mcap``."""
    if is_folder(path):
        return take_paths(path, sides, overwrite=False)
    return _first_free(path.with_name(f"{path.stem}.part{{}}{path.suffix}"), sides, 2)


def _first_free(pattern: Path, sides: Sequence[Side], start: int) -> dict[Side, Path]:
    number = start
    while True:
        named = pattern.with_name(pattern.name.format(number))
        files = _files(named, sides)
        # A take of one hand and one of both must not share a number either.
        kin = [named, *(named.with_suffix(f".{side}{SUFFIX}") for side in ("right", "left"))]
        if not any(file.exists() for file in (*files.values(), *kin)):
            return files
        number += 1


def _files(path: Path, sides: Sequence[Side]) -> dict[Side, Path]:
    if len(sides) < 2:
        return dict.fromkeys(sides, path)
    return {side: path.with_name(f"{path.stem}.{side}{path.suffix}") for side in sides}
