"""``smooth-operator retarget``: a recording, or a folder of them, into joint commands."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import (
    RARE,
    Common,
    HandSide,
    Measured,
    Ordered,
    Retargeting,
)
from smooth_operator.errors import ConfigError, OutputError, RecordingError, counted
from smooth_operator.terminal import printable

if TYPE_CHECKING:
    from smooth_operator.cli.console import Progressing
    from smooth_operator.offline.folder import Entry, Survey


@dataclass(frozen=True, kw_only=True)
class Retarget(Common, Ordered, Retargeting, Measured):
    """Turn a recording of a human hand, or a folder of them, into joint commands."""

    work: ClassVar[str] = "smooth_operator.cli.retarget:retarget"
    details: ClassVar[str] = """OUT.npz holds joint_positions (T, n) [rad], joint_names (n,),
timestamps (T,) [s], latency_ms (T,) and status (T,); the resolved configuration is
written with it, as OUT.json.

For a folder, all recordings (including subfolders) are retargeted, several in parallel. The
folder of --output mirrors its structure, and its summary.json has the result of each;
latency_ms is NaN. Run the same command again to continue after a stop, or to add new
recordings: finished results are kept, unless their recording, settings, robot hand or this
program's code have changed.

Exit status: 0 done, 1 some recordings of the folder failed (the others are done), 2 the
request is invalid, 130 stopped.

Examples:
  smooth-operator retarget glove.npz --output out.npz
  smooth-operator retarget landmarks.npy --rate 60 --side left --output out.npz
  smooth-operator retarget glove.npz --method sbr --preset paper --json --output out.npz
  smooth-operator retarget recordings/ --workers 8 --output commands/
  smooth-operator retarget /nfs/recordings --cluster auto --output /nfs/commands
"""

    rare: ClassVar[frozenset[str]] = RARE

    recording: Annotated[Positional[Path], arg(metavar="RECORDING|FOLDER")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log; or a
    folder of such files."""

    output: Annotated[Path, arg(metavar="OUT.npz|FOLDER")]
    """File to write, or folder of a folder's results; created if missing."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of recordings of a folder in parallel; 0 retargets them one after the other in this
    process. Default: one per core."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Retarget a folder on a running Ray cluster (auto finds it), or start Ray here (local); its
    nodes need this package and the same folders."""

    overwrite: bool = False
    """Replace what is there: OUT.npz, or the finished results of a folder."""

    json: bool = False
    """Print the metrics (of a folder: the summary) as one JSON object on standard output, and
    nothing else there."""


def retarget(options: Retarget) -> None:
    """Reads, retargets, measures, writes; all that a user can get wrong is checked first."""
    from smooth_operator.cli.console import Progressing, print_metrics, print_summary
    from smooth_operator.cli.outputs import check_commands_path, folder_for
    from smooth_operator.cli.session import execute_shown, measure_shown, requested
    from smooth_operator.formats.checks import frame_slice, reading_notes
    from smooth_operator.formats.commands import write_commands
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.planning import configuration, plan
    from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
    from smooth_operator.types import Status

    if options.recording.is_dir():
        retarget_folder(options)
        return
    for name in ("workers", "cluster"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name} is for a folder of recordings, and {options.recording} is none"
            )
    progress = Progressing(options.quiet)
    check_commands_path(options.output, options.recording, options.overwrite)
    request = requested(
        options,
        side=options.side,
        rate=options.rate,
        layout=options.layout,
        frames=options.frames,
    )
    recording = request.read_recording(options.recording, options.rate)
    for note in reading_notes(recording, str(options.recording)):
        progress.note(note, matters=True)
    total = len(recording)
    frames = slice(0, total) if options.frames is None else frame_slice(options.frames, total)
    todo = plan(recording[frames], request)
    with folder_for(options.output.parent):
        outcome = execute_shown(todo, progress)
        _, metrics = measure_shown(todo, outcome, options.definition, progress)
        config = configuration(
            "retarget",
            todo,
            source={"path": options.recording, "frames": [frames.start, frames.stop]},
            rate=options.rate,
            layout=options.layout,
        )
        write_commands(options.output, outcome.commands, config)
    held = int((outcome.commands.status != Status.OK).sum())
    if held:
        done = (
            "had no usable hand: short gaps are bridged, over longer ones the last pose is held"
            if isinstance(todo.config, TrajectoryMethodConfig)
            else "repeat the last good command"
        )
        progress.note(f"{held} of {len(outcome.commands)} frames {done}")
    progress.note(f"wrote {options.output}")
    if options.json:
        print(to_json(metrics))
        return
    title = f"{recording.name} on {todo.hand.name}, {todo.method} {todo.preset}"
    if options.all:
        print_metrics(title, metrics)
        return
    files = shlex.join(map(str, (options.output, options.recording)))
    look = f"Next: smooth-operator view {files} plays both in the browser; --all or --json prints"
    print_summary(title, todo.method, metrics, [f"{look} all figures"])


