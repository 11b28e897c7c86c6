"""A folder of recordings into a folder of commands, by many workers, to be stopped and resumed."""

from __future__ import annotations

import json
import math
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import OutputError
from smooth_operator.formats.commands import config_path
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.offline.discovery import Found, clashes, find_recordings
from smooth_operator.lab.offline.finished import finished, foreign, remove_leftovers
from smooth_operator.lab.offline.jobs import Entry, Job, retarget_group
from smooth_operator.parallel import TaskResult, run_groups, usable_cores
from smooth_operator.planning import RetargetRequest

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
        remade: jobs whose place holds a result of another configuration, version or recording.
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
    as_json = json.loads(to_json(request))

    def earlier(item: Found) -> dict[str, Any] | None:
        return None if overwrite else finished(output / item.output, item.path, as_json)

    jobs, settled, remade = [], [], 0
    with ThreadPoolExecutor() as threads:  # digests are computed outside Python's lock
        for item, config in zip(recordings, threads.map(earlier, recordings), strict=True):
            path = output / item.output
            reason = refused.get(item.name) or _refusal(path, output)
            if reason is not None:
                failed = Entry(item.name, item.output, "failed", item.frames, reason=reason)
                settled.append(failed)
            elif config is not None:
                settled.append(_finished_entry(item, config))
            else:
                jobs.append(Job(item, path, request))
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
        entries = [_lost(job, result) for job in group] if result.value is None else result.value
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


def _lost(job: Job, result: TaskResult[tuple[Entry, ...]]) -> Entry:
    recording = job.found
    return Entry(
        recording.name,
        recording.output,
        "failed",
        recording.frames,
        reason=result.error,
        seconds=result.seconds,
        attempts=result.attempts,
    )


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
    )
