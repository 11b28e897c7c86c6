"""Recording a session: every tick into the project's own MCAP log, one for each hand."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.recorder import Recorder
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.take_names import is_folder, next_part, take_paths
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side


@dataclass(frozen=True)
class RecordSink(Sink):
    """An MCAP log of a session: frames, commands, modes, events, timing of every tick.

    One file for each hand: ``NAME.mcap``, or ``NAME.right.mcap`` and ``NAME.left.mcap`` where there
    are two. The file is whole up to the last flush, whatever becomes of the process. Its stamps are
    by the loop's clock, so that commands between two frames have their place; the tracker's own
    stamp of each frame is recorded too.

    Opened again after a failure, it goes on in a new file and touches no earlier one.

    Attributes:
        path: a file that ends in ``.mcap``, or a folder, in which recordings are numbered
            ``take-001.mcap``, ``take-002.mcap``, ...
        overwrite: replace a named file that stands there already.
        flush_s: how long a tick may wait for the disk [s].
        buffer: ticks that wait while the disk is slow; those beyond are dropped, and counted.

    Raises:
        ConfigError: a setting is out of its range, or the file is no ``.mcap``.
    """

    path: Path
    overwrite: bool = False
    flush_s: float = 0.5
    buffer: int = 4000

    observes: ClassVar[bool] = True
    """It moves nothing, and gets its ticks after the sinks that do."""

    # what changes, in addition to the frozen settings
    _recorder: Recorder | None = field(default=None, init=False, repr=False, compare=False)
    _history: tuple[Path, ...] = field(default=(), init=False, repr=False, compare=False)
    _lost: int = field(default=0, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        is_folder(self.path)
        if not 0.01 <= self.flush_s <= 60.0:
            raise ConfigError(f"record: flush_s must be 0.01 to 60 s, not {self.flush_s}")
        if self.buffer < 1:
            raise ConfigError(f"record: buffer must be at least 1 tick, not {self.buffer}")

    @property
    def label(self) -> str:
        """``record`` and where to."""
        return f"record {self.path}"

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that it has written, in order."""
        return self._history

    @property
    def note(self) -> str:
        """What a person should know: ticks that are missing from the files."""
        lost = self._lost + (0 if self._recorder is None else self._recorder.dropped)
        if not lost:
            return ""
        ticks = "1 tick is" if lost == 1 else f"{lost} ticks are"
        return f"{ticks} not recorded: the disk was too slow, or failed"

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Refuse a file that stands there, or a folder that can't be made; see
        ``SinkRunner.check``."""
        for file in take_paths(self.path, list(hands), overwrite=self.overwrite).values():
            if not os.access(file.parent, os.W_OK):
                why = errno.EACCES if file.parent.is_dir() else errno.ENOENT
                raise output_error(file, OSError(why, os.strerror(why)))

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Create the files; see ``Sink``."""
        if self._recorder is not None:
            raise SinkError(f"{self.label}: it is open already")
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
        self._set("_recorder", recorder)
        self._set("_history", (*self._history, *files.values()))

    def send(self, tick: Tick) -> None:
        """Put a tick into the buffer.

        Raises:
            OutputError: the disk is full or gone; once.
        """
        if self._recorder is None:
            raise SinkError(f"{self.label}: it is not open")
        self._recorder.put(tick)

    def stalled(self, seconds: float) -> None:
        """Put the silence into the recording, as an event of the next tick."""
        if self._recorder is not None:
            self._recorder.silence(seconds)

    def close(self) -> None:
        """Write what is pending, and end the files.

        Raises:
            OutputError: they could not be ended; what was flushed stays readable.
        """
        recorder = self._recorder
        if recorder is None:
            return
        self._set("_recorder", None)
        try:
            recorder.close()
        finally:
            self._set("_lost", self._lost + recorder.dropped)
            for path in recorder.empty:  # broke off before anything was in it
                with contextlib.suppress(OSError):
                    path.unlink()
            self._set("_history", tuple(p for p in self._history if p not in recorder.empty))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)
