"""Recordings of a folder: their jobs, and the worker function, which takes some side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import ConfigError
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.commands import encode_commands, write_encoded_commands
from smooth_operator.formats.frames import frame_slice
from smooth_operator.formats.readers import rated_if_unstamped
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side
from smooth_operator.lab.offline.answers import answers, tools_of
from smooth_operator.lab.offline.discovery import Found
from smooth_operator.lab.offline.finished import digest, identity
from smooth_operator.lab.offline.trajectory_retargeter import check_method
from smooth_operator.parallel.tasks import timed
from smooth_operator.planning import Plan, RetargetRequest, configuration, plan
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

State: TypeAlias = Literal["done", "kept", "failed"]
"""Made now, found whole from an earlier run, or not there."""


def checked(request: RetargetRequest) -> RetargetRequest:
    """A request whose every part is possible, so that it does not fail once per recording.

    As ``build``, it lets JAX run on the calling thread.

    Raises:
        UnknownNameError: there is no such hand or finger.
        SmoothOperatorError: the method can't serve the hand.
        ConfigError: scale, rate, frames or operator can't be.
    """
    dispatch_here()
    hand = _hand(request)
    if request.operator is not None:
        request.operator.check(hand)
    config = request.config
    check_method(config, hand)
    if isinstance(request.scale, float | int):
        replace(config.alignment, scale=float(request.scale))  # refuses what is none
    stamps_from_rate(0, request.rate, "--rate")  # refuses one that can't be
    if request.frames is not None:
        try:
            frame_slice(request.frames, 10**9)
        except ConfigError as error:
            raise ConfigError(
                f"frames must be a range A:B with something in it, such as ':500', '2600:3100' or "
                f"'-500:', not {request.frames!r}"
            ) from error
    return request


def notes(request: RetargetRequest) -> tuple[str, ...]:
    """Notes for a person on what the method of a checked request lacks on its hand."""
    return request.config.notes(_hand(request))


def _hand(request: RetargetRequest) -> Hand:
    """The robot hand of a request, of the side that it names, or its operator is of."""
    operator = request.operator
    side = request.side or (default_side(request.hand) if operator is None else operator.side)
    return request.load_hand(side)


@dataclass(frozen=True)
class Job:
    """One recording for one worker.

    Attributes:
        found: the recording.
        output: where its commands shall stand.
        request: settings of the retargeting.
    """

    found: Found
    output: Path
    request: RetargetRequest


@dataclass(frozen=True)
class Entry:
    """The result of one recording.

    Attributes:
        name: its path in the folder.
        output: path of its commands in the folder of results.
        state: see ``State``.
        frames: number of retargeted frames; of a failed one, the number that it seems to hold.
        held: number of them that repeat the last good command.
        tracking_loss: mean over the others; None without any.
        side: side of the hand that was assumed.
        side_assumed: neither the recording nor the request said so.
        reason: why it failed.
        seconds: time that a worker took [s].
        attempts: number of attempts in this run.
    """

    name: str
    output: str
    state: State
    frames: int
    held: int = 0
    tracking_loss: float | None = None
    side: Side | None = None
    side_assumed: bool = False
    reason: str | None = None
    seconds: float = 0.0
    attempts: int = 0


def retarget_group(group: Sequence[Job]) -> tuple[Entry, ...]:
    """Reads, retargets and writes some recordings, in a worker; those of one hand side by side.

    A failure of one does not touch another; nothing is then written for it.

    Returns:
        their results, in their order.
    """
    done: dict[int, Entry] = {}
    batches: dict[object, list[tuple[int, _Read]]] = {}
    for index, job in enumerate(group):
        read, reason, _ = timed(_read_job, job)
        if read is None:
            done[index] = _failed(job, reason)
        else:
            batches.setdefault(read.tools, []).append((index, read))
    for batch in batches.values():
        done |= zip((index for index, _ in batch), _batch([r for _, r in batch]), strict=True)
    return tuple(done[index] for index in range(len(group)))


@dataclass(frozen=True, eq=False)
class _Read:
    """A recording that was read, and what is to be done to it.

    Attributes:
        job: its job.
        recording: all of it.
        rate: that it needed [Hz]; None if it has stamps.
        source: identity of the file's content.
        frames: range of the frames.
        todo: the plan for these.
        tools: key of equal retargeters; None for one of its own.
    """

    job: Job
    recording: HandRecording
    rate: float | None
    source: dict[str, Any]
    frames: slice
    todo: Plan
    tools: object


def _read_job(job: Job) -> _Read:
    request = job.request
    source = identity(job.found.path)
    recording, rate = _read(job.found.path, request)
    total = len(recording)
    frames = slice(0, total) if request.frames is None else frame_slice(request.frames, total)
    todo = plan(recording[frames], request)
    alone = request.scale == "calibrate"  # each scale is a program
    tools = object() if alone else tools_of(todo)
    return _Read(job, recording, rate, source, frames, todo, tools)


def _batch(reads: Sequence[_Read]) -> list[Entry]:
    """Recordings for one retargeter; if they fail together, each is tried by itself."""
    outcome, reason, seconds = timed(_retarget, reads)
    if outcome is None:
        if len(reads) == 1:
            return [_failed(reads[0].job, reason)]
        return [entry for read in reads for entry in _batch([read])]
    total = max(1, sum(len(commands) for commands, _ in outcome))
    entries = []
    for read, (commands, loss) in zip(reads, outcome, strict=True):
        entry, reason, more = timed(lambda _: _written(read, commands, loss), None)  # noqa: B023
        share = seconds * len(commands) / total
        entry = _failed(read.job, reason) if entry is None else entry
        entries.append(replace(entry, seconds=share + more))
    return entries


def _retarget(reads: Sequence[_Read]) -> list[tuple[CommandTrajectory, np.ndarray]]:
    keep = reads[0].job.request.scale != "calibrate"  # each scale is a program
    return answers([read.todo for read in reads], keep=keep)


def _failed(job: Job, reason: str | None) -> Entry:
    recording = job.found
    return Entry(recording.name, recording.output, "failed", recording.frames, reason=reason)


def _written(read: _Read, commands: CommandTrajectory, loss: np.ndarray) -> Entry:
    """The result of one recording, written.

    Raises:
        SmoothOperatorError: with the reason; nothing is then written.
    """
    job, recording, frames = read.job, read.recording, read.frames
    good = loss[np.isfinite(loss)]
    entry = Entry(
        name=job.found.name,
        output=job.found.output,
        state="done",
        frames=len(commands),
        held=int((commands.status != Status.OK).sum()),
        tracking_loss=float(good.mean()) if len(good) else None,
        side=recording.side,
        side_assumed=bool(recording.meta.get("side_assumed")),
    )
    encoded = encode_commands(commands)
    config = configuration(
        "retarget",
        read.todo,
        source={"path": job.found.path, "frames": [frames.start, frames.stop], **read.source},
        rate=read.rate,
        request=job.request,
        commands={
            "sha256": digest(encoded),
            "held": entry.held,
            "tracking_loss": entry.tracking_loss,
            "side_assumed": entry.side_assumed,
        },
    )
    del config["created"]  # or a resumed run would not end in the same bytes
    job.output.parent.mkdir(parents=True, exist_ok=True)
    write_encoded_commands(job.output, encoded, config)
    return entry


def _read(path: Path, request: RetargetRequest) -> tuple[HandRecording, float | None]:
    """The recording, and the rate if it needed one: others of the folder may have their own."""

    def read(rate: float | None) -> HandRecording:
        return request.read_recording(path, rate)

    return rated_if_unstamped(read, request.rate)
