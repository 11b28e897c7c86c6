"""A folder of recordings into a folder of commands, by many workers, to be stopped and resumed."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections import defaultdict
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from smooth_operator.atomic_files import remove_leftovers
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.arrays import StoredArrays, open_arrays
from smooth_operator.formats.checks import frame_slice, reading_notes, stamps_from_rate
from smooth_operator.formats.commands import config_path, encode_commands, write_encoded_commands
from smooth_operator.formats.readers import rated_if_unstamped
from smooth_operator.formats.registry import file_kind, is_dataset, recording_suffixes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side
from smooth_operator.io.jsonable import to_json
from smooth_operator.offline.execution import answers, tools_of
from smooth_operator.offline.finished import finished, foreign, identity
from smooth_operator.offline.trajectory_retargeter import check_method
from smooth_operator.parallel import run_groups, usable_cores
from smooth_operator.parallel.tasks import timed
from smooth_operator.planning import Plan, RetargetRequest, code_of_commands, configuration, plan
from smooth_operator.result_cache import content_digest
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

_COMMANDS: Final = ("joint_positions", "joint_names")
_LANDMARKS: Final = ("landmarks", "joints", "data")
_BYTES_PER_FRAME: Final = 600
"""Of the formats whose frames can't be counted without reading them; for the order only."""


@dataclass(frozen=True)
class Found:
    """A file that is taken for a recording.

    Attributes:
        path: where it is.
        name: its path in the folder, with slashes.
        frames: number of frames; of files that aren't arrays, an estimate by their size.
    """

    path: Path
    name: str
    frames: int

    @property
    def output(self) -> str:
        """Path of its commands in the folder of results."""
        return Path(self.name).with_suffix(".npz").as_posix()

    def failed(self, reason: str | None, seconds: float = 0.0) -> Entry:
        """The result without commands, with the reason."""
        return Entry(self.name, self.output, "failed", self.frames, reason=reason, seconds=seconds)


def find_recordings(folder: Path, *, leave_out: Path | None = None) -> tuple[list[Found], int]:
    """Looks through a folder; opens files, but reads no data.

    Hidden files and folders are passed over. Links to folders are followed, once.

    Args:
        folder: where to look.
        leave_out: a folder in it that is not looked into.

    Returns:
        the recordings, the longest first, and the number of files passed over because they hold
        commands and no hand. A file that can't be understood counts as a recording: that it is
        none must not go unsaid.

    Raises:
        RecordingError: the folder can't be read.
    """
    if is_dataset(folder):
        file_kind(folder)  # raises with what it is
    recordings, commands = [], 0
    for path in _files(folder, leave_out):
        frames = _size(path) // _BYTES_PER_FRAME
        # What is wrong with a file is reported by its reader.
        with contextlib.suppress(RecordingError, OSError):
            if file_kind(path) in ("npy", "npz"):
                arrays = open_arrays(path)
                if all(n in arrays for n in _COMMANDS) and not any(n in arrays for n in _LANDMARKS):
                    commands += 1
                    continue
                frames = _frames_of_arrays(arrays)
        recordings.append(Found(path, path.relative_to(folder).as_posix(), frames))
    # By name among equals, so that the order is the same everywhere.
    return sorted(recordings, key=lambda item: (-item.frames, item.name)), commands


def clashes(recordings: list[Found]) -> dict[str, str]:
    """Names of files whose results would stand in the same place, each with the reason."""
    by_output: dict[str, list[str]] = defaultdict(list)
    for item in recordings:
        by_output[item.output].append(item.name)
    return {
        name: f"{' and '.join(sorted(names))} would both become {output}; rename one, or remove it"
        for output, names in by_output.items()
        if len(names) > 1
        for name in names
    }


def _files(folder: Path, leave_out: Path | None) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise RecordingError(f"{error.filename}: can't be read: {error.strerror}") from error

    skipped = None if leave_out is None else leave_out.resolve()
    visited: set[Path] = set()
    suffixes = recording_suffixes()  # other files of a folder are left alone
    for at, folders, files in os.walk(folder, onerror=refuse, followlinks=True):
        real = Path(at).resolve()
        if real in visited or real == skipped:
            folders.clear()
            continue
        visited.add(real)
        if is_dataset(Path(at)):
            folders.clear()
            yield Path(at)  # its reader says what it is
            continue
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in files:
            path = Path(at, name)
            if path.suffix.lower() in suffixes and not name.startswith("."):
                yield path


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # a link to nowhere
        return 0


