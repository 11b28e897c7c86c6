"""The thread that writes a session to the disk, so that the loop never waits for it."""

from __future__ import annotations

import contextlib
import datetime
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import OutputError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.recording.log import LogWriter
from smooth_operator.teleop.recording.log_types import LoopState
from smooth_operator.teleop.recording.robot_points import landmark_keypoints
from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.teleop.sinks.stamps import StampMap
from smooth_operator.teleop.sinks.tick import Driver, Tick
from smooth_operator.types import JointCommand, Side, Status

_CHUNK_BYTES: Final = 256 * 1024
_PERIOD_S: Final = 0.5
"""How often ticks are written, at least [s]; a thread that wakes for each takes time from the
loop."""
_AT_ONCE: Final = 200
"""Ticks that are written before that time is over."""
_TURN: Final = 4
"""Ticks that are encoded before the loop gets the interpreter, should it wait: 0.1 ms."""
_END_S: Final = 20.0
"""How long the end of a recording may take: a buffer to write, two files to end [s]."""


class Recorder:
    """Writes ticks on its own thread, until it is closed or the disk fails.

    Args:
        files: side -> file.
        hands: side -> robot hand, to be drawn.
        config: the resolved configuration, for every file.
        overwrite: replace files that stand there.
        flush_s: how long a tick may wait for the disk [s].
        buffer: ticks that may wait.

    Attributes:
        dropped: ticks that were taken, or found no room, and are not in the files; while the
            recorder runs those that still wait count as recorded.
        empty: files in which nothing is, because the disk failed before.

    Raises:
        OutputError: a file can't be created; then none is left behind.
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
        self._taken = 0  # ticks that went into the buffer
        self._failed = False
        self._missed = 0  # since the last tick that found room
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
                for log in self._logs.values():
                    log.discard()
                if not existed:
                    path.unlink(missing_ok=True)
                raise
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)
        self._thread.start()

    def put(self, tick: Tick) -> None:
        """Have a tick written.

        Raises:
            OutputError: the disk failed; said once, and from then on ticks are only counted.
        """
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
                    f"{self._missed} ticks before this one are not recorded: the disk is too slow"
                )
                self._missed = 0
            if self._stalled:
                self._events.append(f"no command for {self._stalled:.2f} s: the loop stood still")
                self._stalled = 0.0
            self._waiting.append(tick)
            self._taken += 1
            if len(self._waiting) >= self._lot:
                self._change.notify_all()

    def silence(self, seconds: float) -> None:
        """Note that no command came for so long [s]."""
        with self._change:
            self._stalled = seconds

    def close(self) -> None:
        """Write all that waits, and end the files.

        Raises:
            OutputError: the disk failed.
            SinkError: the disk takes too long; the thread goes on as long as the process lives.
        """
        with self._change:
            self._ending = True
            self._change.notify_all()
        self._thread.join(_END_S)
        if self._thread.is_alive():
            raise SinkError(
                f"the recording is not yet written after {_END_S:.0f} s: the disk is too slow; it "
                "is whole up to the last flush"
            )
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _run(self) -> None:
        try:
            self._write()
        except Exception as error:  # of the disk, or a tick that no log can hold
            logs = self._logs.values()
            with self._change:
                self._failed = True  # takes no more
            self.empty += [log.path for log in logs if not log.give_up()]
            with self._change:
                # those that wait, those that were being written, those in a chunk that was lost
                self.dropped += self._taken - sum(log.kept for log in logs)
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
                for log in self._logs.values():
                    log.flush()
                flushed = time.monotonic()
            if ending and not ticks:
                for log in self._logs.values():
                    log.close()
                return


class _HandLog:
    """The log of one hand."""

    def __init__(
        self, path: Path, hand: Hand, config: Mapping[str, Any], *, overwrite: bool
    ) -> None:
        self.path = path
        # Flushed from outside, for both hands together and also where nothing comes any more.
        self._log = LogWriter(
            path,
            overwrite=overwrite,
            chunk_bytes=_CHUNK_BYTES,
            flush_seconds=3600.0,
            keypoints=landmark_keypoints(hand),
        )
        started = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        meta = f'{{"started":"{started}","clock":"{time.perf_counter():.6f}"}}'
        self._log.write_origin({"name": path.stem, "meta": meta})
        self._log.write_config(config)
        self._stamps = StampMap()
        self._driver: Driver | None = None
        self._state: HandState | None = None
        self._pending = False

    def write(self, tick: Tick, events: tuple[str, ...]) -> None:
        """Append a tick."""
        stamp, frame = self._stamps(tick)
        if frame is not None:
            self._log.write_hand(frame, stamp)
        if tick.driver is not None and tick.driver is not self._driver:
            self._driver = tick.driver
            self._log.write_method(
                stamp, tick.driver.method, tick.driver.preset, tick.driver.config
            )
        if tick.state is not None and tick.state is not self._state:
            self._state = tick.state
            self._log.write_state(tick.state)
        arrival = tick.arrival
        self._log.write_command(
            JointCommand(tick.command.positions, tick.command.names, stamp),
            # Where no frame is answered none was bad; what the loop did then is its mode.
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
        """Bring what is pending to the disk, where it outlives a power cut as well."""
        if self._pending:
            self._log.flush(sync=True)
            self._pending = False

    def close(self) -> None:
        """End the file."""
        self._log.close()

    @property
    def kept(self) -> int:
        """Ticks that are in the file."""
        return self._log.commands_flushed

    def give_up(self) -> int:
        """Save what can be saved, after an error; the number of ticks in the file."""
        with contextlib.suppress(OutputError):
            self._log.close()
        return self.kept

    def discard(self) -> None:
        """Take the file away, since its like for the other hand can't be written."""
        self._log.close()
        self.path.unlink(missing_ok=True)
