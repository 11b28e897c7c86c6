"""``smooth-operator retarget FOLDER``: every recording of a folder."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import atomic_write
from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.retarget_options import Retarget
from smooth_operator.cli.session import requested
from smooth_operator.errors import OutputError, RecordingError
from smooth_operator.formats.environment import environment
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.offline.dataset import SUMMARY, Survey, check_folders, retarget_all, survey
from smooth_operator.lab.offline.finished import claimed, read_configuration
from smooth_operator.lab.offline.jobs import Entry, checked, notes
from smooth_operator.planning import PROGRAM
from smooth_operator.terminal import printable

_SHOWN_FAILURES = 40


def retarget_folder(options: Retarget) -> None:
    """Retargets what is not done yet, and reports every result.

    Raises:
        SmoothOperatorError: with the reason; what is finished stays.
        SystemExit: 1, if a recording failed.
    """
    progress = Progressing(options.quiet)
    folder, output = options.recording, options.output
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
    asked = checked(
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
            todo = survey(folder, output, asked, overwrite=options.overwrite)
        if not todo.jobs and not todo.settled:
            raise RecordingError(
                f"{folder}: no recordings in it or in its folders; expected files whose names end "
                "in .npz, .npy, .mcap or .h5"
                + (f" ({todo.commands} hold commands and no hand)" if todo.commands else "")
            )
        _tell(todo, progress)
        for note in notes(asked) if todo.jobs else ():
            progress.note(note, matters=True)
        started = time.perf_counter()
        entries = [*todo.settled]
        try:
            with contextlib.closing(
                retarget_all(todo.jobs, workers=options.workers, cluster=options.cluster)
            ) as results:  # whatever happens here, the workers end
                entries += _watched(results, todo, progress)
        except KeyboardInterrupt:
            progress.note("stopped; run the same command again to go on", matters=True)
            raise
        summary = {
            "program": PROGRAM,
            "command": "retarget",
            "folder": folder,
            "request": asked,
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
        entries: result of each.
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
    kept = sum(entry.state == "kept" for entry in todo.settled)
    line = f"{_count(len(todo.jobs), 'recording')} to retarget"
    if kept:
        line += f", {kept} done already"
    if todo.commands:
        line += f"; passed over {_count(todo.commands, 'file')} with commands and no hand"
    progress.note(line)
    if todo.leftovers:
        progress.note(f"deleted {_count(todo.leftovers, 'unfinished file')} of a run that died")
    if todo.remade:
        progress.note(
            f"making {_count(todo.remade, 'result')} again: damaged, or of another configuration, "
            "version or recording",
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
    console = output_console(250)
    speed = summary["frames_per_s"]
    line = f"{_count(summary['done'], 'recording')} done"
    if speed is not None:
        line += f" ({summary['frames']} frames in {summary['seconds']:.1f} s, {speed:.0f} a second)"
    line += f", {summary['kept']} kept, {summary['failed']} failed"
    recordings = summary["recordings"]
    failures = [entry for entry in recordings if entry["state"] == "failed"]
    if failures:
        table = plain_table("failed")
        table.add_column("recording", overflow="fold")
        table.add_column("reason", overflow="fold")
        for entry in failures[:_SHOWN_FAILURES]:
            table.add_row(entry["name"], entry["reason"] or "")
        console.print(table)
        if len(failures) > _SHOWN_FAILURES:
            left = len(failures) - _SHOWN_FAILURES
            console.print(f"and {left} more in {SUMMARY}", soft_wrap=True)
    assumed = sum(entry["side_assumed"] for entry in recordings)
    if assumed:
        console.print(
            f"not said which hand: {_count(assumed, 'recording')}, taken for right ones; say "
            "--side left if they are not",
            soft_wrap=True,
        )
    if summary["held"]:
        console.print(
            f"repeating the last good command: {_count(summary['held'], 'frame')}", soft_wrap=True
        )
    console.print(line, markup=False, soft_wrap=True)
    console.print(f"result of each: {output / SUMMARY}", markup=False, soft_wrap=True)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