def _frames_of_arrays(arrays: StoredArrays) -> int:
    shapes = [item.shape for item in arrays.values() if len(item.shape) == 3]
    return max((shape[0] for shape in shapes), default=1)


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
        request.operator.check(hand.spec.side)
    config = request.config
    check_method(config, hand)
    if isinstance(request.scale, float | int):
        replace(config.alignment, scale=float(request.scale))  # refuses what is none
    stamps_from_rate(0, request.rate, "--rate")  # refuses one that can't be
    if request.frames is not None:
        try:
            frame_slice(request.frames, None)
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
        made_by: digest of the code and the hands that make the commands.
    """

    found: Found
    output: Path
    request: RetargetRequest
    made_by: str


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
        notes: notes on how the recording was read, but for the side.
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
    notes: tuple[str, ...] = ()


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
            done[index] = job.found.failed(reason)
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
    if job.found.path.is_dir():
        file_kind(job.found.path)  # raises with what it is
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
    keep = reads[0].job.request.scale != "calibrate"  # each scale is a program
    plans = [read.todo for read in reads]
    outcome, reason, seconds = timed(lambda plans: answers(plans, keep=keep), plans)
    if outcome is None:
        if len(reads) == 1:
            return [reads[0].job.found.failed(reason)]
        return [entry for read in reads for entry in _batch([read])]
    total = max(1, sum(len(commands) for commands, _ in outcome))
    entries = []
    for read, (commands, loss) in zip(reads, outcome, strict=True):
        entry, reason, more = timed(lambda _: _written(read, commands, loss), None)  # noqa: B023
        share = seconds * len(commands) / total
        entry = read.job.found.failed(reason) if entry is None else entry
        entries.append(replace(entry, seconds=share + more))
    return entries


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
        notes=tuple(_notes(recording, job.found.name)),
    )
    encoded = encode_commands(commands)
    config = configuration(
        "retarget",
        read.todo,
        source={"path": job.found.path, "frames": [frames.start, frames.stop], **read.source},
        rate=read.rate,
        request=job.request,
        made_by=job.made_by,
        commands={
            "sha256": content_digest(encoded),
            "held": entry.held,
            "tracking_loss": entry.tracking_loss,
            "side_assumed": entry.side_assumed,
            "notes": entry.notes,
        },
    )
    del config["created"]  # or a resumed run would not end in the same bytes
    job.output.parent.mkdir(parents=True, exist_ok=True)
    write_encoded_commands(job.output, encoded, config)
    return entry


def _notes(recording: HandRecording, name: str) -> list[str]:
    """Notes on how a recording was read; the sides that are assumed are counted apart."""
    meta = {**recording.meta, "side_assumed": False}
    return reading_notes(replace(recording, meta=meta), name)


def _read(path: Path, request: RetargetRequest) -> tuple[HandRecording, float | None]:
    """The recording, and the rate if it needed one: others of the folder may have their own."""

    return rated_if_unstamped(lambda rate: request.read_recording(path, rate), request.rate)


SUMMARY: Final = "summary.json"
"""Name of the account of the last run, in the folder of results."""

MOST: Final = 16
"""Recordings that a worker takes at a time: its lanes, twice, so that short ones leave no lane
idle."""

MOST_FRAMES: Final = 200_000
"""Their frames, unless one alone has more: about 300 MB."""

_CLUSTER: Final = 16
"""Workers that a cluster is taken to have, where it is not said."""


@dataclass(frozen=True)
class Survey:
    """Content of a folder, and the work that is left.

    Attributes:
        jobs: the recordings to retarget, the longest first.
        settled: those that are done already, or can't be done.
        commands: files passed over, since they hold commands and no hand.
        remade: jobs whose place holds a result of another configuration, code or recording.
        leftovers: unfinished files of a killed run, now deleted.
    """

    jobs: list[Job]
    settled: list[Entry]
    commands: int
    remade: int
    leftovers: int


def check_folders(folder: Path, output: Path) -> None:
    """Looks whether results would stand among the recordings.

    Raises:
        OutputError: they would.
    """
    if folder.resolve().is_relative_to(output.resolve()):
        raise OutputError(
            f"can't write into {str(output)!r}: the recordings are there; give a separate folder "
            "to the results"
        )


def survey(
    folder: Path, output: Path, request: RetargetRequest, *, overwrite: bool = False
) -> Survey:
    """Looks what there is and what is left to do; deletes what a killed run left unfinished.

    Args:
        folder: folder of the recordings.
        output: folder of the results; see ``claimed``.
        request: settings of the retargeting.
        overwrite: do again what is done.

    Raises:
        RecordingError: the folder can't be read.
        OutputError: results would stand among the recordings.
    """
    check_folders(folder, output)
    recordings, commands = find_recordings(folder, leave_out=output)
    refused = clashes(recordings)
    leftovers = remove_leftovers({output} | {(output / item.output).parent for item in recordings})
    as_json, code = json.loads(to_json(request)), code_of_commands(request)

    def earlier(item: Found) -> dict[str, Any] | None:
        return None if overwrite else finished(output / item.output, item.path, as_json, code)

    jobs, settled, remade = [], [], 0
    with ThreadPoolExecutor() as threads:  # digests are computed outside Python's lock
        for item, config in zip(recordings, threads.map(earlier, recordings), strict=True):
            path = output / item.output
            reason = refused.get(item.name) or _refusal(path, output)
            if reason is not None:
                settled.append(item.failed(reason))
            elif config is not None:
                settled.append(_finished_entry(item, config))
            else:
                jobs.append(Job(item, path, request, code))
                remade += path.exists()
    return Survey(jobs, settled, commands, remade, leftovers)


def retarget_all(
    jobs: list[Job], *, workers: int | None = None, cluster: str | None = None
) -> Generator[Entry, None, None]:
    """Retargets recordings in parallel; a failure of one does not touch another.

    Each result is written whole or not at all. It depends on its recording and the request alone,
    to the last bit: not on the number of workers, on what it is done together with
    (``Retargeter.batch``), nor on what was done before. To that end
    latencies, which are no property of commands computed side by side, are NaN, and the
    configurations bear no date.

    Args:
        jobs: jobs of ``survey``.
        workers: as in ``run_tasks``.
        cluster: as there.

    Yields:
        the result of each, as they finish.
    """
    repeated = False
    groups = grouped(jobs, workers, cluster)
    for group, result in run_groups(
        retarget_group, groups, lambda group: [(job,) for job in group],
        workers=workers, cluster=cluster,
    ):  # fmt: skip
        repeated = repeated or result.attempts > 1
        entries = result.value or [job.found.failed(result.error, result.seconds) for job in group]
        yield from (replace(entry, attempts=result.attempts) for entry in entries)
    if repeated:  # a worker that died in the middle of a write leaves its file; no other writes now
        remove_leftovers({job.output.parent for job in jobs})


def grouped(jobs: Sequence[Job], workers: int | None, cluster: str | None) -> list[tuple[Job, ...]]:
    """Recordings that a worker takes side by side, in their order; results do not depend on it.

    There are as many groups as keep all workers busy to the end; none is too large for the memory.
    """
    count = workers or (usable_cores() if cluster is None else _CLUSTER)
    turns = max(1, math.ceil(len(jobs) / (count * MOST)))
    size = max(1, math.ceil(len(jobs) / (count * turns)))
    groups: list[tuple[Job, ...]] = []
    now: list[Job] = []
    frames = 0
    for job in jobs:
        if now and (len(now) == size or frames + job.found.frames > MOST_FRAMES):
            groups.append(tuple(now))
            now, frames = [], 0
        now.append(job)
        frames += job.found.frames
    return [*groups, tuple(now)] if now else groups


def _refusal(path: Path, output: Path) -> str | None:
    if config_path(path) == output / SUMMARY:
        return f"its configuration would be {SUMMARY}, the account of the run; rename it"
    return foreign(path)


def _finished_entry(item: Found, config: dict[str, Any]) -> Entry:
    commands = config["commands"]
    return Entry(
        item.name,
        item.output,
        "kept",
        config["recording"]["frames"],
        commands["held"],
        commands["tracking_loss"],
        config["side"],
        commands["side_assumed"],
        notes=tuple(commands["notes"]),
    )