_SHOWN_FAILURES = 40
_SHOWN_NOTES = 20


def retarget_folder(options: Retarget) -> None:
    """Retargets what is not done yet, and reports every result.

    Raises:
        SmoothOperatorError: with the reason; what is finished stays.
        SystemExit: 1, if a recording failed.
    """
    from smooth_operator.atomic_files import atomic_write, claimed
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for, stopped
    from smooth_operator.cli.session import requested
    from smooth_operator.formats.environment import environment
    from smooth_operator.formats.registry import file_kind, is_dataset
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.offline.folder import (
        SUMMARY,
        check_folders,
        checked,
        notes,
        retarget_all,
        survey,
    )
    from smooth_operator.planning import PROGRAM, read_configuration

    progress = Progressing(options.quiet)
    folder, output = options.recording, options.output
    if is_dataset(folder):
        file_kind(folder)  # raises with what it is, and the way
    if output.suffix == ".npz" and not output.is_dir():
        raise OutputError(
            f"can't write {str(output)!r}: {folder} is a folder of recordings, and so are its "
            "results; name a folder"
        )
    check_folders(folder, output)
    account = output / SUMMARY
    if account.exists() and read_configuration(account) is None:
        raise OutputError(
            f"can't write {str(account)!r}, the account of the run: it holds something else; give "
            "another folder, or remove it first"
        )
    request = checked(
        requested(
            options,
            side=options.side,
            rate=options.rate,
            layout=options.layout,
            frames=options.frames,
        )
    )
    with folder_for(output), claimed(output):
        with progress.waiting(f"looking through {folder}"):
            todo = survey(folder, output, request, overwrite=options.overwrite)
        if not todo.jobs and not todo.settled:
            raise RecordingError(
                f"{folder}: no recordings in it or in its folders; expected files whose names end "
                "in .npz, .npy, .mcap or .h5"
                + (f" ({todo.commands} hold commands and no hand)" if todo.commands else "")
            )
        _tell(todo, progress)
        for note in notes(request) if todo.jobs else ():
            progress.note(note, matters=True)
        started = time.perf_counter()
        entries = [*todo.settled]
        try:
            with contextlib.closing(
                retarget_all(todo.jobs, workers=options.workers, cluster=options.cluster)
            ) as results:  # whatever happens here, the workers end
                entries += _watched(results, todo, progress)
        except KeyboardInterrupt:
            raise stopped(options.output) from None
        summary = {
            "program": PROGRAM,
            "command": "retarget",
            "folder": folder,
            "request": request,
            "workers": options.workers,
            "cluster": options.cluster,
            **summarise(entries, time.perf_counter() - started),
            **environment(),
        }
        text = to_json(summary, indent=2)
        with atomic_write(account) as file:
            file.write(text.encode() + b"\n")
    if options.json:
        print(printable(text))
    else:
        _print_summary(summary, output)
    if summary["failed"]:
        raise SystemExit(1)


