"""Cuts and marks the log of a recording, and writes the result as a new log."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.episode_files.staging import staged_file
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.io.documents import json_object
from smooth_operator.io.jsonable import to_json
from smooth_operator.teleop.recording.log_reader import DamagedError, log_records, read_log
from smooth_operator.teleop.recording.messages import (
    COMMAND,
    CONFIG,
    HAND,
    LOOP,
    ORIGIN,
    SCHEMAS,
    mcap_records,
    mcap_writer,
    message_class,
)

_TIMED: Final = (HAND, COMMAND)
EDITS: Final = "edits"
"""Key of the history in the ``meta`` of a log's origin."""


@dataclass(frozen=True)
class Edit:
    """How to cut a recording, and the named marks to add to it.

    Times are seconds since its first frame or command.

    Attributes:
        keep: time ranges (from, to) to keep; empty for all.
        drop: time ranges (from, to) to leave out.
        marks: (time, text); each becomes an event of the next command.
    """

    keep: tuple[tuple[float, float], ...] = ()
    drop: tuple[tuple[float, float], ...] = ()
    marks: tuple[tuple[float, str], ...] = ()

    def __post_init__(self) -> None:
        for begin, end in (*self.keep, *self.drop):
            if not begin < end:
                raise ConfigError(f"a time range must end after it begins, not {begin:g}:{end:g}")
        for time, text in self.marks:
            if not self.holds(time):
                raise ConfigError(f"the mark {text!r} at {time:g} s is in a part that is cut out")

    def holds(self, time: float) -> bool:
        """True if the edited log keeps what was recorded at a time [s]."""
        within = [begin <= time < end for begin, end in self.keep]
        return (any(within) or not within) and not any(a <= time < b for a, b in self.drop)


def edit_logs(
    paths: Sequence[Path], outputs: Sequence[Path], edit: Edit
) -> list[Mapping[str, Any]]:
    """Writes edited copies of logs that were recorded together, such as those of two hands.

    The copies keep the timestamps, so a time range that is left out becomes a gap, as if the
    tracker had been lost. The history of the edits is in the ``meta`` of each copy's origin, under
    ``edits``.

    Args:
        paths: the logs, which are not changed. Their common time starts at the earliest frame or
            command.
        outputs: file for the copy of each.

    Returns:
        the entry of each copy in its history: ``source`` and its ``sha256``, ``start`` (the
        timestamp of time 0 [s]), ``keep``, ``drop`` and ``marks``. An end of None is the end of
        the take.

    Raises:
        RecordingError: a file is not a log of this program, or nothing of it is kept; a mark is
            after its end.
        OutputError: a copy would replace its original, or can't be written.
    """
    for path, output in zip(paths, outputs, strict=True):
        read_log(path)  # checks its messages
        if output.exists() and output.samefile(path):
            raise OutputError(
                f"{path}: a recording can't be edited in place; name another --output"
            )
    start = min(_start(path) for path in paths)
    return [_copy(path, to, edit, start) for path, to in zip(paths, outputs, strict=True)]


def _start(path: Path) -> int:
    """Time of the first frame or command [ns]."""
    topics: dict[int, str] = {}
    for record in _readable(path):
        if isinstance(record, mcap_records.Channel):
            topics[record.id] = record.topic
        elif isinstance(record, mcap_records.Message) and topics[record.channel_id] in _TIMED:
            return int(record.log_time)
    raise RecordingError(f"{path}: the log contains neither frames nor commands")


def _readable(path: Path) -> Iterable[Any]:
    """The records of a log up to its end, or to the place where it was cut off."""
    with contextlib.suppress(DamagedError):
        yield from log_records(path)


def _copy(path: Path, output: Path, edit: Edit, start: int) -> Mapping[str, Any]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    keep, drop = ([(a, None if b == math.inf else b) for a, b in x] for x in (edit.keep, edit.drop))
    entry = {
        "source": path.name,
        "sha256": digest,
        "start": start / 1e9,
        "keep": keep,
        "drop": drop,
        "marks": edit.marks,
    }
    marks = sorted(edit.marks)
    schemas: dict[int, int] = {}
    channels: dict[int, tuple[int, str]] = {}
    count = 0
    with staged_file(output) as temporary, temporary.open("wb") as stream:
        writer = mcap_writer.Writer(stream)
        writer.start("", "smooth-operator")
        origin: dict[str, str] = {"name": output.stem}
        config: Any = None
        for record in _readable(path):
            if isinstance(record, mcap_records.Schema):
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, mcap_records.Channel):
                number = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas[record.schema_id],
                    dict(record.metadata),
                )
                channels[record.id] = number, record.topic
            elif isinstance(record, mcap_records.Metadata):
                if record.name == ORIGIN:
                    origin = dict(record.metadata)
                else:
                    writer.add_metadata(record.name, dict(record.metadata))
            elif isinstance(record, mcap_records.Message) and record.channel_id in channels:
                number, topic = channels[record.channel_id]
                at = (record.log_time - start) / 1e9
                if topic == CONFIG:
                    config = record
                if topic == CONFIG or not edit.holds(at):
                    continue
                data = record.data
                if topic == LOOP and marks and at >= marks[0][0]:
                    state = message_class(SCHEMAS[LOOP]).FromString(data)
                    while marks and at >= marks[0][0]:
                        state.events.append(f"mark: {marks.pop(0)[1]}")
                    data = state.SerializeToString()
                if config is not None:  # at the time of the first message, as in every log
                    place = channels[config.channel_id][0]
                    writer.add_message(place, record.log_time, config.data, record.log_time, 0)
                    config = None
                writer.add_message(number, record.log_time, data, record.log_time, record.sequence)
                count += topic in _TIMED
        if not count:
            raise RecordingError(f"{path}: this would remove the whole recording")
        if marks:
            time, words = marks[0]
            raise RecordingError(
                f"{path}: the mark {words!r} at {time:g} s is after the last command"
            )
        meta = json_object(origin.get("meta", "")) or {}
        meta[EDITS] = [*meta.get(EDITS, []), entry]
        writer.add_metadata(ORIGIN, {**origin, "name": output.stem, "meta": to_json(meta)})
        writer.finish()  # type: ignore[no-untyped-call]
    return entry


def as_range(text: str) -> tuple[float, float]:
    """Parses ``A:B`` [s]; without A from the start, without B to the end. ConfigError for any other
    form."""
    begin, sign, end = text.partition(":")
    try:
        span = float(begin or 0.0), float(end) if end else math.inf
    except ValueError:
        sign = ""
    if not sign or math.isnan(sum(span)):
        raise ConfigError(f"{text!r} is not a time range; write FROM:TO in seconds: 1.5:8, 9:")
    return span


def as_mark(text: str) -> tuple[float, str]:
    """Parses ``T=TEXT``; ConfigError for any other form."""
    time, sign, words = text.partition("=")
    try:
        mark = float(time), words.strip()
    except ValueError:
        sign = ""
    if not sign or not mark[1] or not math.isfinite(mark[0]):
        raise ConfigError(f"{text!r} is not a mark; write SECONDS=TEXT, such as 2.5=grasp")
    return mark
