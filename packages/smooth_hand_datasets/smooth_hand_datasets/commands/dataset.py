"""``smooth-operator dataset``: turns recordings of human hands into robot episodes."""

from __future__ import annotations

from smooth_hand_datasets.commands.options import Dataset
from smooth_hand_datasets.pipeline.request import DatasetRequest
from smooth_hand_datasets.pipeline.run import make_dataset
from smooth_hand_datasets.pipeline.writing import Summary
from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.errors import counted
from smooth_operator.io.jsonable import to_json
from smooth_operator.planning import RetargetRequest
from smooth_operator.retargeting.start import start_jax
from smooth_operator.terminal import printable

_SHOWN_FAILURES = 20


def dataset(options: Dataset) -> None:
    """Makes the data set, and reports what was kept and dropped."""
    make_shown(options, quiet=options.quiet, json=options.json)


def make_shown(
    request: DatasetRequest,
    *,
    resolved: RetargetRequest | None = None,
    again: bool = False,
    quiet: bool,
    json: bool,
) -> None:
    """Makes a data set with progress on standard error, and prints the report.

    Raises:
        SystemExit: 1, if a clip failed, or nothing is in the data set.
    """
    start_jax(one_thread=False)
    try:
        with folder_for(request.output):
            summary = make_dataset(request, Progressing(quiet), resolved=resolved, again=again)
    except KeyboardInterrupt:
        raise stopped(request.output) from None
    if json:
        print(printable(to_json(summary.as_json(), indent=2)))
    else:
        _print(summary, request)
    if summary.failed or (summary.shard is None and summary.episodes == 0):
        raise SystemExit(1)


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
            f"shard {number} of {count}: {counted(summary.clips, 'clip')} "
            f"({counted(summary.frames, 'frame')}), {len(summary.failed)} failed; when all shards "
            "are done, run with --merge"
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
    say(
        f"{written}what was kept and why: "
        f"{request.output / ('report.json' if request.mirror else 'report.html')}"
    )