def summarise(entries: Iterable[Entry], seconds: float) -> dict[str, Any]:
    """Counts, speed, and each recording by name.

    Args:
        seconds: how long those of this run took together, the start of workers included [s].
    """
    by_name = sorted(entries, key=lambda entry: entry.name)
    states = {state: [e for e in by_name if e.state == state] for state in ("done", "kept")}
    frames = sum(entry.frames for entry in states["done"])
    whole = [*states["done"], *states["kept"]]
    return {
        "done": len(states["done"]),
        "kept": len(states["kept"]),
        "failed": len(by_name) - len(whole),
        "frames": frames,
        "held": sum(entry.held for entry in whole),
        "seconds": seconds,
        "frames_per_s": frames / seconds if frames else None,
        "recordings": [dataclasses.asdict(entry) for entry in by_name],
    }


def _tell(todo: Survey, progress: Progressing) -> None:
    finished = sum(entry.state == "kept" for entry in todo.settled)
    line = f"{counted(len(todo.jobs), 'recording')} to retarget"
    if finished:
        line += f", {finished} done already"
    if todo.commands:
        line += f"; passed over {counted(todo.commands, 'file')} with commands and no hand"
    progress.note(line)
    if todo.leftovers:
        progress.note(f"deleted {counted(todo.leftovers, 'unfinished file')} of a run that died")
    if todo.remade:
        progress.note(
            f"making {counted(todo.remade, 'result')} again: damaged, or of another configuration, "
            "recording or version of the code",
            matters=True,
        )


def _watched(results: Iterable[Entry], todo: Survey, progress: Progressing) -> list[Entry]:
    """All results, with a bar that counts recordings and frames."""
    expected = {job.found.name: job.found.frames for job in todo.jobs}
    if not todo.jobs:
        return list(results)
    counts = "{task.fields[done]}/{task.fields[count]} recordings, {task.fields[failed]} failed"
    bar = progress.counter("frames", extra=counts, in_files=True)
    entries: list[Entry] = []
    frames = failed = 0
    total = sum(expected.values())
    with bar:
        task = bar.add_task("", total=total, done=0, count=len(todo.jobs), failed=0)
        for entry in results:
            entries.append(entry)
            if entry.state == "failed":
                failed += 1
                total -= expected[entry.name]
            else:
                frames += entry.frames
                total += entry.frames - expected[entry.name]  # an estimate, or --frames
            bar.update(task, completed=frames, total=total, done=len(entries), failed=failed)
    return entries


def _print_summary(summary: Mapping[str, Any], output: Path) -> None:
    from smooth_operator.cli.console import output_console, plain_table
    from smooth_operator.offline.folder import SUMMARY

    console = output_console(250)
    speed = summary["frames_per_s"]
    line = f"{counted(summary['done'], 'recording')} done"
    if speed is not None:
        line += f" ({summary['frames']} frames in {summary['seconds']:.1f} s, {speed:.0f} a second)"
    line += f", {summary['kept']} kept, {summary['failed']} failed"
    recordings = summary["recordings"]
    failures = [entry for entry in recordings if entry["state"] == "failed"]
    if failures:
        shown = ((entry["name"], entry["reason"] or "") for entry in failures[:_SHOWN_FAILURES])
        console.print(plain_table("failed", ("recording", "reason"), shown, overflow="fold"))
        if len(failures) > _SHOWN_FAILURES:
            left = len(failures) - _SHOWN_FAILURES
            console.print(f"and {left} more in {SUMMARY}", soft_wrap=True)
    notes = [note for entry in recordings for note in entry["notes"]]
    for note in notes[:_SHOWN_NOTES]:
        console.print(note, markup=False, soft_wrap=True)
    if len(notes) > _SHOWN_NOTES:
        console.print(f"and {len(notes) - _SHOWN_NOTES} more notes in {SUMMARY}", soft_wrap=True)
    assumed = sum(entry["side_assumed"] for entry in recordings)
    if assumed:
        console.print(
            f"{counted(assumed, 'recording')} do not state the side; assuming right. Use --side "
            "left otherwise",
            soft_wrap=True,
        )
    if summary["held"]:
        console.print(
            f"repeating the last good command: {counted(summary['held'], 'frame')}", soft_wrap=True
        )
    console.print(line, markup=False, soft_wrap=True)
    console.print(f"result of each: {output / SUMMARY}", markup=False, soft_wrap=True)
