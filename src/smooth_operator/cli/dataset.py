"""``smooth-operator dataset``: recordings of human hands into a data set of robot episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.progress import Progress as Bar

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.dataset_options import Dataset
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.retargeting.start import start_jax
from smooth_operator.datasets.pipeline import Progress, make_dataset
from smooth_operator.datasets.request import DatasetRequest
from smooth_operator.datasets.sources import Found
from smooth_operator.datasets.work import Entry
from smooth_operator.datasets.writing import Summary
from smooth_operator.errors import counted
from smooth_operator.io.jsonable import to_json
from smooth_operator.planning import RetargetRequest
from smooth_operator.terminal import printable

_SHOWN_FAILURES = 20


def dataset(options: Dataset) -> None:
    """Makes the data set, and reports what was kept and dropped."""
    make_shown(options, quiet=options.quiet, json=options.json)


def make_shown(
    request: DatasetRequest,
    *,
    asked: RetargetRequest | None = None,
    again: bool = False,
    quiet: bool,
    json: bool,
) -> None:
    """Makes a data set with progress on standard error, and prints the report.

    Raises:
        SystemExit: 1, if a clip failed, or nothing is in the data set.
    """
    progress = Progressing(quiet)
    start_jax(one_thread=False)
    shown = _Shown(progress)
    try:
        with folder_for(request.output), shown:
            summary = make_dataset(request, shown, asked=asked, again=again)
    except KeyboardInterrupt:
        raise stopped(request.output) from None
    if json:
        print(printable(to_json(summary.as_json(), indent=2)))
    else:
        _print(summary, request)
    if summary.failed or (summary.shard is None and summary.episodes == 0):
        raise SystemExit(1)


class _Shown(Progress):
    """Notes and bars on standard error."""

    def __init__(self, progress: Progressing) -> None:
        self._progress = progress
        self._bar: Bar | None = None
        self._task: Any = None
        self._frames = self._failed = 0
        self._writing = False

    def __enter__(self) -> _Shown:
        return self

    def __exit__(self, *_: object) -> None:
        self._start(None)

    def told(self, note: str) -> None:
        self._progress.note(note, matters=True)

    def looked(self, found: Found, items: int, kept: int) -> None:
        line = f"{items - kept} to retarget, {kept} done already"
        if found.passed_over:
            kinds = ", ".join(f"{count} {suffix}" for suffix, count in found.passed_over.items())
            line += f"; skipped (unknown format): {kinds}"
        self._progress.note(line)
        if items > kept:
            extra = "{task.fields[frames]} frames, {task.fields[failed]} failed"
            self._start(self._progress.counter("clips", extra=extra, in_files=True), items - kept)

    def retargeted(self, entries: Sequence[Entry]) -> None:
        self._failed += sum(entry.kept is None for entry in entries)
        self._frames += sum(0 if each.kept is None else each.kept.frames for each in entries)
        if self._bar is not None:
            self._bar.update(
                self._task, advance=len(entries), frames=self._frames, failed=self._failed
            )

    def written(self, done: int, count: int) -> None:
        if not self._writing:
            self._writing = True
            self._start(self._progress.counter("clips written", in_files=True), count)
        if self._bar is not None:
            self._bar.update(self._task, completed=done)

    def _start(self, bar: Bar | None, total: int = 0) -> None:
        if self._bar is not None:
            self._bar.stop()
        self._bar = bar
        if bar is not None:
            bar.start()
            self._task = bar.add_task("", total=total, frames=0, failed=0)


def _print(summary: Summary, request: DatasetRequest) -> None:
    console = output_console(160)

    def say(text: str) -> None:
        console.print(text, markup=False, soft_wrap=True)

    if summary.failed:
        shown = list(summary.failed.items())[:_SHOWN_FAILURES]
        console.print(plain_table("failed", ("clip", "reason"), shown, overflow="fold"))
        if len(summary.failed) > _SHOWN_FAILURES:
            say(f"and {len(summary.failed) - _SHOWN_FAILURES} more")
    if summary.shard is not None:
        number, count = summary.shard
        say(
            f"share {number} of {count}: {counted(summary.clips, 'clip')} "
            f"({counted(summary.frames, 'frame')}), {len(summary.failed)} failed; when all "
            "shares are done, run with --merge"
        )
        return
    if summary.reasons:
        reasons = sorted(summary.reasons.items(), key=lambda item: -item[1])
        rows = ((reason, str(number)) for reason, number in reasons)
        console.print(plain_table("dropped", ("limit", "episodes"), rows, left=1))
    for note in summary.notes:
        say(note)
    frames = counted(summary.episode_frames, "frame")
    if summary.written_frames != summary.episode_frames:
        frames += f", {summary.written_frames} in the data set"
    say(
        f"{counted(summary.clips, 'clip')} ({counted(summary.frames, 'frame')}): "
        f"{counted(summary.episodes, 'episode')} ({frames}) kept, "
        f"{counted(summary.dropped, 'part')} ({counted(summary.dropped_frames, 'frame')}) "
        f"dropped, {len(summary.failed)} failed"
    )
    written = f"data set: {request.data}; " if summary.episodes else ""
    say(f"{written}why: {request.output / ('report.json' if request.mirror else 'report.html')}")
